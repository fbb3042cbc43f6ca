# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The command as a user or another program runs it: its output, its exit status."""

import json
import subprocess
import sys

import numpy as np
import pytest


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


def test_seed_and_settings_reach_the_run(run):
    def e_rms(*arguments):
        done = run("simulate", "--duration", "1.0", "--set", "lvdt.noise=0.01", "--json", "-", *arguments)
        return json.loads(done.out)["indices"]["e_rms"]

    assert e_rms("--seed", "3") == e_rms("--seed", "3")
    assert e_rms("--seed", "3") != e_rms("--seed", "4")
    assert e_rms("--set", "arc.k1=60") != e_rms()
    assert e_rms("--set", "friction.coulomb=1.0") != e_rms()


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


def test_compare_lists_every_controller(run, tmp_path):
    done = run("compare", "--duration", "1.0", "--json", tmp_path / "c.json")
    assert done.status == 0, done.err
    result = json.loads((tmp_path / "c.json").read_text())
    assert [r["controller"] for r in result["runs"]] == [
        "arc",
        "oarc",
        "dcarc",
        "pid",
        "compensator",
        "open_loop",
    ]
    assert result["paper"]["arc"]["c_u"] == 0.416
    assert done.out.count("paper") == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--controller", "lqr"], ["lqr", "arc"]),
        (["--set", "arc.k1=fast"], ["arc.k1", "fast", "double"]),
        (["--set", "arc.kk1=5.0"], ["arc.kk1", "arc.k1"]),
        (["--set", "arc.k1"], ["name=value"]),
        (["--set", "arc.gamma=[1.0, 2.0]"], ["arc.gamma", "4"]),
        (["--set", "oarc.theta_min=[200.0, 500.0, 900.0, 0.0]"], ["oarc.theta_min[0]", "above"]),
        (["--set", "arc.theta_min=[5.0, 500.0, -1.0, 0.0]"], ["arc.theta_min[2]", "positive"]),
        (["--sample-period", "0"], ["sample_period", "between"]),
        (["--sample-period", "0.01"], ["reshaping.natural_frequency", "below"]),
        (["--command", "none.csv"], ["none.csv", "cannot be read"]),
        (["--command", "words.csv"], ["words.csv", "one number a line"]),
        (["--command", "empty.csv"], ["empty.csv"]),
        (["--command", "nan.csv"], ["nan.csv", "nan", "entry 2"]),
        (["--command", "flat.npy"], ["flat.npy"]),
        (["--command", "plane.npy"], ["plane.npy", "(3, 3)"]),
        (["--params-file", "none.yaml"], ["none.yaml", "cannot be read"]),
        (["--params-file", "bad.yaml"], ["bad.yaml", "YAML"]),
        (["--params-file", "wrong.yaml"], ["wrong.yaml", "arc.k1", "120.0, not 120"]),
        (["--params-file", "flat.yaml"], ["flat.yaml", "ros__parameters"]),
        (["--json", "no/such/folder/out.json"], ["out.json", "no folder"]),
        (["--figure", "."], [".", "folder"]),
        (["--set", "cycle=0.5"], ["cycle", "takes"]),
        (["--set", "valve=custom", "--set", "denominator=[1.0, 1.0]"], ["order 2 to 4"]),
        (["--set", "pid.break_frequency=0.5"], ["pid.break_frequency", "negative"]),
    ],
)
def test_bad_input_is_one_sentence(run, tmp_path, arguments, words):
    (tmp_path / "words.csv").write_text("one\ntwo\n")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "nan.csv").write_text("1.0\nnan\n")
    (tmp_path / "flat.npy").write_bytes(b"not numpy")
    np.save(tmp_path / "plane.npy", np.zeros((3, 3)))
    (tmp_path / "bad.yaml").write_text("a: [1, 2\n")
    (tmp_path / "flat.yaml").write_text("controller: {arc: 1}\n")
    (tmp_path / "wrong.yaml").write_text("controller:\n  ros__parameters:\n    arc: {k1: 120}\n")
    done = run("simulate", *arguments)
    assert done.status == 2
    assert done.out == ""
    lines = done.err.strip().splitlines()
    assert len(lines) == 1, done.err
    for word in words:
        assert word in lines[0]


def test_help_shows_examples_and_defaults(run):
    done = run("--help")
    assert done.status == 0 and "examples:" in done.out
    assert "--params-file" in run("simulate", "--help").out
    assert "arc.epsilon" in run("parameters", "arc").out
    assert "valve_driver: serial.port" in run("parameters", "serial.port").out
