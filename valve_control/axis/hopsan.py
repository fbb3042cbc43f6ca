"""Rebuilds Hopsan's example "Position Servo" (config/axis/hopsan_position_servo.yaml) and compares it."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from valve_control.axis import run
from valve_control.parameter import ParameterError, updated
from valve_control.parameters import files
from valve_control.parameters.axis import AXIS_NODES

Array = npt.NDArray[np.float64]
NAMES = ("position", "step", "valve", "relief")  # columns behind the time in Hopsan's reference
FILE = "Position Servo.hvd"


def position_servo(settings: tuple[str, ...] = ()) -> tuple[Array, dict[str, Array]]:
    """Times [s] and columns by NAMES (m, m, m, m³/s/√Pa); ``settings`` as of --set change the machine."""
    path = files.config_folder() / "axis" / "hopsan_position_servo.yaml"
    given = files.given([str(path)], {}, settings, None, AXIS_NODES)
    begun = run.default_settings()
    made = run.simulate(
        run.setup({node: updated(table, begun[node], given[node]) for node, table in AXIS_NODES.items()})
    )
    s = made.signals
    columns = (s["position"], s["goal"], 1e-3 * s["spool"], s["relief"])  # 1 V of spool is 1 mm
    return made.time, dict(zip(NAMES, columns, strict=True))


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


def compare(folder: Path) -> dict[str, float]:
    """Largest deviation from the reference in ``folder``, by name without the step. Raises ParameterError."""
    rows = reference(folder)
    if rows.ndim != 2 or rows.shape[1] != 1 + len(NAMES) or len(rows) < 2:
        raise ParameterError(f"{folder / FILE} has not the columns time, {', '.join(NAMES)}")
    found = deviations(*position_servo(), rows)
    return {name: float(np.max(found[name])) for name in NAMES if name != "step"}
