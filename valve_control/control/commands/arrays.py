# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Makes command arrays, one number for each sample: read from a file, or sampled from a shape."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from valve_control.arrays import Floats
from valve_control.control.commands import scenarios
from valve_control.parameter import ParameterError


def refuse_aliased(frequency: float, period: float) -> None:
    """Raise ParameterError for a ``frequency`` [Hz] of half the sampling rate or more."""
    if frequency >= 0.5 / period:
        raise ParameterError(
            f"{frequency:g} Hz is not below Nyquist's frequency, {0.5 / period:g} Hz at a sample period of "
            f"{period:g} s"
        )


def sampled(shape: scenarios.Shape, period: float, samples: int) -> Floats:
    """Command [V] at each of ``samples`` samples, ``period`` [s] apart."""
    return np.array([scenarios.command(shape, k * period) for k in range(samples)])


def read(path: str) -> Floats:
    """One column of commands [V] from a CSV or NPY file. Raises ParameterError."""
    if not path:
        raise ParameterError("scenario 'array' needs command_file, a CSV or NPY file")
    try:
        if Path(path).suffix == ".npy":
            array: npt.NDArray[Any] = np.load(path, allow_pickle=False)
            if not isinstance(array, np.ndarray):
                raise ValueError("it is an archive of arrays (NPZ)")
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # an empty file is refused below
                array = np.loadtxt(path, delimiter=",", comments="#", ndmin=1)
    except OSError as error:
        raise ParameterError(f"command file {path} cannot be read: {error.strerror or error}") from error
    except (ValueError, EOFError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise ParameterError(
            f"command file {path} must hold one number a line (CSV) or a vector (NPY): {reason}; leave "
            "out a header and other columns (with --map, simulate takes the command of a log with readings)"
        ) from error
    if array.dtype.kind not in "fiub":
        raise ParameterError(f"command file {path} must hold real numbers, not {array.dtype}")
    numbers: Floats = np.asarray(array, dtype=np.float64)
    numbers = numbers.ravel() if numbers.ndim == 2 and 1 in numbers.shape else numbers
    if numbers.ndim != 1 or numbers.size < 2:
        raise ParameterError(
            f"command file {path} must hold one column of two or more numbers, with decimal points; its "
            f"shape is {numbers.shape}"
        )
    if not np.all(np.isfinite(numbers)):
        first = int(np.flatnonzero(~np.isfinite(numbers))[0])
        raise ParameterError(f"command file {path} has {numbers[first]} in entry {first + 1}")
    return numbers
