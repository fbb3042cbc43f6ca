# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A recording replayed through the exported C of its laws."""

import shutil

import numpy as np
import pytest
from c_library import Library
from made import Run, write

from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import CONTROLLER
from valve_control.export import unit
from valve_control.parameter import defaults
from valve_control.recordings import shadow
from valve_control.recordings.recording import load


def in_c(monkeypatch, name):
    """Let ``name`` be the exported C instead of the Python."""
    library = Library(unit.law({**defaults(CONTROLLER), "controller": name}))
    monkeypatch.setitem(LAWS, name, LAWS[name]._replace(module=library))
    return library


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_exported_laws_give_the_recorded_voltages_bit_for_bit(tmp_path, monkeypatch):
    """With takeovers between all laws, lost and wrong readings, and gains that change."""
    run = Run(controller={"controller": "arc"})
    run.move(300)
    for name in ("oarc", "dcarc", "pid", "compensator", "open_loop", "oarc"):
        run.change(controller=name)
        run.move(150)
    run.change(oarc__ks1=90.0)
    run.move(150)
    valve = load(write(tmp_path / "bag", run.messages), journals=True).valves["valve"]
    used = {}
    for name in ("arc", "oarc", "dcarc", "pid", "compensator", "open_loop"):
        library, used[name] = in_c(monkeypatch, name), 0

        def counted(*given, name=name, step=library.step):
            used[name] += 1
            return step(*given)

        library.step = counted
    result = shadow.replay(valve, {})
    assert min(used.values()) > 100
    assert result.faithful and result.differing == 0 and result.left_out == []
    assert np.array_equal(result.voltage, run.voltages)
