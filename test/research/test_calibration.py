# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Calibration finds the valve that made a table, whatever the number of processes."""

import json

import numpy as np
import pytest

from research.calibration import __main__ as calibration
from research.calibration import objective, search
from research.calibration.space import DIMENSIONS, changed, values_at
from research.paper import PAPER_TABLE_1
from valve_control.control.analysis.indices import Indices
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import offline
from valve_control.parameter import defaults, updated

TRUE = {"gain_scale": 1.1, "friction.coulomb": 0.9, "friction.presliding": 0.08}


def settings(*changes):
    given = files.given([], {}, changes)
    return {n: updated(t, defaults(t), given[n]) for n, t in NODES.items()}


@pytest.fixture(scope="module")
def problem():
    """Three unknowns of a valve that made the table of three controllers without noise."""
    base = settings("duration=2.0", "cycle=2.0", "amplitude=2.0", "start=0.0")
    dimensions = [d for d in DIMENSIONS if d.name in TRUE]
    found = objective.run(changed(base, dimensions, TRUE), ["pid", "arc", "oarc"], [1])
    return search.Problem(base, {name: runs[0] for name, runs in found.items()}, dimensions, [1])


def test_finds_the_valve_that_made_the_table(problem):
    found = search.search(problem, 3, 1500, 10, 2, lambda *_: None)
    values = values_at(problem.dimensions, found.point)
    assert found.cost < 1e-3
    for name, value in TRUE.items():
        assert values[name] == pytest.approx(value, rel=0.02), name


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
    diverged = {**off, "pid": [Indices(1.0, 1.0, np.nan, 1.0, 1.0)]}
    assert objective.fit(diverged, table) == objective.NOT_RUN


def test_written_file_has_the_indices_of_the_fit(tmp_path, monkeypatch):
    """Each law of the file, simulated by the package, gives the ratios of the first seed."""
    monkeypatch.chdir(tmp_path)
    line = ["--evaluations", "2", "--processes", "1", "--output", "v.yaml", "--json", "v.json"]
    assert calibration.main(line) == 0
    fit = json.loads((tmp_path / "v.json").read_text())["first_seed"]
    given = files.given(["v.yaml"], {}, [])
    all_values = {n: updated(t, defaults(t), given[n]) for n, t in NODES.items()}
    command = build.commands(all_values["command_source"])
    for name, row in PAPER_TABLE_1.items():
        controller = updated(NODES["controller"], all_values["controller"], {"controller": name})
        found = offline.simulate(controller, all_values["valve_simulator"], command).indices
        assert np.array(found) / np.array(row) == pytest.approx(list(fit["ratios"][name].values()), rel=1e-12)
