# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""identify as a user runs it: outputs that other commands take, bad input."""

import json
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from said import sentences

from valve_control.control.commands import scenarios
from valve_control.control.parameters import build
from valve_control.control.parameters.table import COMMAND
from valve_control.control.plant.transfer_functions import FOURTH_ORDER
from valve_control.design.identification import bode
from valve_control.parameter import defaults, updated

sys.path.insert(0, str(Path(__file__).parent / "recordings"))
from made import Run, write

QUICK = ["--set", "steps=12", "--set", "cycles=4", "--set", "frequency=1.0", "--set", "step_time=0.8"]


def test_a_sample_period_that_does_not_fit_the_valve_is_said(run):
    """And what it writes can be simulated at its own period."""
    status, out, err = run("identify", *QUICK, "--sample-period", "0.02", "--output", "valve.yaml")
    assert status == 0 and "ms is the longest that its model and gains" in out, err
    status, out, err = run("simulate", "--controller", "pid", "--params-file", "valve.yaml", "--json", "-")
    assert status == 0 and json.loads(out)["warning"] is None, err


def test_identified_model_goes_into_simulate(run, tmp_path):
    status, out, err = run(
        "identify", *QUICK, "--set", "lvdt.noise=0.005", "--output", "valve.yaml", "--json", "r.json",
        "--figure", "bode.svg",
    )  # fmt: skip
    assert status == 0, err
    for name in ("valve.yaml", "r.json", "bode.svg"):
        assert f"wrote {name}" in out
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bode.svg", "r.json", "valve.yaml"]
    result = json.loads((tmp_path / "r.json").read_text())
    assert [fit["order"] for fit in result["fits"]] == [2, 4] and result["best_order"] == 4
    a0 = result["fits"][1]["coefficients"]["a0"]
    assert abs(a0["value"] - 56553725.0) < 2.0 * a0["bound"] < 0.1 * 56553725.0
    assert abs(result["fits"][1]["minus_90_hz"] - 6.17) < 0.05
    assert (tmp_path / "bode.svg").read_text().startswith("<?xml")
    tree = yaml.safe_load((tmp_path / "valve.yaml").read_text())
    assert tree["/**/controller"]["ros__parameters"]["arc"]["theta_initial"] == result["theta"]["initial"]
    simulated = tree["/**/valve_simulator"]["ros__parameters"]  # from which tune takes its noise
    assert simulated["lvdt"]["noise"] == pytest.approx(0.005, rel=0.1)
    assert simulated["lvdt"]["resolution"] == result["lvdt"]["resolution"]
    for controller in ("pid", "arc", "oarc", "dcarc", "compensator"):
        status, out, err = run(
            "simulate", "--controller", controller, "--params-file", "valve.yaml", "--json", "-"
        )
        assert status == 0, err
        assert json.loads(out)["indices"]["e_rms"] < 0.05


def test_a_valve_of_a_data_sheet_runs_with_every_law(run, tmp_path):
    """The file has the valve as it was given, and each law follows better than the valve alone."""
    given = ["identify", "--data-sheet", "natural_frequency=18", "full_stroke=10.5", "lvdt.noise=0.005"]
    status, out, err = run(*given, "--output", "valve.yaml", "--json", "r.json")
    assert status == 0 and "-90° at 18.00 Hz" in out, err
    found = json.loads((tmp_path / "r.json").read_text())
    omega = 2.0 * np.pi * 18.0
    expected = [1.6 * omega, omega**2, 1.05 * omega**2]
    assert found["theta"]["initial"][:3] == pytest.approx(expected, rel=1e-5)
    assert found["notes"] == [] and found["model"]["static_gain"] == pytest.approx(1.05)
    motion = ["--params-file", "valve.yaml", "--scenario", "sine", "--set", "frequency=5.0", "--json", "-"]
    errors = {}
    for law in ("open_loop", "pid", "arc", "oarc", "dcarc"):
        status, out, err = run("simulate", "--controller", law, *motion, "--duration", "2")
        assert status == 0 and json.loads(out)["warning"] is None, err
        errors[law] = json.loads(out)["true_error"]["e_rms"]
    assert max(errors[law] for law in errors if law != "open_loop") < 0.5 * errors["open_loop"]


def recorded(tmp_path, name, length, **own):
    """A bag of a test without feedback on a valve with friction."""
    values = updated(COMMAND, defaults(COMMAND), {**own, "duration": 60.0})
    shape = build.shape(values)
    rubbing = {"friction.coulomb": 0.6, "friction.presliding": 0.02}
    made = Run(controller={"controller": "open_loop"}, simulator=rubbing, memory_every=10**9)
    made.say("/command_source", values, new=True)
    for k in range(round((shape.start + length + 0.1) / 0.001)):
        made.sample(scenarios.command(shape, k * 0.001))
    write(tmp_path / name, made.messages)
    return made


def test_recorded_tests_with_and_without_parameters(run, tmp_path):
    """A stepped sine in a bag, without the parameters and some readings, and in a table; a slow triangle."""
    steps = {"frequency": 1.5, "end_frequency": 60.0, "steps": 8, "cycles": 4, "step_time": 0.6}
    length = scenarios.sine_steps(*steps.values())[-1].end
    made = recorded(tmp_path, "told", length, scenario="stepped_sine", amplitude=4.0, **steps)
    recorded(tmp_path, "slow", 10.0, scenario="triangle", frequency=0.4, cycles=4, amplitude=3.0)
    lost = {300, 2000, 2001, 5000}
    write(
        tmp_path / "bare",
        made.messages,
        keep=lambda m: (
            m.topic in ("/spool_position", "/valve_voltage")
            and not (m.topic == "/spool_position" and m.sequence in lost)
        ),
    )
    milliampere = np.column_stack([(np.array(made.readings) + 15.0) / 1.25, made.voltages])
    np.savetxt(tmp_path / "log.csv", milliampere, delimiter=";", header="lvdt_mA;u", comments="")
    columns = ("time=row*0.001", "spool_position=lvdt_mA*1.25-15", "valve_voltage=u")
    maps = [word for text in columns for word in ("--map", text)]
    responses = []
    for name, options in {"told": [], "log.csv": maps, "bare": ["--friction", "slow"]}.items():
        status, out, err = run("identify", name, "--settle", "0.25", "--json", "-", *options)
        assert status == 0, err
        result = json.loads(out)
        assert len(result["response"]["frequency_hz"]) == 8
        assert any("4 of" in note for note in result["notes"]) == (name == "bare")
        responses.append(result["response"]["real"])
    np.testing.assert_allclose(responses[1], responses[0], atol=1e-6)
    assert abs(result["friction"]["coulomb"] - 0.6) < 0.02
    assert abs(result["friction"]["presliding"] / 0.02 - 1.0) < 0.12
    assert abs(result["fits"][-1]["static_gain"]["value"] / 0.829 - 1.0) < 0.02
    for words, said in (
        (["told", "--friction", "told"], "must be a triangle"),
        (["told", "--friction", "log.csv", *maps], "--map counts for both tests"),
        (["told", "--seed", "3"], "takes no --seed"),
    ):
        status, _, err = run("identify", *words)
        assert status == 2 and said in err


def test_friction_comes_from_a_triangle_and_goes_into_simulate(run, tmp_path):
    rubbing = {"coulomb": 0.8, "presliding": 0.02}
    given = [f"friction.{name}={value}" for name, value in rubbing.items()]
    settings = [part for text in (*given, "lvdt.noise=0.005") for part in ("--set", text)]
    status, out, err = run(
        "identify", *QUICK, *settings, "--friction", "--output", "valve.yaml", "--json", "r.json",
        "--characteristic", "curve.svg", "--characteristic", "curve.yaml",
    )  # fmt: skip
    assert status == 0, err
    whole = json.loads((tmp_path / "r.json").read_text())
    found, curve = whole["friction"], whole["characteristic"]
    assert abs(curve["hysteresis"]["value"] - 1.6) < 0.03 and abs(curve["overlap"]["value"]) < 0.02
    assert len(curve["rising"]) == 100 and (tmp_path / "curve.svg").read_text().startswith("<?xml")
    assert abs(found["coulomb"] - 0.8) < 0.02
    assert abs(found["presliding"] / 0.02 - 1.0) < 0.12
    tree = yaml.safe_load((tmp_path / "valve.yaml").read_text())
    valve = tree["/**/valve_simulator"]["ros__parameters"]
    assert abs(valve["friction"]["coulomb"] - found["coulomb"]) < 1e-9
    law = tree["/**/controller"]["ros__parameters"]["dcarc"]
    assert abs(law["theta_initial"][2] - found["coulomb"]) < 1e-9
    files = ["--params-file", "valve.yaml", "--params-file", "curve.yaml"]
    status, out, err = run("simulate", "--controller", "dcarc", *files, "--json", "-")
    assert status == 0, err
    assert json.loads(out)["true_error"]["e_rms"] < 0.05


def test_one_step_gives_no_bounds_and_no_order_that_nobody_asked_for(run, tmp_path):
    """Before: order 4, with 95 % bounds that the truth missed in 6 of 7 coefficients."""
    np.savetxt(tmp_path / "step.csv", np.where(np.arange(3000) < 300, 0.0, 2.0))
    test = ["--command", "step.csv", "--band", "0.7", "100", "--set", "lvdt.noise=0.0003", "--seed", "5"]
    status, out, err = run("identify", *test, "--output", "valve.yaml", "--json", "-")
    assert status == 0, err
    result = json.loads(out)
    assert result["best_order"] == 2 and len(result["fits"]) == 1
    told = result["fits"][0]
    assert {one["bound"] for one in [*told["coefficients"].values(), told["static_gain"]]} == {None}
    assert "±" not in (tmp_path / "valve.yaml").read_text()
    status, out, err = run("identify", *test, "--order", "4")
    assert status == 0, err
    assert not any("±" in line for line in out.splitlines() if not line.startswith("note:"))


def test_a_table_under_feedback_is_told_by_its_command(run, tmp_path):
    """Before: a response with bounds, of which the true one was outside."""
    sweep = "--scenario sweep --set sweep_time=15.0 --set end_frequency=30.0 --duration 16 --csv log.csv"
    test = "simulate --controller pid --set lvdt.noise=0.02 --set amplitude=0.5 --set frequency=0.5"
    status, _, err = run(*shlex.split(f"{test} {sweep}"))
    assert status == 0, err
    columns = {"time": "time", "spool_position": "measurement", "valve_voltage": "voltage"}
    maps = [word for part, column in columns.items() for word in ("--map", f"{part}={column}")]
    status, out, err = run("identify", "log.csv", *maps)
    assert (status, out) == (2, "") and "under feedback" in err and "--map spool_command=" in err
    status, out, err = run("identify", "log.csv", *maps, "--map", "spool_command=command", "--json", "-")
    assert status == 0, err
    result = json.loads(out)
    assert any("recorded under feedback" in note for note in result["notes"])
    best, response = result["fits"][-1], result["response"]
    assert abs(best["minus_90_hz"] - 6.174) < 0.2
    frequency, value = np.array(response["frequency_hz"]), np.array(response["real"], dtype=complex)
    value += 1j * np.array(response["imaginary"])
    off = np.abs(value - bode.held_response(FOURTH_ORDER, frequency, 0.001)) / response["deviation"]
    assert np.mean(off**2) / 2.0 < 1.9


def test_a_short_noisy_log_is_refused_with_what_it_lacks(run, tmp_path):
    """Before: "known from 0.88 to 0.88 Hz alone", and no word about why."""
    random = np.random.default_rng(2)
    voltage = np.clip(0.05 * np.cumsum(random.standard_normal(1024)), -1.5, 1.5)
    rows = np.column_stack(
        [0.05 * np.arange(1024), voltage, 0.9 * voltage + 0.3 * random.standard_normal(1024)]
    )
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,u,y", comments="")
    maps = ["--map", "time=t", "--map", "valve_voltage=u", "--map", "spool_position=y"]
    status, out, err = run("identify", "log.csv", *maps)
    assert (status, out) == (2, "")
    *notes, refusal = sentences(err)
    assert all(note.startswith("note: ") for note in notes)
    assert all(
        word in refusal for word in ("coherence with the excitation", "at least", "record a stepped sine")
    )


def test_the_duration_that_a_refusal_names_is_taken(run):
    """Before: "duration is 31.28 s; the stepped sine takes 31.28 s"."""
    for odd in ("12", "17", "23"):
        test = ["identify", "--set", f"steps={odd}", "--set", "cycles=4", "--set", "step_time=0.7"]
        _, _, err = run(*test, "--duration", "1")
        status, _, err = run(*test, "--duration", err.split()[-2])
        assert status == 0, err


REFUSED = [
    ("identify --set cycles=1 --set step_time=0.1", "0 whole cycles after its transient"),
    ("identify --set amplitude=0.0", "does not move"),
    ("identify --set amplitude=10.0", "at its limit of 10 V"),
    ("identify --set end_frequency=600.0", "not below Nyquist's frequency, 500 Hz"),
    ("identify --set steps=3 --order 4", "needs 4 frequencies"),
    ("identify --scenario sine --set lvdt.noise=0.005", "in 70 the excitation does not move; record a"),
    ("identify --set flow_force=-1.3", "the valve is unstable"),
    ("identify --set friction.coulomb=10.0", "which is what friction gives while it holds a spool"),
    (
        "identify --set amplitude=0.5 --set friction.coulomb=0.6 --set friction.presliding=0.02",
        "which is what friction gives while it holds a spool",
    ),
    ("identify --characteristic curve.yaml", "comes from the slow triangle of --friction; give that too"),
    ("identify --friction --characteristic curve.pdf", ".png or .svg"),
    ("identify --sensor-delay -0.001", "--sensor-delay is -0.001 s; it must lie between 0 and 1 s"),
    ("identify --band 5 2", "--band"),
    ("identify --data-sheet damping=0.8", "natural_frequency or step_time; give one of them"),
    ("identify --data-sheet natural_frequency=600", "not below Nyquist's frequency, 500 Hz"),
    ("identify --data-sheet natural_frequency=18 --friction", "so it takes no --friction"),
    ("identify --data-sheet natural_freq=18", "did you mean 'natural_frequency'?"),
    ("identify --set arc.k1=3", "takes no --set arc.k1"),
    ("identify --map spool_position=/x", "takes no --map"),
    ("identify a_bag --friction", "give a bag for both tests or for none"),
]


@pytest.mark.parametrize(("line", "words"), REFUSED)
def test_bad_input_is_one_sentence(run, tmp_path, line, words):
    own = any(word in line for word in ("data-sheet", "a_bag", "steps=", "cycles="))
    task, *options = line.split()
    status, out, err = run(task, *([] if own else QUICK), *options, "--json", "r.json")
    assert status == 2 and out == ""
    assert len(sentences(err)) == 1 and words in err, err
    assert list(tmp_path.iterdir()) == []
