# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes gain, phase and delay margin and the peaks of the sampled loop, for any law on many valves.

The loop is cut at the voltage. Law and valve are linear for small motions around rest
(linear_loop.py), and the response of both at z = exp(iωΔT) is that of the samples, exactly: hold,
dead time and aliasing included. Friction has no linear form; its describing function tells which swings it
sustains (friction_swing.py).
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Complexes, Floats
from valve_control.control.compiling import compile_function
from valve_control.control.laws.law import Law
from valve_control.control.linear import friction_swing, linear_loop
from valve_control.control.plant import registry

LOWEST = 0.05  # Hz  of the frequencies looked at; the highest is half the sampling rate
FREQUENCIES = 500
GROWN = 1.6  # times a valve's own swing, from which on that in the loop is all the loop's
EDGE = 1e-9  # by which a pole may lie outside of the unit circle: rounding


class Margins(NamedTuple):
    """What the loop around each of N valves has left until it breaks; unstable: nothing, and peaks inf."""

    radius: Floats  # -   largest modulus of the loop's poles
    gain_db: Floats  # dB  by which the valve's gain may rise; inf: without end
    reduction_db: Floats  # dB  by which it may fall; inf: to nothing
    phase_deg: Floats  # deg
    delay_s: Floats  # s   of more dead time
    sensitivity_db: Floats  # dB  peak of 1/(1 + L)
    response_db: Floats  # dB  peak of L/(1 + L)
    swing_v: Floats  # V   amplitude of the largest swing about rest that friction sustains, if by the loop


PEAKS = ("sensitivity_db", "response_db", "swing_v")


class Box(NamedTuple):
    """Valves prepared for many laws and gains."""

    valves: linear_loop.LinearValves
    omega: Floats  # F  rad/s
    z: Complexes  # F
    position: Complexes  # N×F  V/V  over the voltage
    response: Complexes  # N×F  V/V  of the reading
    coulomb: Floats  # N  V
    presliding: Floats  # N  V
    own_swing: Floats  # N  V  of the valve at a constant voltage


def prepared(given: Sequence[Any]) -> Box:
    """Plants with the Params ``given``, which have one sample period, for ``margins``. Raises ValueError."""
    plants = [registry.linear(p) for p in given]
    periods = {p.period for p in plants}
    if len(periods) != 1:
        raise ValueError(f"the valves of a box have one sample period, not {len(periods)}")
    omega = np.geomspace(2.0 * np.pi * LOWEST, np.pi / periods.pop(), FREQUENCIES)
    valves = linear_loop.linear_valves(plants)
    z = np.exp(1j * omega * plants[0].period)
    z[-1] = -1.0
    coulomb, presliding = np.array([(p.disturbance.coulomb, p.disturbance.presliding) for p in plants]).T
    position, response = linear_loop.valve_responses(valves, z)
    own = friction_swing.swings(np.zeros_like(position), position, z, coulomb, presliding)
    return Box(valves, omega, z, position, response, coulomb, presliding, own)


def margins(law: Law, params: Any, box: Box) -> Margins:
    """Margins of ``law`` with ``params`` around each valve of ``box``."""
    linear = linear_loop.linear_law(law, params, steps=linear_loop.stepped_side_by_side)
    radius = np.abs(linear_loop.dominant_poles(linear, box.valves))
    loop = -linear_loop.law_response(linear, box.z) * box.response
    rows = np.empty((len(loop), 6))
    compile_function(_sweep, nogil=True)(loop, box.omega, rows)
    gain, reduction, phase, delay, sensitivity, response = rows.T
    swing = friction_swing.swings(loop, box.position, box.z, box.coulomb, box.presliding)
    # A swing is the valve's own if the loop makes it no larger, and all the loop's from GROWN times that on.
    own = box.own_swing
    grown = np.divide(swing, own, out=np.full_like(swing, np.inf), where=own > 0.0)
    by_loop = swing * np.clip((grown - 1.0) / (GROWN - 1.0), 0.0, 1.0)
    found = Margins(radius, gain, reduction, phase, delay, sensitivity, response, by_loop)
    if_stable = {
        name: np.where(radius < 1.0 + EDGE, row, np.inf if name in PEAKS else 0.0)
        for name, row in found._asdict().items()
    }
    return Margins(**{**if_stable, "radius": radius})


def worst(found: Margins) -> Margins:
    """The least of each margin and the largest of each peak over the valves, as arrays of one entry."""
    return Margins._make(
        np.array([np.max(values) if name in ("radius", *PEAKS) else np.min(values)])
        for name, values in found._asdict().items()
    )


def as_dict(found: Margins, i: int = 0) -> dict[str, float | None]:
    """Margins of valve ``i`` for JSON; without end: None."""
    row = {name: float(values[i]) for name, values in found._asdict().items()}
    return {name: value if np.isfinite(value) else None for name, value in row.items()}


def _sweep(loop: Complexes, omega: Floats, rows: Floats) -> None:
    """Fill ``rows`` (N×6) from the responses ``loop`` (N×F) at ``omega`` [rad/s], F ascending.

    Gain margin and reduction [dB] are where a response crosses the negative real axis, phase margin [deg] and
    delay margin [s] where it crosses the unit circle; then the peaks [dB] of 1/(1 + L) and L/(1 + L).
    """
    for i in range(loop.shape[0]):
        gain = reduction = phase = delay = nearest = math.inf
        response = 0.0
        before, smaller = loop[i, 0], 1.0
        for k in range(loop.shape[1]):
            here = loop[i, k]
            size = here.real * here.real + here.imag * here.imag
            apart = (1.0 + here.real) * (1.0 + here.real) + here.imag * here.imag
            nearest = min(nearest, apart)
            response = max(response, size / apart)
            at = here.real if k == loop.shape[1] - 1 else 0.0  # half the sampling rate
            if before.imag * here.imag < 0.0:
                at = min(
                    at, before.real + before.imag / (before.imag - here.imag) * (here.real - before.real)
                )
            if at < 0.0:
                decibel = -20.0 * math.log10(-at)
                if decibel >= 0.0:
                    gain = min(gain, decibel)
                else:
                    reduction = min(reduction, -decibel)
            if (smaller - 1.0) * (size - 1.0) < 0.0:
                low, high = max(math.log(smaller), -1400.0), max(math.log(size), -1400.0)
                share = low / (low - high)
                turned = here * before.conjugate()
                angle = math.atan2(-before.imag, -before.real) + share * math.atan2(turned.imag, turned.real)
                lag = angle % (2.0 * math.pi)  # from the critical point
                frequency = omega[k - 1] * (omega[k] / omega[k - 1]) ** share
                phase = min(phase, math.degrees(min(lag, 2.0 * math.pi - lag)))
                delay = min(delay, lag / frequency)
            before, smaller = here, size
        rows[i, 0], rows[i, 1], rows[i, 2], rows[i, 3] = gain, reduction, phase, delay
        rows[i, 4], rows[i, 5] = -10.0 * math.log10(nearest), 10.0 * math.log10(response)
