# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists transfer functions from voltage to spool position: of the Parker D3FXE01HCNBJ0011, and any others."""

import math
from typing import NamedTuple

import numpy as np

from valve_control.parameter import Parameter, ParameterError, Table, Values, numbers, word


class TransferFunction(NamedTuple):
    """Polynomials in s, highest power first."""

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    @property
    def static_gain(self) -> float:
        """Gain at s = 0."""
        return self.numerator[-1] / self.denominator[-1]

    def scaled(self, gain: float) -> "TransferFunction":
        """The same with ``gain`` times its gain."""
        return TransferFunction(tuple(gain * c for c in self.numerator), self.denominator)


class SlowMotion(NamedTuple):
    """The model (1) that moves a spool like another one as long as it moves slowly."""

    a1: float  # 1/s
    a0: float  # 1/s²
    b0: float  # 1/s²


def slow_motion(model: TransferFunction) -> SlowMotion | None:
    """(1) whose voltage for a motion has the same part in position, rate and acceleration as with ``model``.

    It is the beginning of the power series of its reciprocal. None: (1) does not describe such a valve.
    """
    n, d = ([*reversed(part), 0.0, 0.0][:3] for part in model)
    stiffness = d[0] / n[0]
    damping = (d[1] - stiffness * n[1]) / n[0]
    inertia = (d[2] - stiffness * n[2] - damping * n[1]) / n[0]
    if min(stiffness, damping, inertia) <= 0.0:
        return None
    return SlowMotion(damping / inertia, stiffness / inertia, 1.0 / inertia)


def faster(model: TransferFunction, gain: float, speed: float) -> TransferFunction:
    """``model`` with its gain times ``gain`` and all its poles and zeros times ``speed``."""
    n, m = len(model.denominator), len(model.numerator)
    return TransferFunction(
        tuple(gain * c * speed ** (n - m + i) for i, c in enumerate(model.numerator)),
        tuple(c * speed**i for i, c in enumerate(model.denominator)),
    )


SECOND_ORDER = TransferFunction((1502.057,), (1.0, 58.771, 1657.206))  # (2)
FOURTH_ORDER = TransferFunction(
    (1206.0, 229256.0, 46882988.0), (1.0, 163.0, 47859.0, 1969807.0, 56553725.0)
)  # (3)
LIKE = 2.0  # times speed and gain of the D3FXE, up to which, and half of it, a valve is like it


class Scale(NamedTuple):
    """Speed and static gain of a valve over those of the D3FXE, to which defaults and ranges belong."""

    speed: float
    gain: float


D3FXE = Scale(1.0, 1.0)


def scale_of(model: TransferFunction) -> Scale:
    """Of a valve with ``model``; that of the D3FXE where it is like it, or (1) does not describe it."""
    own, usual = slow_motion(model), slow_motion(FOURTH_ORDER)
    if own is None or usual is None:
        return D3FXE
    found = Scale(math.sqrt(own.a0 / usual.a0), model.static_gain / FOURTH_ORDER.static_gain)
    return D3FXE if all(1.0 / LIKE <= factor <= LIKE for factor in found) else found


MODELS = {"second_order": SECOND_ORDER, "fourth_order": FOURTH_ORDER}
LARGEST = 1e18  # coefficient of a custom model, which a fourth order of 3 kHz has


def custom_parameters(prefix: str) -> Table:
    """Rows of the parameter table for a model that the user gives; their names begin with ``prefix``."""
    text, limits = "custom model, {} in s, highest power first", (-LARGEST, LARGEST)
    return (
        Parameter(f"{prefix}numerator", [1502.057], "", text.format("numerator"), *limits),
        Parameter(f"{prefix}denominator", [1.0, 58.771, 1657.206], "", text.format("denominator"), *limits),
    )


def chosen(values: Values, choice: str, prefix: str) -> TransferFunction:
    """Model that parameter ``choice`` names; a custom one comes from ``prefix``. Raises ParameterError."""
    name = word(values, choice)
    if name in MODELS:
        return MODELS[name]
    model = TransferFunction(
        tuple(numbers(values, f"{prefix}numerator")), tuple(numbers(values, f"{prefix}denominator"))
    )
    if not any(model.denominator) or not model.denominator or model.denominator[-1] == 0.0:
        raise ParameterError(
            f"{prefix}denominator is {list(model.denominator)}; its last entry must not be 0"
        )
    if not model.numerator or model.numerator[-1] == 0.0:
        raise ParameterError(f"{prefix}numerator is {list(model.numerator)}; its last entry must not be 0")
    if model.static_gain < 0.0:
        raise ParameterError(
            f"{prefix}numerator is {list(model.numerator)}, so that the static gain is "
            f"{model.static_gain:.3g} V/V; it must be positive, or the spool moves against the voltage"
        )
    poles = np.roots(model.denominator)
    if not prefix and len(poles) and max(poles.real) > 1e-9 * max(abs(poles)):
        raise ParameterError(
            f"the valve is unstable (a pole at {poles[poles.real.argmax()]:.3g} rad/s): denominator is "
            f"{list(model.denominator)}; its poles must lie left of the imaginary axis"
        )
    return model
