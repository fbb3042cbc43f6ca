# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's table and figures as files, from offline runs; `make paper` does it through the nodes."""

import contextlib
import io
import json

import numpy as np
import pytest

from research.paper.__main__ import main
from research.paper.figures import measured
from research.paper.runs import CONFIG, paper_runs, values_of, valve_gain, valve_of
from research.paper.traces import heard, load, offline, save
from valve_control.control.analysis.indices import PAPER_TABLE_1
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant.models import SECOND_ORDER
from valve_control.control.simulation import offline as simulation
from valve_control.design.identification.rational import measured_corners
from valve_control.parameter import defaults, updated


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder, said = tmp_path_factory.mktemp("paper"), io.StringIO()
    with contextlib.redirect_stdout(said):
        assert main(["--offline", "--out", str(folder)]) == 0
    return folder, said.getvalue()


def test_table_1_is_reproduced(made):
    """All fifteen numbers within 5 %, rms log error at most 0.03, and the paper's orders.

    One pair is not in its order: u_rms of PID and OARC, which the paper has 0.04 % apart and we 1 % (README).
    """
    folder, _ = made
    table = json.loads((folder / "table1.json").read_text())
    ratios = []
    for name, paper in PAPER_TABLE_1.items():
        for index, reference in paper._asdict().items():
            assert table[name]["paper"][index] == reference
            assert table[name]["ratio"][index] == pytest.approx(table[name]["indices"][index] / reference)
            ratios.append(table[name]["ratio"][index])
    assert table["rms_log_error"] == pytest.approx(np.sqrt(np.mean(np.log(ratios) ** 2)))
    assert np.max(np.abs(np.array(ratios) - 1.0)) <= 0.05
    assert table["rms_log_error"] <= 0.03
    assert {index for index, kept in table["orders_kept"].items() if not kept} <= {"u_rms"}
    assert table["pid"]["indices"]["u_rms"] == pytest.approx(table["oarc"]["indices"]["u_rms"], rel=0.01)
    assert table["arc"]["indices"]["u_rms"] > table["pid"]["indices"]["u_rms"]


def test_every_figure_as_png_svg_and_in_one_page(made):
    folder, said = made
    page = (folder / "index.html").read_text()
    for number in (1, 3, 4, 5, 6, 7):
        assert (folder / f"figure{number}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (folder / f"figure{number}.svg").read_text()
        assert f"Fig. {number}:" in page and f"figure{number}.svg" in page
    assert "Table 1" in page and "rms log error" in page
    assert f"wrote {folder / 'index.html'}" in said


def refused(capsys, *arguments):
    assert main(["--offline", *arguments]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


@pytest.mark.parametrize("folder", ["file", "file/x"])
def test_output_folder_that_cannot_be_made(tmp_path, capsys, folder):
    (tmp_path / "file").write_text("")
    assert "cannot be made" in refused(capsys, "--out", str(tmp_path / folder))


def test_response_of_a_linear_valve_is_that_of_its_model(config):
    """The measurement behind Fig. 3: (2) without friction and noise gives (2) with half a sample of hold."""
    set_by_file = files.load(str(config / CONFIG))
    valve = {"valve": "second_order", "gain_scale": 1.0}
    set_by_file = {
        **set_by_file,
        "valve_simulator": valve,
        "controller": {"controller": "open_loop", "open_loop.static_gain": SECOND_ORDER.static_gain},
    }
    planned = next(
        j for j in paper_runs(updated(VALVE, defaults(VALVE), valve)) if j.name == "response_open_loop"
    )
    planned = planned._replace(settings={"command_source": planned.settings["command_source"]})
    values = values_of(planned, set_by_file)
    run = simulation.simulate(
        values["controller"], values["valve_simulator"], build.commands(values["command_source"])
    )
    trace = offline(run)
    found = measured(trace, trace.command, 10.0)
    frequency, value, _ = found.curve()
    s = 2j * np.pi * frequency
    model = np.polyval(SECOND_ORDER.numerator, s) / np.polyval(SECOND_ORDER.denominator, s)
    assert found.saturated_from is None and len(frequency) == 18
    assert np.allclose(value, model / SECOND_ORDER.static_gain, rtol=2e-3, atol=2e-4)
    level, phase = measured_corners(found.response, 1.0)
    assert level == pytest.approx(6.3, abs=0.15) and phase == pytest.approx(6.4, abs=0.15)


@pytest.mark.parametrize("model", ["second_order", "fourth_order"])
def test_static_gain_of_the_valve(simulate, model):
    changes = {"valve": model, "gain_scale": 1.2, "flow_force": 0.1}
    valve = updated(VALVE, defaults(VALVE), changes)
    run = simulate("open_loop", np.full(3000, 1.0), valve=changes)
    assert run.position[-1] / run.voltage[-1] == pytest.approx(valve_gain(valve), rel=1e-6)


def test_trace_survives_its_file_and_fills_what_was_not_heard(tmp_path, simulate):
    run = simulate("pid", np.full(50, 0.1), valve={"lvdt.noise": 0.01})
    measurement, voltage = run.measurement.copy(), run.voltage.copy()
    voltage[7] = np.nan
    trace = heard(run, measurement, voltage)
    assert trace.filled == 1 and np.array_equal(trace.voltage, run.voltage) and trace.source == "nodes"
    save(tmp_path / "t.npz", trace)
    back = load(tmp_path / "t.npz")
    assert back.source == "nodes" and back.filled == 1 and back.period == run.period
    assert all(np.array_equal(getattr(back, n), getattr(trace, n)) for n in ("command", "measurement"))


def test_frequencies_at_which_the_amplifier_saturates_are_left_out(config):
    planned = next(j for j in paper_runs(valve_of(str(config / CONFIG))) if j.name == "response_designed")
    values = values_of(planned, files.load(str(config / CONFIG)))
    run = simulation.simulate(
        values["controller"], values["valve_simulator"], build.commands(values["command_source"])
    )
    trace = offline(run)
    found = measured(trace, trace.command, 10.0)
    assert found.saturated_from is not None
    assert np.max(found.response.frequency) < found.saturated_from
    assert "saturates" in found.said("x")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("/**/controller:\n  ros__parameters: {controller: arc}\n", "no parameters of valve_simulator"),
        ("/**/valve_simulator:\n  ros__parameters: {flow_force: -1.5}\n", "does not stay where it is"),
    ],
)
def test_files_that_hold_no_usable_valve(tmp_path, monkeypatch, capsys, text, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "v.yaml").write_text(text)
    assert said in refused(capsys, "--config", "v.yaml")
    assert not (tmp_path / "out").exists()
