# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Stamps that many messages share, as those of a simulated clock: pairs by order, and what is not told."""

import numpy as np
import pytest
from made import Run, in_file_order, write

from valve_control.cli.command import run as main
from valve_control.recordings.analysis import analyze, as_dict
from valve_control.recordings.recording import load

MS = 1_000_000  # ns


@pytest.fixture(scope="module")
def run():
    made = Run()
    made.move(2003)
    return made


@pytest.fixture(scope="module")
def true(run, tmp_path_factory):
    return as_dict(analyze(load(write(tmp_path_factory.mktemp("true") / "bag", run.messages))))


def coarse(messages, resolution, clocks=("time", "log_time"), phase=0, numbered=True):
    """The messages in order of recording, with stamps of a clock that goes on by ``resolution`` [ns]."""

    def tick(stamp):
        return (stamp - phase) // resolution * resolution + phase

    ordered = sorted(messages, key=lambda m: m.log_time)
    return [
        m._replace(sequence=m.sequence * numbered, **{clock: tick(getattr(m, clock)) for clock in clocks})
        for m in ordered
    ]


def grouped(messages):
    """The messages of one stamp topic after topic, as a converter writes them that merges by time."""
    return sorted(messages, key=lambda m: (m.log_time, m.topic))


def check(bag, true, resolution, voltages=True):
    loaded = load(bag)
    result = analyze(loaded)
    about = as_dict(result)
    valve, right = about["valves"]["valve"], true["valves"]["valve"]
    (note,) = [text for text in valve["left_out"] if "resolution" in text]
    assert f"resolution of {resolution / MS:g} ms" in note and "latency" in note
    for name, value in right["indices"].items():
        if voltages or name not in ("u_rms", "c_u"):
            assert valve["indices"][name] == pytest.approx(value, rel=0.03), name
    for timing in valve["timing"].values():
        assert timing["rate_hz"] == pytest.approx(1000.0, rel=0.01)
        assert timing["gaps"] is None and np.isnan(timing["longest_gap_s"])
        assert np.isnan(timing["jitter_s"]["p99"])
    assert valve["unanswered"] is None and np.isnan(valve["latency_s"]["p50"])
    return result


@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize(("resolution", "phase"), [(10, 0.0), (4, 0.15), (50, 0.0)])
def test_a_clock_of_ten_ms_moves_no_figure(run, true, tmp_path, resolution, phase, numbered):
    """Before: e_rms 0.029 for 0.018, c_u 0.06 for 0.18, and nearly no reading answered."""
    messages = coarse(run.messages, resolution * MS, phase=round(phase * MS), numbered=numbered)
    result = check(in_file_order(tmp_path / "bag", messages), true, resolution * MS)
    signals = result.valves["valve"].signals
    assert np.array_equal(signals.measurement, run.readings)
    assert np.array_equal(signals.voltage, run.voltages)
    assert np.all(np.diff(signals.time) > 0.0)


@pytest.mark.parametrize("resolution", [10, 4])
def test_topic_after_topic_in_each_stamp(run, true, tmp_path, resolution):
    """File order tells nothing there: the first reading of a stamp belongs to its first voltage."""
    messages = grouped(coarse(run.messages, resolution * MS, phase=-MS // 2))
    check(in_file_order(tmp_path / "bag", messages), true, resolution * MS)


@pytest.mark.parametrize(("clock", "used"), [("time", "log_time"), ("log_time", "publish_time")])
def test_the_clock_with_the_finer_stamps_is_taken(run, true, tmp_path, clock, used):
    bag = in_file_order(tmp_path / "bag", coarse(run.messages, 10 * MS, clocks=(clock,)))
    loaded = load(bag)
    assert loaded.clock.name == used
    assert (clock == "log_time") or any("shared by messages" in text for text in loaded.problems)
    valve = as_dict(analyze(loaded))["valves"]["valve"]
    assert valve["indices"]["e_rms"] == pytest.approx(true["valves"]["valve"]["indices"]["e_rms"], rel=0.02)
    if used == "log_time":  # in which voltages come before the readings that they answer
        assert np.isnan(valve["latency_s"]["p50"]) and valve["unanswered"] is None
    else:
        assert 0.1e-3 < valve["latency_s"]["p50"] < 0.3e-3


@pytest.mark.parametrize("by_topic", [False, True])
def test_commands_slower_than_the_readings_are_placed_by_the_file_or_not_at_all(tmp_path, by_topic):
    """100 Hz under a clock of 7 ms: topic after topic, any place within a stamp would move e_rms by 40 %."""
    made = Run()
    for k in range(1000):
        made.sample(2.0 * np.sin(2e-3 * np.pi * k) if k % 10 == 0 else None)
    right = analyze(load(write(tmp_path / "right", made.messages))).valves["valve"].parts[0].indices
    error = made.readings - 2.0 * np.sin(2e-3 * np.pi * (np.arange(1000) + 0.3))  # ms after the command
    assert right.e_rms == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.03)
    messages = coarse(made.messages, 7 * MS)
    bag = in_file_order(tmp_path / "bag", grouped(messages) if by_topic else messages)
    result = analyze(load(bag)).valves["valve"]
    found = result.parts[0].indices
    assert any("it is left out" in text for text in result.left_out) == by_topic
    assert found.c_u == pytest.approx(right.c_u, rel=0.03)
    if by_topic:
        assert np.isnan([found.e_M, found.e_F, found.e_rms]).all()
    else:
        assert found.e_rms == pytest.approx(right.e_rms, rel=0.03)
    status = main(["simulate", "--command", str(bag)])
    assert status == (2 if by_topic else 0)
