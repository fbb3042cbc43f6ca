"""A whole run offline: law, valve and command as the nodes run them, without middleware."""

import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from valve_control.analysis.indices import Indices, indices, rms
from valve_control.laws.signals import Start
from valve_control.parameters import build, stability
from valve_control.parameters.table import ParameterError, Values
from valve_control.plant import valve
from valve_control.simulation import closed_loop, scenarios

Array = npt.NDArray[np.float64]


class Run(NamedTuple):
    """Traces and results of one run, all sampled at ``period``."""

    controller: str
    period: float  # s
    command: Array  # V
    position: Array  # V, true
    measurement: Array  # V
    voltage: Array  # V
    terms: dict[str, Array]  # of the law, by name
    theta: list[float] | None  # θ̂ at the end, of laws that adapt
    indices: Indices  # error from the measurement, as in the paper
    true_error: dict[str, float]  # from the true position
    warning: str  # "" if none

    @property
    def time(self) -> Array:
        """Time [s] of each sample."""
        return np.arange(len(self.command), dtype=np.float64) * self.period


def commands(values: Values) -> Array:
    """Command [V] of each sample from the command source's values. Raises ParameterError."""
    period = build.number(values, "sample_period")
    n = max(1, round(build.number(values, "duration") / period))
    if values["scenario"] == "array":
        array = read_commands(build.word(values, "command_file"))
        return np.concatenate([array[:n], np.full(max(0, n - len(array)), array[-1])])
    shape = build.shape(values)
    return np.array([scenarios.command(shape, k * period) for k in range(n)])


def read_commands(path: str) -> Array:
    """One column of commands [V] from a CSV or NPY file. Raises ParameterError."""
    if not path:
        raise ParameterError("scenario 'array' needs command_file, a CSV or NPY file")
    try:
        if Path(path).suffix == ".npy":
            array: npt.NDArray[Any] = np.load(path, allow_pickle=False)
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # an empty file is refused below
                array = np.loadtxt(path, delimiter=",", comments="#", ndmin=1)
    except OSError as error:
        raise ParameterError(f"command file {path} cannot be read: {error.strerror or error}") from error
    except (ValueError, EOFError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise ParameterError(
            f"command file {path} must hold one number a line (CSV) or a one-dimensional array (NPY): "
            f"{reason}"
        ) from error
    try:
        numbers: Array = np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"command file {path} must hold numbers, not {array.dtype}") from error
    if numbers.ndim == 2 and 1 in numbers.shape:
        numbers = numbers.ravel()
    if numbers.ndim != 1 or numbers.size == 0:
        raise ParameterError(
            f"command file {path} must hold one column of numbers; its shape is {numbers.shape}"
        )
    if not np.all(np.isfinite(numbers)):
        first = int(np.flatnonzero(~np.isfinite(numbers))[0])
        raise ParameterError(f"command file {path} has {numbers[first]} in entry {first + 1}")
    return numbers


def check_agreement(controller_values: Values, valve_values: Values) -> None:
    """Raise ParameterError unless controller and valve agree on sample period and limit of the voltage."""
    for name in ("sample_period", "u_max"):
        if controller_values[name] != valve_values[name]:
            raise ParameterError(
                f"{name} is {controller_values[name]} for the controller and {valve_values[name]} "
                "for the valve; they must agree"
            )


def simulate(
    controller_values: Values,
    valve_values: Values,
    command: Array,
    compiled: bool = True,
    noise_start: int = 0,
) -> Run:
    """Run the loop over ``command`` [V], one entry per sample. Raises ParameterError.

    ``noise_start``: how many LVDT readings the simulator had already made when the controller joined.
    """
    check_agreement(controller_values, valve_values)
    if noise_start < 0:
        raise ParameterError(f"noise_start is {noise_start}; it must be 0 or more")
    name = build.word(controller_values, "controller")
    law = closed_loop.LAWS[name]
    law_params = build.law_params(controller_values)
    valve_params = build.valve_params(valve_values)
    limit = build.number(controller_values, "command_limit")
    command = np.clip(np.ascontiguousarray(command, dtype=np.float64), -limit, limit)
    period = valve_params.period
    n = len(command)
    random = np.random.default_rng(int(build.number(valve_values, "seed")))
    noise = random.standard_normal(noise_start + n)[noise_start:]
    signals = np.zeros((n, len(closed_loop.SIGNALS)))
    labels = closed_loop.term_labels(law)
    terms = np.zeros((n, len(labels)))
    valve_state = valve.initial(valve_params)
    first = valve.read(valve_params, valve_state, noise[0])
    law_state = law.initial(law_params, Start(first, 0.0, first, 0.0, 0.0))
    law_state, _ = closed_loop.loop_for(law, compiled)(
        law_params, law_state, valve_params, valve_state, command, noise, signals, terms
    )
    position, measurement, voltage = signals.T
    true_error = position - command
    return Run(
        controller=name,
        period=period,
        command=command,
        position=position,
        measurement=measurement,
        voltage=voltage,
        terms={label: terms[:, i] for i, label in enumerate(labels)},
        theta=list(law_state.theta) if name in ("arc", "oarc") else None,
        indices=indices(measurement - command, voltage, period),
        true_error={"e_M": float(np.max(np.abs(true_error))), "e_rms": rms(true_error)},
        warning=stability.warning(name, law, law_params),
    )
