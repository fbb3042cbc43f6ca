"""The closed loop of one valve and one law, sample by sample: read, step, hold the voltage."""

import types
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from valve_control.compiling import compile_function
from valve_control.laws import arc, compensator, oarc, pid
from valve_control.plant import valve

Array = npt.NDArray[np.float64]
LAWS: dict[str, types.ModuleType] = {
    "arc": arc,
    "oarc": oarc,
    "pid": pid,
    "compensator": compensator,
    "open_loop": compensator,
}
SIGNALS = ("position", "measurement", "voltage")


def law_step(p: Any, s: Any, command: float, measurement: float, offset: float) -> Any:
    """Stands for the step of the law in ``run_loop``; replaced before the loop runs."""
    raise NotImplementedError


def run_loop(
    law_params: Any,
    law_state: Any,
    valve_params: Any,
    valve_state: Any,
    commands: Array,
    noise: Array,
    signals: Array,
    terms_out: Array,
) -> Any:
    """Run one sample per command [V]; returns the last states of law and valve.

    ``signals`` (n×3) takes position, measurement and voltage [V]; ``terms_out`` (n×m, or 0×m for none)
    the law's terms.
    """
    record = terms_out.shape[0] > 0
    for k in range(commands.shape[0]):
        measurement = valve.read(valve_params, valve_state, noise[k])
        voltage, law_state, terms = law_step(law_params, law_state, commands[k], measurement, 0.0)
        signals[k, 0] = valve_state.x.x0
        signals[k, 1] = measurement
        signals[k, 2] = voltage
        if record:
            for i in range(len(terms)):
                terms_out[k, i] = terms[i]
        valve_state = valve.step(valve_params, valve_state, voltage)
    return law_state, valve_state


def loop_for(law: types.ModuleType, compiled: bool = True) -> Callable[..., Any]:
    """``run_loop`` with the step of ``law``, compiled or in plain Python (both give the same bits)."""
    if compiled:
        return compile_function(run_loop, {"law_step": compile_function(law.step)})
    scope = dict(run_loop.__globals__)
    scope["law_step"] = law.step
    return types.FunctionType(run_loop.__code__, scope, run_loop.__name__)


def term_labels(law: types.ModuleType) -> tuple[str, ...]:
    """Names of the law's terms, in the order of the columns."""
    return tuple(law.Terms._fields)
