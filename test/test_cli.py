# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The command as a user or another program runs it: its output, its exit status."""

import json
import subprocess
import sys

import numpy as np
import pytest

from valve_control.control import compiling


def test_contract_of_simulate_as_a_process(config):
    words = [
        "simulate", "--controller", "arc", "--valve", "fourth_order", "--scenario", "point_to_point",
        "--sample-period", "0.001", "--duration", "6.0", "--seed", "1", "--set", "arc.k1=120.0",
        "--params-file", config / "arc.yaml", "--json", "-",
    ]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "valve_control.cli", *words], capture_output=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["controller"] == "arc"
    assert set(result["indices"]) == {"e_M", "e_F", "e_rms", "u_rms", "c_u"}
    assert set(result["true_error"]) == {"e_M", "e_rms"}
    assert len(result["theta"]) == 4 and result["theta"] != [20.0, 1200.0, 1200.0, 0.0]
    assert 0.0 < result["indices"]["e_rms"] < result["indices"]["e_M"] < 0.2


def test_command_from_csv_and_npy_and_all_outputs(run, tmp_path):
    command = np.sin(np.arange(1500) * 0.01)
    np.savetxt(tmp_path / "c.csv", command)
    np.save(tmp_path / "c.npy", command)
    files = {k: tmp_path / f"out.{k}" for k in ("json", "csv", "npz", "png")}
    done = run(
        "simulate", "--command", tmp_path / "c.csv", "--json", files["json"], "--csv", files["csv"],
        "--npz", files["npz"], "--figure", files["png"],
    )  # fmt: skip
    assert done.status == 0, done.err
    for path in files.values():
        assert f"wrote {path}" in done.out
    with np.load(files["npz"]) as traces:
        assert np.allclose(traces["command"], command)
        header = files["csv"].read_text().splitlines()[0].split(",")
        assert header == list(traces)
        table = np.loadtxt(files["csv"], delimiter=",", skiprows=1)
        assert np.allclose(table[:, header.index("voltage")], traces["voltage"])
    assert files["png"].read_bytes()[:4] == b"\x89PNG"
    from_npy = run("simulate", "--command", tmp_path / "c.npy", "--json", "-")
    assert json.loads(from_npy.out) == json.loads(files["json"].read_text())


def test_commands_come_offline_as_a_node_would_get_them(run):
    def e_rms(*options):
        done = run("simulate", "--scenario", "sine", "--duration", "2", "--json", "-", *options)
        assert done.status == 0, done.err
        return json.loads(done.out)["true_error"]["e_rms"]

    usual = e_rms()
    assert e_rms("--command-period", "0.001") == usual
    lag = ("--set", "command.lag=0.005")
    assert usual < e_rms(*lag) < e_rms("--command-period", "0.02", "--command-jitter", "0.005", *lag)
    assert e_rms("--command-drift", "300", "--command-jitter", "0.0005") < 1.02 * usual


@pytest.mark.parametrize(("form", "low", "high"), [("paper", 0.4, 1.0), ("braking", 0.0, 0.2)])
def test_overshoot_of_steps_is_told_and_braking_in_time_takes_it_away(run, config, form, low, high):
    done = run(
        "simulate", "--scenario", "step", "--duration", "2",
        "--params-file", config / "d3fxe_experiment.yaml",
        "--params-file", config / "tuned" / "d3fxe_experiment_dcarc.yaml", "--set", f"reshaping.form={form}",
        "--set", "start=0.5", "--json", "-",
    )  # fmt: skip
    assert done.status == 0, done.err
    assert low < json.loads(done.out)["steps"]["overshoot"] < high


def test_without_numba_a_run_has_the_same_bits(run, monkeypatch):
    """`make demo` installs none."""
    words = ["simulate", "--controller", "dcarc", "--valve", "solenoid", "--duration", "0.5", "--json", "-"]
    compiled = json.loads(run(*words).out)
    monkeypatch.setattr(compiling.importlib.util, "find_spec", lambda name: None)
    plain = run(*words)
    assert plain.status == 0 and json.loads(plain.out) == compiled


def test_the_demo_shows_one_valve_under_five_laws(run, tmp_path):
    """Uncontrolled it stops half way; dcarc has less than half of the error of the best PID."""
    done = run("demo", "--figure", "picture.png")
    assert done.status == 0 and (tmp_path / "picture.png").stat().st_size > 30_000
    errors = {row[:14].strip(): float(row[14:32]) for row in done.out.splitlines()[1:6]}
    assert list(errors) == ["uncontrolled", "best PID", "ARC", "OARC", "dcarc"]
    assert errors["uncontrolled"] > 30.0 and 2.0 * errors["dcarc"] < errors["best PID"] < 4.0
    refused = run("demo", "--figure", "no_folder/picture.png")
    assert refused.status == 2 and "no_folder" in refused.err and not refused.out


def test_a_trajectory_is_what_gains_for_preview_are_tuned_for(run, config):
    """Without it they have six times the error."""
    words = ["simulate", "--params-file", str(config / "d3fxe.yaml"), "--json", "-"]
    tuned = ["--params-file", str(config / "tuned/narrow_0.25_dcarc.yaml")]
    motion = ["--command", str(config / "commands/fast_strokes.csv")]
    errors = [
        json.loads(run(*words, *tuned, *motion, *more).out)["indices"]["e_rms"]
        for more in ((), ("--preview",), ("--set", "message=trajectory"))
    ]
    assert 6.0 * errors[1] < errors[0] and errors[2] == errors[1]
    refused = run(*words, "--preview", "--command-period", "0.005")
    assert refused.status == 2 and "points of a trajectory have their times" in refused.err


@pytest.mark.parametrize("motion", [["sine", "--set", "frequency=10.0"], ["step"]])
def test_a_figure_says_what_it_is_of(run, tmp_path, config, motion):
    for name in ("x.svg", "y.SVG"):
        done = run(
            "simulate", "--controller", "pid", "--params-file", config / "d3fxe.yaml", "--duration", "3",
            "--figure", name, "--scenario", *motion,
        )  # fmt: skip
        assert done.status == 0, done.err
    text = (tmp_path / "x.svg").read_text()
    assert text.startswith("<?xml") and text == (tmp_path / "y.SVG").read_text()
    assert f"<!-- pid (d3fxe.yaml) on the valve fourth_order: {motion[0]} of " in text
    assert " mV rms, " in text and " % of stroke -->" in text and "e+0" not in text


LAWS = ("dcarc", "pid", "arc")


@pytest.mark.parametrize("order", [LAWS, LAWS[::-1], LAWS[:1]])
def test_compare_runs_each_law_with_its_own_file(order, run, config):
    """However the files are ordered, a law has the errors that `simulate` gives with its file alone."""
    tuned = {law: config / "tuned" / f"d3fxe_experiment_{law}.yaml" for law in LAWS}
    files = [word for law in order for word in ("--params-file", tuned[law])]
    usual = ("--params-file", config / "d3fxe_experiment.yaml", "--duration", "1.0", "--json", "-")
    status, out, _ = run("compare", *usual, *files)
    assert status == 0
    compared = {r["controller"]: r["indices"] for r in json.loads(out)["runs"]}
    for law in LAWS:
        own = ("--params-file", tuned[law]) if law in order else ("--controller", law)
        assert compared[law] == json.loads(run("simulate", *usual, *own)[1])["indices"], law
