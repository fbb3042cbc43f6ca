# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Modes, parameter changes and the readings' rate as the analysis tells them, from bags of known runs."""

import json

import numpy as np
import pytest
from made import PERIOD, STATUS, Run, diagnostic, write

from valve_control.recordings import analysis_report
from valve_control.recordings.analysis import analyze, as_dict
from valve_control.recordings.recording import load


class Told(Run):
    """A run that keeps the mode of each sample."""

    def __init__(self, **options):
        super().__init__(**options)
        self.modes = []

    def sample(self, *arguments, **options):
        super().sample(*arguments, **options)
        self.modes.append(int(self.supervisor.mode))


@pytest.fixture(scope="module")
def run():
    """10 readings lost: bridged, degraded for a second. 60 lost, later: safe until it is believed again."""
    made = Told()
    made.move(700)
    made.move(10, lost=True)
    made.move(1500)
    made.move(60, lost=True)
    made.move(1700)
    return made


def not_state(message):
    return not message.topic.endswith("/state")


def not_diagnostics(message):
    return message.topic != "/diagnostics"


def modes_of(path):
    result = analyze(load(path))
    return result, as_dict(result)["valves"]["valve"]["modes"]


def sample_modes(result, count):
    """Mode of each sample as the analysis counts it."""
    valve = result.valves["valve"]
    found = [int(s.mode) for s in valve.spells for _ in range(s.samples)]
    assert len(found) == count
    return np.array(found)


def runs_of(modes):
    """(mode, samples) of each stretch."""
    edges = [0, *(np.flatnonzero(np.diff(modes)) + 1).tolist(), len(modes)]
    return [(int(modes[a]), b - a) for a, b in zip(edges[:-1], edges[1:], strict=True)]


@pytest.mark.parametrize("keep", [lambda m: True, not_state], ids=["both", "diagnostics alone"])
def test_each_sample_has_the_mode_that_its_supervisor_was_in(run, tmp_path, keep):
    """A lost reading is no sample of the supervisor: its mode is the one told when the next has come."""
    result, about = modes_of(write(tmp_path / "bag", run.messages, keep=keep))
    told = np.array(run.modes)
    assert {mode for mode, _ in runs_of(told)} == {0, 1, 2}
    found = sample_modes(result, len(told))
    # The last of the lost readings is answered by what is said when the gap is over.
    assert np.count_nonzero(found != told) == 0
    degraded, safe = about["intervals"]
    assert degraded["mode"] == "degraded" and degraded["reasons"] == ["LVDT readings lost: bridged"]
    assert safe["mode"] == "safe" and "60 LVDT readings lost in a row" in safe["reasons"]
    for interval, mode in ((degraded, 1), (safe, 2)):
        count = told.tolist().count(mode)
        assert interval["samples"] == about[interval["mode"]]["samples"] == count
        assert interval["duration_s"] == pytest.approx(1e-3 * count, abs=2e-3)


def test_indices_with_and_without_what_was_not_ok(run, tmp_path):
    _, about = modes_of(write(tmp_path / "bag", run.messages))
    told = np.array(run.modes)
    command = 2.0 * np.sin(2.0 * np.pi * (np.arange(len(told))) * 1e-3)
    error = np.array(run.readings) - command
    kept, only_ok = told == 0, about["indices_only_ok"]
    assert only_ok["e_M"] == pytest.approx(np.max(np.abs(error[kept])))
    assert only_ok["e_rms"] == pytest.approx(np.sqrt(np.mean(error[kept] ** 2)))
    assert only_ok["e_F"] == pytest.approx(np.max(np.abs(error[kept][-2001:])))


def test_the_text_and_the_page_show_the_modes(run, tmp_path):
    result, _ = modes_of(write(tmp_path / "bag", run.messages))
    lines = analysis_report.of_bag(result, {}).text.splitlines()
    assert any(line.startswith("only ok") for line in lines)
    assert any(line.startswith("safe ") and "60 LVDT readings lost in a row" in line for line in lines)
    assert any(line.startswith("modes: ok ") and "safe 1 time" in line for line in lines)
    page = analysis_report.of_bag(result, {}).html
    assert "60 LVDT readings lost in a row" in page
    shapes = json.loads("[" + page.split('"shapes":[', 1)[1].split("]", 1)[0] + "]")
    told = [i for i in as_dict(result)["valves"]["valve"]["modes"]["intervals"] if i["samples"]]
    drawn = [(shape["x0"], shape["x1"]) for shape in shapes if shape["type"] == "rect"]
    assert drawn == [pytest.approx((max(0.0, interval["start_s"]), interval["end_s"])) for interval in told]


def test_without_diagnostics_the_state_tells_the_modes_but_no_reasons(run, tmp_path):
    result, about = modes_of(write(tmp_path / "bag", run.messages, keep=not_diagnostics))
    told, found = np.array(run.modes), sample_modes(result, len(run.modes))
    # ~/state has every tenth sample.
    assert [mode for mode, _ in runs_of(found)] == [mode for mode, _ in runs_of(told)]
    assert np.count_nonzero(found != told) <= 10 * len(runs_of(told))
    assert all(interval["reasons"] == [] for interval in about["intervals"])
    assert "reason is not recorded" in analysis_report.of_bag(result, {}).text


def test_a_controller_that_fell_silent_is_not_taken_for_ok(run, tmp_path):
    """It was killed: the LVDT is read for five seconds more."""
    messages = list(run.messages)
    last = max(m.time for m in messages)
    reading = next(m for m in reversed(messages) if m.topic == "/spool_position")
    messages += [
        reading._replace(time=last + i * PERIOD, log_time=last + i * PERIOD, sequence=reading.sequence + i)
        for i in range(1, 5001)
    ]
    result, about = modes_of(write(tmp_path / "bag", messages))
    assert about["unknown"]["intervals"] == 1
    assert about["unknown"]["duration_s"] == pytest.approx(5.0, abs=0.02)
    assert "nothing was heard of the controller" in analysis_report.of_bag(result, {}).text


def test_of_two_valves_each_has_its_own_modes(tmp_path):
    boom, arm = Run(namespace="/boom"), Run(2, namespace="/arm")
    boom.move(300)
    boom.move(60, lost=True)
    boom.move(200)
    arm.move(560)
    about = as_dict(analyze(load(write(tmp_path / "bag", boom.messages + arm.messages))))["valves"]
    assert about["boom"]["modes"]["safe"]["intervals"] == 1
    assert about["arm"]["modes"]["safe"]["intervals"] == 0


def test_an_inactive_controller_and_words_of_other_nodes(run, tmp_path):
    """A battery that tells a mode of its own, and a controller that was deactivated for half a second."""
    made = Run()
    made.move(1000)
    made.clock += 1_000_000
    made.send("/diagnostics", STATUS, diagnostic("/controller", 0, "inactive", mode="safe"))
    made.send("/diagnostics", STATUS, diagnostic("/battery", 2, "empty", mode="safe"))
    made.send("/diagnostics", STATUS, b"\0\1\0\0mode\0")
    made.clock += 500 * PERIOD
    made.diagnose()
    made.move(1000)
    loaded = load(write(tmp_path / "bag", made.messages))
    about = as_dict(analyze(loaded))["valves"]["valve"]["modes"]
    inactive = about["intervals"][-1]
    assert inactive["mode"] == "inactive" and inactive["duration_s"] == pytest.approx(0.5, abs=0.01)
    assert about["safe"]["intervals"] == 0
    assert any("1 messages of /diagnostics could not be decoded" in text for text in loaded.problems)


def test_what_switched_off_is_the_first_reason(tmp_path):
    """Bridged readings are still reported when many are lost."""
    made = Run()
    made.move(500)
    made.move(10, lost=True)
    made.move(300)
    made.move(60, lost=True)
    made.move(300)
    _, about = modes_of(write(tmp_path / "bag", made.messages))
    assert [i["reasons"] for i in about["intervals"]] == [
        ["LVDT readings lost: bridged"],
        ["60 LVDT readings lost in a row", "LVDT readings lost: bridged"],
        ["LVDT readings lost: bridged"],
    ]


# Changes of parameters


def test_successive_changes_are_all_listed(tmp_path):
    """Three between two samples, one before the first command, one after the last reading."""
    made = Run()
    for _ in range(5):
        made.sample()
    made.change(arc__k2=90.0)
    made.move(500)
    for k1 in (110.0, 100.0, 95.0):
        made.change(arc__k1=k1)
    made.move(500)
    made.change(controller="pid")
    made.flush()
    result = analyze(load(write(tmp_path / "bag", made.messages)))
    text = analysis_report.of_bag(result, {}).text
    for i, change in enumerate(
        ("arc.k2 = 90.0", "arc.k1 = 110.0", "arc.k1 = 100.0", "arc.k1 = 95.0", "controller = pid"), start=1
    ):
        assert f"after change {i}: {change} (at " in text
    valve = as_dict(result)["valves"]["valve"]
    parts = [(s["name"], s["change"]) for s in valve["segments"] if s["kind"] == "parameters"]
    assert parts == [
        ("after change 1", "arc.k2 = 90.0"),
        ("after change 4", "arc.k1 = 110.0; arc.k1 = 100.0; arc.k1 = 95.0"),
    ]
    assert len(valve["changes"]) == 5
