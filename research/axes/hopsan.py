# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Rebuilds Hopsan's example "Position Servo" (config/axis/hopsan_position_servo.yaml) and compares it.

By our own step, exact in time, and by Hopsan's method with Hopsan's step (``transmission_lines.py``).
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from research.axes import transmission_lines
from research.axes.transmission_lines import Servo
from valve_control.axis import run
from valve_control.axis.axis_parameters import AXIS_NODES
from valve_control.control.compiling import compile_function
from valve_control.control.parameters import files, ros_file
from valve_control.parameter import ParameterError, Values, number, numbers, updated

Array = npt.NDArray[np.float64]
NAMES = ("position", "step", "valve", "relief")  # columns behind the time in Hopsan's reference
FILE = "Position Servo.hvd"
METRES = 1e-3  # m/V  of the spool


def _settings(changes: tuple[str, ...] = ()) -> dict[str, Values]:
    path = ros_file.config_folder() / "axis" / "hopsan_position_servo.yaml"
    given = files.given([str(path)], {}, changes, None, AXIS_NODES)
    begun = run.default_settings()
    return {node: updated(table, begun[node], given[node]) for node, table in AXIS_NODES.items()}


def position_servo(settings: tuple[str, ...] = ()) -> tuple[Array, dict[str, Array]]:
    """Times [s] and columns by NAMES (m, m, m, m³/s/√Pa); ``settings`` as of --set change the machine."""
    made = run.simulate(run.setup(_settings(settings)))
    s = made.signals
    columns = (s["position"], s["goal"], METRES * s["spool"], s["relief"])
    return made.time, dict(zip(NAMES, columns, strict=True))


def by_lines(
    period: float = transmission_lines.PERIOD, duration: float = 3.0
) -> tuple[Array, dict[str, Array]]:
    """The same by transmission lines with steps of a ``period`` [s], over ``duration`` [s]."""
    values = _settings()
    made, upper, valve = run.setup(values), values["axis_controller"], values["valve_simulator"]
    mass, damped, w2 = numbers(valve, "denominator")
    before = number(upper, "offset")
    servo = Servo(
        axis=made.machine.axis,
        upper=made.cascade.upper,
        spool=(w2, damped, mass),
        before=before,
        after=before + number(upper, "distance"),
        pause=number(upper, "pause"),
    )
    rows = compile_function(transmission_lines.position_servo)(servo, period, round(duration / period))
    rows[:, 3] *= METRES
    return rows[:, 0], dict(zip(NAMES, rows[:, 1:].T, strict=True))


def deviations(times: Array, columns: dict[str, Array], reference: Array) -> dict[str, Array]:
    """Deviation from each row of ``reference`` (time and NAMES) over the range of its column, by name."""
    found = {}
    for i, name in enumerate(NAMES, 1):
        wanted = reference[:, i]
        found[name] = np.abs(np.interp(reference[:, 0], times, columns[name]) - wanted) / np.ptp(wanted)
    return found


def reference(folder: Path, name: str = FILE) -> Array:
    """Rows of one of Hopsan's .hvd files. Raises ParameterError."""
    try:
        table = np.genfromtxt(folder / name, delimiter=",")
    except (OSError, ValueError) as error:
        raise ParameterError(f"{folder / name} cannot be read: {error}") from error
    rows: Array = table[~np.isnan(table).any(axis=1)]
    return rows


def compare(folder: Path) -> dict[str, dict[str, float]]:
    """Largest deviation from the reference in ``folder``, by way and name. Raises ParameterError."""
    rows = reference(folder)
    if rows.ndim != 2 or rows.shape[1] != 1 + len(NAMES) or len(rows) < 2:
        raise ParameterError(f"{folder / FILE} has not the columns time, {', '.join(NAMES)}")
    found = {}
    for way, (times, columns) in {"lines": by_lines(), "exact_in_time": position_servo()}.items():
        by_name = deviations(times, columns, rows)
        found[way] = {name: float(np.max(by_name[name])) for name in NAMES}
    return found
