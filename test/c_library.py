# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The exported C of a law, compiled and loaded: it can stand where the law's module stands."""

import ctypes
import tempfile
from pathlib import Path
from typing import Any

from valve_control.control.laws.signals import Start
from valve_control.control.linear.linear_loop import flatten, unflatten
from valve_control.export import compiler, sources
from valve_control.export.unit import Unit

DOUBLE = ctypes.POINTER(ctypes.c_double)


class Library:
    """A law in C, in double, with the functions of its module: ``initial``, ``step`` and ``hold``."""

    def __init__(self, unit: Unit) -> None:
        """Translate, compile and load ``unit``. Raises ParameterError."""
        with tempfile.TemporaryDirectory(prefix="valve_control-export-") as name:
            place = Path(name)
            made = sources.make(unit)
            (place / f"{unit.name}.h").write_text(made.header, encoding="utf-8")
            (place / f"{unit.name}.c").write_text(made.source, encoding="utf-8")
            built = place / f"{unit.name}.so"
            compiler.build([place / f"{unit.name}.c"], built, ["-fPIC", "-shared"])
            self.functions = ctypes.CDLL(str(built))
        self.Params, self.State, self.Terms = unit.module.Params, unit.module.State, unit.module.Terms
        self._state = unit.module.initial(unit.params, Start(0.0, 0.0, 0.0, 0.0, 0.0))
        self._terms = unit.module.step(unit.params, self._state, 0.0, 0.0, 0.0)[2]
        doubles = [ctypes.c_double] * 3
        self._given: tuple[Any, Any] = (None, None)  # the last parameters, and their struct
        self._init, self._step, self._hold = (
            getattr(self.functions, f"{unit.name}_{part}") for part in ("init", "step", "hold")
        )
        self._init.argtypes, self._init.restype = [DOUBLE, DOUBLE, DOUBLE], None
        self._step.argtypes, self._step.restype = [DOUBLE, DOUBLE, *doubles, DOUBLE], ctypes.c_double
        self._hold.argtypes, self._hold.restype = [DOUBLE, DOUBLE, *doubles], None

    @staticmethod
    def _numbers(record: Any) -> Any:
        """The struct of ``record``, which has doubles alone."""
        numbers = flatten(record)
        return (ctypes.c_double * len(numbers))(*numbers)

    def _struct(self, params: Any) -> Any:
        """The struct of ``params``; they are the same for many calls."""
        if self._given[0] is not params:
            self._given = params, self._numbers(params)
        return self._given[1]

    def initial(self, params: Any, start: Start) -> Any:
        """As of the law's module."""
        state = self._numbers(self._state)
        self._init(self._struct(params), state, self._numbers(start))
        return unflatten(self._state, list(state))

    def step(self, params: Any, state: Any, command: float, measurement: float, offset: float) -> Any:
        """As of the law's module."""
        memory, terms = self._numbers(state), self._numbers(self._terms)
        voltage = self._step(self._struct(params), memory, command, measurement, offset, terms)
        return voltage, unflatten(self._state, list(memory)), unflatten(self._terms, list(terms))

    def hold(self, params: Any, state: Any, command: float, measurement: float, voltage: float) -> Any:
        """As of the law's module."""
        memory = self._numbers(state)
        self._hold(self._struct(params), memory, command, measurement, voltage)
        return unflatten(self._state, list(memory))
