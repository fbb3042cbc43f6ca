# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Live replay of bags to running nodes."""

import sys
from pathlib import Path

import numpy as np
import pytest
import rclpy

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "recordings"))
from made import PERIOD, Run, in_file_order, write

from valve_control.nodes import playback
from valve_control.nodes.harness.processes import process
from valve_control.recordings.bags.bag import Bag
from valve_control.recordings.bags.errors import BagError


@pytest.fixture(scope="module")
def run():
    made = Run(controller={"lvdt.frozen_samples": 0, "lockstep": True})
    made.move(600)
    return made


@pytest.mark.alone
def test_topics_are_published_at_their_times_and_faster(tmp_path, run):
    bag = write(tmp_path / "bag", run.messages)
    for rate in (1.0, 4.0):
        with process("recorder", ["-p", f"bag:={tmp_path / f'again_{rate}'}"], tmp_path / f"r_{rate}.log"):
            result = playback.play(str(bag), [], ["/spool_position", "/spool_command"], rate, quiet=True)
        heard = again(tmp_path / f"again_{rate}")
        assert result.published == 1200
        assert np.array_equal(heard["/spool_position"], run.readings)
        assert len(heard["/spool_command"]) == 600
        # Never before its time; a busy machine may be late.
        assert result.elapsed * rate >= 0.599


@pytest.mark.alone
def test_a_table_is_published_in_volts(tmp_path, run):
    """Milliampere of a logger, as the topics of the signals, each command before the reading of its row."""
    commands = 0.01 * np.arange(600.0)
    log = tmp_path / "log.csv"
    rows = np.column_stack([np.arange(600.0), (np.array(run.readings) + 15.0) / 1.25, commands])
    np.savetxt(log, rows, delimiter=";", header="t_ms;lvdt;wanted", comments="", fmt="%.17g")
    maps = ["time=t_ms*0.001", "spool_position=lvdt@4..20mA", "spool_command=wanted"]
    with process("recorder", ["-p", f"bag:={tmp_path / 'again'}"], tmp_path / "recorder.log"):
        result = playback.play(str(log), maps, None, 1.0, quiet=True)
    heard = again(tmp_path / "again")
    assert result.published == 1200 and result.elapsed >= 0.599
    assert np.allclose(heard["/spool_position"], run.readings, rtol=0.0, atol=1e-12)
    assert np.array_equal(heard["/spool_command"], commands)
    with pytest.raises(BagError, match="is a table, which has no topics"):
        playback.play(str(log), maps, ["/lvdt"], 1.0, quiet=True)


def test_messages_with_one_stamp_are_published_in_the_order_of_the_recording():
    """Ten readings and their commands share each stamp of a clock of 10 ms."""
    count = 30
    stamps = np.arange(count) // 10 * 10_000_000
    places = np.arange(count)
    tracks = [
        playback.Track("/spool_position", "", stamps, 2 * places + 1, [b""] * count),
        playback.Track("/spool_command", "", stamps, 2 * places, [b""] * count),
    ]
    times, owner, number = playback.in_turn(tracks)
    assert owner.tolist() == [1, 0] * count and number.tolist() == np.repeat(places, 2).tolist()
    assert np.all(np.diff(times) >= 0)


@pytest.mark.parametrize("numbered", [True, False])
@pytest.mark.parametrize("resolution", [4, 10, 700])
def test_messages_of_a_coarse_clock_are_published_one_by_one(ros, tmp_path, run, numbered, resolution):
    """Stamps of 10 ms at 1 kHz: each reading a period after the one before, not ten of them at once."""
    tick = resolution * PERIOD
    messages = [
        m._replace(
            time=m.time // tick * tick, log_time=m.log_time // tick * tick, sequence=m.sequence * numbered
        )
        for m in sorted(run.messages, key=lambda m: m.log_time)
    ]
    bag = Bag(in_file_order(tmp_path / "bag", messages))
    tracks = playback.tracks_of(ros, bag, [], None, None, None, None)
    assert [track.topic for track in tracks] == ["/spool_command", "/spool_position"]
    for track in tracks:
        recorded = [m for m in messages if m.topic == track.topic]
        assert track.messages == [m.data for m in recorded]
        if resolution > 600:  # two stamps tell no time between them
            assert np.array_equal(track.time, [m.time for m in recorded])
            continue
        sent = np.array([m.time for m in run.messages if m.topic == track.topic])
        moved = (track.time - sent)[resolution:-resolution]
        assert np.ptp(moved) < PERIOD
        assert np.all(np.diff(track.time)[resolution:-resolution] > 0.5 * PERIOD)


def again(path):
    series = Bag(path).read({"/spool_position": ["data"], "/spool_command": ["data"]})
    return {name: entry.values["data"] for name, entry in series.items()}


def test_nobody_who_listens_is_an_error(tmp_path, run, monkeypatch):
    monkeypatch.setattr(playback, "MEET", 0.3)
    bag = write(tmp_path / "bag", run.messages)
    with pytest.raises(BagError, match="nobody has listened to /spool_command"):
        playback.play(str(bag), [], None, 1.0, quiet=True)
    assert not rclpy.ok()


def test_a_topic_that_is_not_there_is_said():
    bag = Path(__file__).resolve().parents[1] / "data" / "bags" / "jazzy_mcap_drone_yaw"
    with pytest.raises(BagError, match="/nothing"):
        playback.play(str(bag), [], ["/nothing"], 1.0, quiet=True)
