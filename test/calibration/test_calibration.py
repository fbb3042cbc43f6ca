# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration finds the valve that made a table, and says what it cannot."""

import numpy as np
import pytest

from valve_control.control.analysis.indices import PAPER_TABLE_1, Indices
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import offline
from valve_control.design.calibration import identifiability, measured, objective, search
from valve_control.design.calibration.space import DIMENSIONS, changed, present, values_at
from valve_control.parameter import ParameterError, defaults, updated

NAMES = ("gain_scale", "friction.coulomb", "friction.presliding")
TRUE = {"gain_scale": 1.1, "friction.coulomb": 0.9, "friction.presliding": 0.08}


def settings(**changes):
    given = files.given([], {}, [f"{k.replace('__', '.')}={v}" for k, v in changes.items()])
    return {n: updated(t, defaults(t), given[n]) for n, t in NODES.items()}


@pytest.fixture(scope="module")
def problem():
    """Three unknowns of a valve that made the table of three controllers without noise."""
    base = settings(duration=2.0, cycle=2.0, amplitude=2.0, start=0.0)
    dimensions = [d for d in DIMENSIONS if d.name in NAMES]
    found = objective.run(changed(base, dimensions, TRUE), ["pid", "arc", "oarc"], [1])
    return search.Problem(base, {name: runs[0] for name, runs in found.items()}, dimensions, [1])


@pytest.fixture(scope="module")
def found(problem):
    return search.search(problem, 3, 1500, 10, 2, lambda *_: None)


def test_finds_the_valve_that_made_the_table(problem, found):
    values = values_at(problem.dimensions, found.point)
    assert found.cost < 1e-3
    for name, value in TRUE.items():
        assert values[name] == pytest.approx(value, rel=0.02), name


def test_same_seed_same_valve_with_one_process_or_two(problem):
    one = search.search(problem, 5, 700, 10, 1, lambda *_: None)
    two = search.search(problem, 5, 700, 10, 2, lambda *_: None)
    assert np.array_equal(one.point, two.point) and one.cost == two.cost
    assert one.evaluations == two.evaluations


def test_profile_excludes_wrong_values_and_absence_costs(problem, found):
    profile = identifiability.profiles(problem._replace(seeds=[1]), found.point, 60, 2, lambda: None)[0]
    low, high = profile.interval(0.02)
    assert profile.name == "gain_scale" and low <= 1.1 <= high and high - low < 0.2
    absences = identifiability.absences(problem, found.point, 60, 2, lambda: None)
    assert {a.name for a in absences} == {"friction.coulomb", "friction.presliding"}
    assert all(a.fit.rms > 0.02 for a in absences)


def test_runs_are_those_of_simulate():
    values = settings(duration=1.5, cycle=1.5, amplitude=1.0, **{"lvdt.noise": 0.005, "seed": 4})
    values = {**values, "valve_simulator": {**values["valve_simulator"], "friction.coulomb": 0.5}}
    command = build.commands(values["command_source"])
    assert np.array_equal(objective.commands_of(values), command)
    for name, runs in objective.run(values, ["pid", "arc", "oarc", "compensator"], [4]).items():
        controller = updated(NODES["controller"], values["controller"], {"controller": name})
        assert runs[0] == offline.simulate(controller, values["valve_simulator"], command).indices


def test_fit_of_a_table():
    table = {"pid": Indices(1.0, 1.0, 1.0, 1.0, 1.0), "arc": Indices(2.0, 0.5, np.nan, 1.0, 1.0)}
    same = objective.fit({name: [row] for name, row in table.items()}, table)
    assert same.rms == 0.0 and same.orderings == 0
    off = {"pid": [Indices(np.e, 1.0, 1.0, 1.0, 1.0)], "arc": [Indices(2.0, 0.5, 3.0, 1.0, 1.0)]}
    got = objective.fit(off, table)
    assert got.worst == pytest.approx(1.0) and got.rms == pytest.approx(1.0 / 3.0)
    gap = 1.0 - np.log(2.0)
    assert got.orderings == 1 and got.gap == pytest.approx(gap)
    assert objective.swapped(off, table) == {("e_M", "pid", "arc"): pytest.approx(gap)}


@pytest.mark.parametrize("dimension", DIMENSIONS, ids=lambda d: d.name)
def test_each_quantity_reaches_its_parameters(dimension):
    base = settings()
    middle = dimension.from_unit(0.5)
    assert dimension.to_unit(middle) == pytest.approx(0.5)
    assert present(changed(base, [dimension], {dimension.name: middle}), dimension) == pytest.approx(middle)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("t.csv", "controller,e_M\narc,0.1,3\n", "number of cells"),
        ("t.csv", "law,e_M\narc,0.1\n", "column names"),
        ("t.csv", "controller,e_M\nlqr,0.1\n", "has a row 'lqr'"),
        ("t.csv", "controller,e_X\narc,0.1\n", "column 'e_X'"),
        ("t.csv", "controller,e_M\narc,-0.1\n", "positive number"),
        ("t.csv", "controller,e_M\narc,\n", "has no number"),
        ("t.csv", "controller,e_M\narc,0.1\narc,0.2\n", "two rows 'arc'"),
        ("t.yaml", "[1, 2]", "must hold one row"),
        ("t.yaml", "arc: {e_M: [1]}", "positive number"),
        ("t.yaml", "arc: {e_M: true}", "positive number"),
        ("t.json", "{", "neither YAML nor JSON"),
        ("t.yaml", "{}", "is empty"),
    ],
)
def test_tables_of_the_wrong_shape(tmp_path, name, text, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(ParameterError, match=said):
        measured.read(str(tmp_path / name))


def test_table_from_each_kind_of_file(tmp_path):
    (tmp_path / "t.csv").write_text("\ufeffcontroller,e_M,c_u\n# a comment\narc,0.1,0.4\npid,,0.5\n")
    (tmp_path / "t.yaml").write_text("arc: {e_M: 0.1, c_u: 0.4}\npid: {c_u: 0.5}\n")
    (tmp_path / "t.json").write_text('{"arc": {"e_M": 0.1, "c_u": 0.4}, "pid": {"c_u": 0.5, "e_M": null}}')
    tables = [measured.read(str(tmp_path / f"t.{kind}")) for kind in ("csv", "yaml", "json")]
    assert measured.read("paper") == PAPER_TABLE_1
    for table in tables:
        assert table["arc"].e_M == 0.1 and table["pid"].c_u == 0.5
        assert np.isnan(table["pid"].e_M) and np.isnan(table["arc"].e_rms)


def test_one_quantity_alone(problem):
    alone = [d for d in problem.dimensions if d.name == "gain_scale"]
    base = changed(problem.base, problem.dimensions, TRUE)
    one = problem._replace(base=base, dimensions=alone)
    found = search.search(one, 1, 90, 4, 1, lambda *_: None)
    assert values_at(alone, found.point)["gain_scale"] == pytest.approx(1.1, rel=0.01)
    assert len(identifiability.profiles(one, found.point, 5, 1, lambda: None)[0].values) == 7


def test_a_value_outside_of_its_range_counts_as_its_end():
    dimension = next(d for d in DIMENSIONS if d.name == "friction.presliding")
    assert dimension.to_unit(0.0) == 0.0 and dimension.to_unit(9.0) == 1.0


def test_a_run_that_is_not_a_number_is_no_run():
    """It was left out as if the table had nothing there, and the rest of a diverged valve fitted well."""
    row = Indices(1.0, 1.0, 1.0, 1.0, 1.0)
    table = {"pid": row, "arc": row._replace(e_F=np.nan)}
    diverged = {"pid": [row._replace(e_rms=np.nan)], "arc": [row]}
    assert objective.fit(diverged, table) == objective.NOT_RUN
    unmeasured = {"pid": [row], "arc": [row._replace(e_F=np.nan)]}
    assert objective.fit(unmeasured, table).cost == 0.0
