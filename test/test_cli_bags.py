# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The command on bags, as a user or another program runs it."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / "recordings"))
from made import Run, write

REAL = Path(__file__).parent / "data" / "bags"


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    arc = Run()
    arc.move(1200)
    arc.change(arc__k1=100.0)
    arc.move(800)
    oarc = Run(controller={"controller": "oarc"})
    oarc.move(2000)
    boom, arm = Run(namespace="/boom"), Run(2, namespace="/arm")
    boom.move(300)
    arm.move(300)
    write(folder / "arc", arc.messages)
    write(folder / "oarc", oarc.messages, "sqlite3")
    write(folder / "both", boom.messages + arm.messages)
    return folder


def test_analyze_writes_everything_it_says(run, bags, tmp_path):
    files = {k: tmp_path / f"out.{k}" for k in ("json", "csv", "html")}
    done = run(
        "analyze", bags / "arc", "--json", files["json"], "--csv", files["csv"], "--html", files["html"]
    )
    assert done.status == 0, done.err
    for path in files.values():
        assert f"wrote {path}" in done.out
    assert "after change 1: arc.k1 = 100.0" in done.out
    about = json.loads(files["json"].read_text())
    assert about["valves"]["valve"]["controller"] == "arc"
    table = np.genfromtxt(files["csv"], delimiter=",", names=True)
    assert len(table) == 2000
    error = table["measurement_V"] - table["command_V"]
    assert np.allclose(table["error_V"], error)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(about["valves"]["valve"]["indices"]["e_rms"])
    text = files["html"].read_text()
    assert "Plotly.newPlot" in text and "b0dn" in text and "bound of V2" in text


def test_replay_in_shadow_is_the_recording(run, bags, tmp_path):
    done = run("replay", bags / "arc", "--json", tmp_path / "s.json", "--html", tmp_path / "s.html",
                   "--csv", tmp_path / "s.csv")  # fmt: skip
    assert done.status == 0, done.err
    assert "bit for bit" in done.out
    about = json.loads((tmp_path / "s.json").read_text())
    assert about["bit_equal"] is True and about["samples"] == 2000 and about["mode"] == "shadow"
    table = np.genfromtxt(tmp_path / "s.csv", delimiter=",", names=True)
    assert np.array_equal(table["recorded_voltage_V"], table["shadow_voltage_V"])
    other = run("replay", bags / "arc", "--controller", "pid", "--json", "-")
    assert json.loads(other.out)["bit_equal"] is False


def test_simulate_takes_command_and_parameters_of_a_bag(run, bags, tmp_path):
    log = tmp_path / "log.csv"
    recorded = json.loads(run("analyze", bags / "oarc", "--csv", log, "--json", "-").out)["valves"]["valve"]
    done = run("simulate", "--command", bags / "oarc", "--set", "oarc.ks1=200.0", "--json", "-",
                   "--csv", tmp_path / "s.csv")  # fmt: skip
    assert done.status == 0, done.err
    about = json.loads(done.out)
    assert about["controller"] == "oarc" and about["duration"] == pytest.approx(2.0, abs=0.002)
    assert about["indices"]["e_rms"] == pytest.approx(recorded["indices"]["e_rms"], rel=0.5)
    measured, simulated = (np.genfromtxt(p, delimiter=",", names=True) for p in (log, tmp_path / "s.csv"))
    assert np.sqrt(np.mean((measured["measurement_V"] - simulated["measurement"]) ** 2)) < 0.05
    maps = ("--map", "spool_command=command_V", "--map", "spool_position=measurement_V")
    done = run("simulate", "--command", log, *maps, "--controller", "oarc", "--json", "-")
    table = json.loads(done.out)
    assert done.status == 0 and "no parameters of a controller" in done.err
    assert table["duration"] == about["duration"] and table["controller"] == "oarc"
    assert table["indices"]["e_rms"] == pytest.approx(recorded["indices"]["e_rms"], rel=0.5)


def test_the_signals_of_a_bag_as_a_table_are_the_bag(run, bags, tmp_path):
    """What ``--csv`` writes can be analysed and replayed, and has the indices of the bag."""
    log = tmp_path / "log.csv"
    assert run("analyze", bags / "arc", "--csv", log, "--to", "1.1").status == 0
    parts = ("spool_command=command_V", "spool_position=measurement_V", "valve_voltage=voltage_V")
    maps = [word for part in parts for word in ("--map", part)]
    done = run("analyze", log, *maps)
    assert done.status == 0 and "log.csv: csv, " in done.out and "0 s by column time_s" in done.out, done.err
    done = run("replay", log, *maps, "--json", "-")
    about = json.loads(done.out)
    assert about["bit_equal"] is True and about["samples"] == len(log.read_text().splitlines()) - 1
    bag = json.loads(run("analyze", bags / "oarc", "--csv", log, "--json", "-").out)["valves"]["valve"]
    table = json.loads(run("analyze", log, *maps, "--json", "-").out)["valves"]["valve"]
    assert table["indices"]["e_rms"] == pytest.approx(bag["indices"]["e_rms"], rel=1e-12)
    done = run("bag", "recover", log)
    assert done.status == 2 and "is a table" in done.err


def test_recover_says_what_it_did(run, bags, tmp_path):
    shutil.copytree(bags / "arc", tmp_path / "bag")
    done = run("bag", "recover", tmp_path / "bag")
    assert done.status == 0 and "nothing was written" in done.out
    (file,) = (tmp_path / "bag").glob("*.mcap")
    whole = file.read_bytes()
    file.write_bytes(whole[:-700])
    (tmp_path / "bag" / "metadata.yaml").unlink()
    torn = run("analyze", tmp_path / "bag")
    assert torn.status == 0 and "unfinished" in torn.out and "bag recover" in torn.out
    done = run("bag", "recover", tmp_path / "bag", "--json", tmp_path / "r.json")
    about = json.loads((tmp_path / "r.json").read_text())
    copy = tmp_path / "bag_recovered"
    assert done.status == 0 and f"wrote {copy}: {about['messages']} messages" in done.out, done.err
    repaired = run("analyze", copy)
    assert repaired.status == 0 and "unfinished" not in repaired.out
    assert file.read_bytes() == whole[:-700]
    file.write_bytes(b"")
    done = run("bag", "recover", tmp_path / "bag")
    assert done.status == 2 and "is empty" in done.err


def test_a_real_bag_with_a_mapped_field(run, tmp_path):
    done = run("analyze", REAL / "jazzy_mcap_drone_yaw",
                   "--map", "spool_position=/cf_logpos.position.x*2",
                   "--map", "valve_voltage=/cf_controll.orientation.w", "--json", "-")  # fmt: skip
    assert done.status == 0, done.err
    valve = json.loads(done.out)["valves"]["valve"]
    assert valve["timing"]["spool_position"]["messages"] == 88
    assert valve["sources"]["spool_position"] == "/cf_logpos.position.x*2"
    assert valve["indices"]["e_rms"] is None and valve["indices"]["u_rms"] is not None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["analyze", REAL / "jazzy_mcap_drone_yaw"], ["spool_position", "/cf_logpos", "--map"]),
        (["analyze", "{arc}", "--from", "900"], ["no message"]),
        (["replay", "{both}"], ["boom", "arm", "--of"]),
        (["replay", "{arc}", "--set", "arc.k1=-1"], ["arc.k1", "between"]),
        (["replay", "{arc}", "--set", "amplitude=1"], ["recorded command", "amplitude"]),
        (["simulate", "--command", "{arc}", "--set", "sample_period=0.5"], ["sample_period"]),
        (["simulate", "--command", "{arc}", "--set", "amplitude=1"], ["recorded command", "amplitude"]),
        (["simulate", "--command", "{arc}", "--duration", "1"], ["with a bag takes no --duration"]),
        (["simulate", "--command", "{both}"], ["boom", "arm", "--of"]),
        (["simulate", "--from", "1"], ["without a bag takes no --from"]),
        (["analyze", "{both}", "--csv", "x.csv", "--html", "x_arm.csv"], ["x_arm.csv", "two outputs"]),
        (["bag", "recover", REAL / "README.md"], ["README.md"]),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(run, bags, arguments, words):
    names = {name: bags / name for name in ("arc", "oarc", "both")}
    status, out, err = run(*(str(a).format(**names) for a in arguments))
    assert status == 2 and out == "", out + err
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    for word in words:
        assert word in lines[0], lines[0]
