# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Driver `simulated`: the simulated valve in the process, for trials without hardware."""

from typing import Any

import numpy as np

from valve_control.control.drivers.driver import Condition, Reading
from valve_control.control.drivers.ticks import Ticks
from valve_control.control.plant import registry
from valve_control.control.plant.amplifier import saturate


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
        """The reading of the next tick; the ticks that went by before are lost readings."""
        lost = self._ticks.wait() if self._paced else 0
        if self._moving:
            for _ in range(lost + 1):
                self._state = self._plant.step(self._params, self._state, self._voltage)
        self._moving = True
        return Reading(
            self._plant.read(self._params, self._state, float(self._random.standard_normal())), lost
        )

    def close(self) -> None:
        """Give 0 V."""
        self._voltage = 0.0

    def conditions(self) -> tuple[Condition, ...]:
        """There are none."""
        return ()
