# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The tasks as functions: same numbers as the command line, arrays, and errors of one sentence."""

import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot

import valve_control as vc
from valve_control.api import NODES, _Call
from valve_control.cli import main
from valve_control.control.simulation import robustness

ROOT = Path(__file__).parents[1]
VALVE = ROOT / "docs/examples/my_valve.yaml"
MOTION = np.sin(2.0 * np.pi * 2.0 * np.arange(0.0, 1.5, 0.001))
NAMES = {"spool_command": "command", "spool_position": "measurement", "valve_voltage": "voltage"}


def test_a_function_gives_what_the_command_writes(tmp_path, capsys):
    np.save(tmp_path / "motion.npy", MOTION)
    line = ["simulate", f"--params-file={VALVE}", "--controller=pid", f"--command={tmp_path / 'motion.npy'}"]
    assert main([*line, "--set=lvdt.noise=0.002", f"--json={tmp_path / 'a.json'}"]) == 0
    run = vc.simulate(vc.load(VALVE), controller="pid", command=MOTION, set={"lvdt.noise": 0.002})
    assert dict(run) == json.loads((tmp_path / "a.json").read_text())
    assert capsys.readouterr().out.startswith(run.text) and run.passed
    error = run.arrays["position"] - run.arrays["command"]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(run["true_error"]["e_rms"], rel=1e-9)
    assert "<pre>" in run._repr_html_() and len(run.to_dataframe()) == len(MOTION)
    assert run.plot().get_suptitle() == "pid (my_valve.yaml) on the valve custom: command"
    laws = vc.compare(VALVE, controller="pid, oarc", command=np.zeros(9)).to_dataframe()["law"]
    assert laws.tolist() == ["pid", "oarc"] and "does not move in 9 samples" in capsys.readouterr().err
    assert vc.compare(VALVE, duration=1.0).to_dataframe()["law"].tolist()[:2] == ["arc", "oarc"]


def test_the_loop_of_margins_has_the_phase_margin_that_it_tells():
    found = vc.margins(VALVE, controller="pid")
    table = found.to_dataframe()
    loop = np.asarray(table["real"] + 1j * table["imaginary"])
    crossover = np.flatnonzero(np.abs(loop) > 1.0)[-1]
    margin = 180.0 + np.degrees(np.angle(loop[crossover]))
    assert margin == pytest.approx(found["margins"]["this valve"]["phase_deg"], abs=2.0)


def test_a_figure_can_be_changed_and_leaves_those_of_the_user_alone():
    pyplot.figure(7)
    position, error, voltage = vc.simulate(VALVE, controller="pid", command=MOTION).plot().axes
    assert (position.get_ylabel(), voltage.get_ylabel()) == ("spool position [V]", "voltage [V]")
    assert len(error.lines[0].get_xdata()) == len(MOTION) and pyplot.fignum_exists(7)
    pyplot.close("all")


def test_the_law_of_a_run_gives_the_same_voltages_in_a_loop_of_the_user():
    run = vc.simulate(VALVE, controller="dcarc", command=1.2 * MOTION, set={"command_limit": 1.0})
    voltage = run.law()
    signals = zip(1.2 * MOTION, run.arrays["measurement"], strict=True)
    assert [voltage(*row) for row in signals] == list(run.arrays["voltage"])
    pytest.raises(KeyError, run.__getitem__, "e_rms").match("e_rms; there are .*indices")


def test_parameters_go_from_one_task_to_the_next(tmp_path, capsys):
    sheet = vc.identify(data_sheet={"natural_frequency": 14.0, "damping": 1.0, "full_stroke": 9.0})
    assert sheet.parameters is not None
    sheet.parameters.save(tmp_path / "sheet.yaml")
    loaded = vc.load(tmp_path / "sheet.yaml")
    assert (loaded.text, loaded.values) == (sheet.parameters.text, sheet.parameters.values)
    assert loaded["numerator"] == loaded.values["valve_simulator"]["numerator"]
    assert "damping" in vc.identify(data_sheet=[])
    vc.simulate({node: {"sample_period": np.float64(0.002)} for node in list(NODES)[:3]}, command=MOTION)
    assert "note: 1500 numbers at a sample period of 2 ms (parameters.yaml): 3 s" in capsys.readouterr().err
    whole = {"valve": "custom", "numerator": [6964], "denominator": np.array([1, 158, 7738]), "lvdt.noise": 0}
    floats = {**whole, "numerator": [6964.0], "denominator": [1.0, 158.0, 7738.0], "lvdt.noise": 0.0}
    runs = [vc.simulate({"valve_simulator": valve}, duration=1.0) for valve in (whole, floats)]
    assert dict(runs[0]) == dict(runs[1])
    assert dict(vc.margins(sheet.parameters, controller="dcarc")) == dict(
        vc.margins(tmp_path / "sheet.yaml", controller="dcarc")
    )


def test_a_log_of_arrays_is_analysed(tmp_path):
    run = vc.simulate(VALVE, controller="arc", command=MOTION)
    columns = ("time", *NAMES.values())
    table = np.column_stack([run.arrays[name] for name in columns])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(columns), comments="")
    report = vc.analyze(tmp_path / "log.csv", map=NAMES)
    assert np.allclose(report.arrays["measurement_V"], run.arrays["measurement"])
    assert report.page is not None and "</html>" in report.page
    assert "iframe" in report._repr_html_()


@pytest.mark.parametrize(
    "task, sentence",
    [
        (lambda: vc.simulate(controler="pid"), "^simulate has no option controler; did you mean 'contr"),
        (lambda: vc.simulate(dur=1.0), "no option dur; did you mean 'duration'"),
        (lambda: vc.simulate(controller=json), "give the descriptor: json.LAW"),
        (lambda: vc.tune(valves=None), "none is no whole number"),
        (lambda: vc.analyze(MOTION), "a ndarray is no file; write it with to_csv"),
        (lambda: vc.compare(controller="pid,pdi"), "^controller: there is no law 'pdi'; did you mean 'pid'"),
        (lambda: vc.simulate(command=np.zeros((3, 2))), "is no motion"),
        (lambda: vc.simulate(VALVE, MOTION), "a motion is command="),
        (lambda: vc.simulate({"valve_simulator": {"numerator": [1.0]}}), "^numerator has no effect"),
        (lambda: vc.simulate(command=[MOTION, MOTION]), "command has 2 entries"),
        (lambda: vc.simulate(command=1j * MOTION), "is no motion"),
        (lambda: vc.simulate({"damping": 0.7}), "a dict by node"),
        (lambda: vc.load("missing.yaml"), "missing.yaml"),
        (lambda: vc.simulate(controller="lqg"), "there are arc, .*one of your own: docs/tutorials/your"),
        (lambda: vc.simulate(duration=1.0).law()(MOTION, MOTION), "takes one sample a call: two floats"),
        (lambda: vc.simulate(set={"arc.k9": 1.0}), "no parameter 'arc.k9'"),
        (lambda: vc.simulate(command=[]), "command has 0 entries"),
        (lambda: vc.simulate(command=1.0), "command is a float; give one array"),
        (lambda: vc.simulate(controller=print), "controller is a builtin_function.*the LAW of your file"),
        (lambda: vc.simulate(preview="yes"), "^preview is a switch: True or False$"),
        (lambda: vc.identify("log.csv"), "^log.csv is a table; give it as bag="),
        (lambda: vc.simulate(command=(MOTION, MOTION)), "simulate takes one array .* without the times"),
        (lambda: vc.simulate({"valve": {"damping": 0.7}}), "a dict by node: .*the nodes are controller"),
        (lambda: vc.simulate(vc.identify(data_sheet=[])), "a Result is no parameters; give .*parameters"),
        (lambda: vc.simulate(duration="long"), "^duration: invalid float value: 'long'$"),
        (lambda: vc.simulate(start=1.0), "^simulate without a bag takes no start$"),
        (lambda: vc.simulate(npz="traces.npz"), "npz is of the command line"),
        (lambda: vc.simulate(command=[float("nan"), 1.0]), "^command has nan in entry 1$"),
        (lambda: vc.simulate({"controller": {"arc.k9": 1.0}}), "^there is no parameter 'arc.k9'"),
        (lambda: vc.margins(VALVE).plot(), "margins has no figure"),
        (lambda: vc.margins(VALVE).law(), "margins gives no law"),
        (lambda: vc.identify(data_sheet=[]).to_dataframe(), "identify gives no table"),
        (lambda: vc.simulate(params_file="missing.yaml"), "missing.yaml"),
        (lambda: vc.identify(data_sheet={"natural_frequency": "18 Hz"}), "^natural_frequency is '18 Hz'; it"),
        (lambda: vc.tune(controller="pid,dcarc"), "tune takes one law"),
    ],
)
def test_bad_input_is_one_sentence(task, sentence, capsys):
    with pytest.raises(vc.ParameterError, match=sentence) as error:
        task()
    assert "\n" not in str(error.value) and not capsys.readouterr().err


def test_help_of_tune_has_units_and_defaults_and_none_switches_a_limit_off():
    assert "%(" not in vc.tune.__doc__ and "overshoot (%): largest overshoot of steps (5)" in vc.tune.__doc__
    assert "--" not in vc.tune.__doc__ and all(q.name in vc.tune.__doc__ for q in robustness.BOX)
    assert "repeated" not in vc.tune.__doc__ and "map (dict)" in vc.identify.__doc__
    assert "command (array or file, or a list)" in vc.tune.__doc__
    words = _Call("tune", (), (), {"overshoot": None, "duration": None})._options(Path())
    assert words == ["--overshoot=none"]


@pytest.mark.parametrize("task", [vc.simulate, vc.tune, vc.identify, vc.replay])
def test_the_signature_has_the_options_with_their_defaults(task):
    keywords = {p.name: p.default for p in inspect.signature(task).parameters.values()}
    assert {"set", "controller"} & keywords.keys() and not {"options", "json", "help"} & keywords.keys()
    assert keywords.get("max_chatter", 0.25) == 0.25 and keywords.get("set") is None


@pytest.mark.campaign
def test_the_notebook_runs():
    cells = json.loads((ROOT / "docs/tutorials/notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    program = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True, text=True, timeout=900, cwd=ROOT / "docs/tutorials",
        env={**os.environ, "MPLBACKEND": "Agg"},
    )  # fmt: skip
    assert done.returncode == 0 and "passed: True" in done.stdout, done.stderr
