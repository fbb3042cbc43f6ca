# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Live replay of bags to running nodes."""

import sys
from pathlib import Path

import numpy as np
import pytest
import rclpy

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "recordings"))
from made import Run, write

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
            result = playback.play(str(bag), [], rate, quiet=True)
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
        result = playback.play(str(log), maps, 1.0, quiet=True)
    heard = again(tmp_path / "again")
    assert result.published == 1200 and result.elapsed >= 0.599
    assert np.allclose(heard["/spool_position"], run.readings, rtol=0.0, atol=1e-12)
    assert np.array_equal(heard["/spool_command"], commands)


def again(path):
    series = Bag(path).read({"/spool_position": ["data"], "/spool_command": ["data"]})
    return {name: entry.values["data"] for name, entry in series.items()}


def test_nobody_who_listens_is_an_error(tmp_path, run, monkeypatch):
    monkeypatch.setattr(playback, "MEET", 0.3)
    bag = write(tmp_path / "bag", run.messages)
    with pytest.raises(BagError, match="nobody has listened to /spool_command"):
        playback.play(str(bag), [], 1.0, quiet=True)
    assert not rclpy.ok()
