# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Driver `simulated`: the simulated valve in the process, for trials without hardware."""

import time
from typing import Any

import numpy as np

from valve_control.control.drivers.driver import Condition, Reading
from valve_control.control.drivers.ticks import Ticks
from valve_control.control.plant import registry
from valve_control.control.plant.saturation import saturate

BACKLOG = 0.02  # s  ticks that lie further back are left out


class SimulatedValve:
    """A valve at rest at first; ``paced``: by the ticks of an absolute clock, otherwise at each ``read``."""

    def __init__(self, params: Any, seed: int, paced: bool) -> None:
        """``params``: of the plant, as its ``build`` makes them."""
        self._params = params
        self._plant = registry.plant_of(params).module
        self._seed = seed
        self._paced = paced
        self._voltage = 0.0
        self._state: Any = None
        self._moving = False  # whether a reading was taken, after which time goes on

    def open(self) -> None:
        """Put the spool at rest in the centre."""
        self._state = self._plant.initial(self._params)
        self._random = np.random.default_rng(self._seed)
        self._ticks = Ticks(self._params.period)
        self._moving = False

    def enable(self, on: bool) -> None:
        """Begin at 0 V, from the next tick on, or end there."""
        self._voltage = 0.0
        if on:
            self._ticks = Ticks(self._params.period)

    def write(self, signal: float) -> None:
        """Voltage [V] until the next one."""
        self._voltage = saturate(signal, self._params.u_max)

    def read(self) -> Reading:
        """The reading of the next tick; ticks that are late are made up for, as `poll` says."""
        if self._paced:
            time.sleep(self._ticks.due())
        return self._next()

    def poll(self) -> Reading | None:
        """The reading of a tick that has come; the spool moves by one period from tick to tick.

        Ticks that lie more than ``BACKLOG`` back are lost readings.
        """
        return None if self._paced and self._ticks.at() > time.monotonic() else self._next()

    def _next(self) -> Reading:
        lost = self._ticks.take(BACKLOG) if self._paced else 0
        if self._moving:
            for _ in range(lost + 1):
                self._state = self._plant.step(self._params, self._state, self._voltage)
        self._moving = True
        reading = self._plant.read(self._params, self._state, float(self._random.standard_normal()))
        return Reading(reading, lost)

    def due(self) -> float:
        """Time of the next tick."""
        return self._ticks.at() if self._paced else 0.0

    def fileno(self) -> int:
        """There is no file."""
        return -1

    def close(self) -> None:
        """Give 0 V."""
        self._voltage = 0.0

    def conditions(self) -> tuple[Condition, ...]:
        """There are none."""
        return ()
