# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Computes the bound on V2 that (25) and (52) guarantee while the valve keeps to its assumed ranges.

Both proofs end in dV2/dt <= -2λ·V2 + growth. By the comparison lemma V2 then stays below the solution of the
equation with the equals sign that starts at V2(0), here integrated exactly with ``growth`` held over a
period. With the robust term ``growth`` is ε and the bound is (25) or (52) itself. Without it, completing
the square with half of the feedback gain k leaves growth = h²/(2k) per error, h being the bound on
|θ̃ᵀφ| + |d̃| over the assumed ranges, and half of the decay rate. OARC's bound counts in what sampling does.
"""

import math
from typing import NamedTuple

ANEW = -1.0  # V²/s² or V²  a bound that begins at the next V2; below it, one sample later for each 1.0
MEMORY = 2.0  # time constants


class Params(NamedTuple):
    """Exact discretisation of db/dt = -2λ·b + growth."""

    decay: float  # -  exp(-2λ·ΔT)
    gain: float  # s  (1 - exp(-2λ·ΔT))/(2λ)
    period: float  # s  ΔT
    rate: float  # 1/s  1/ΔT
    anew: float  # ANEW, less a sample for each that a filter still remembers another voltage


def design(decay_rate: float, period: float, memory: float = 0.0) -> Params:
    """Bound with ``decay_rate`` 2λ [1/s], sampled every ``period`` [s].

    ``memory`` [s]: time constant of the filter that a state of V2 comes through, 0.0: none. After another
    voltage than the law's the bound begins when MEMORY of them have passed.
    """
    return Params(
        math.exp(-decay_rate * period),
        -math.expm1(-decay_rate * period) / decay_rate,
        period,
        1.0 / period,
        ANEW - math.ceil(MEMORY * memory / period),
    )


def begin(bound: float, lyapunov: float) -> float:
    """Bound at this sample: ``bound``, or V2 itself if it begins ANEW here."""
    return lyapunov if bound < 0.0 else bound


def advance(p: Params, bound: float, growth: float, applied: bool) -> float:
    """Bound one period later; it begins anew unless the law's own voltage was ``applied``."""
    return p.decay * bound + p.gain * growth if applied else p.anew


def wait(p: Params, before: float, bound: float, growth: float, applied: bool) -> float:
    """Bound as of ``advance``; none while the bound ``before`` still waits for a filter to forget."""
    if applied and before < ANEW:
        return before + 1.0
    return advance(p, bound, growth, applied)


class Sample(NamedTuple):
    """What one sample of OARC leaves for the bound at the next."""

    bound: float  # V²  on V2 here; ANEW: it begins at the next V2
    growth: float  # V²/s  of the proof: h1²/(2·ks1) + ρ·h2²/(2·ks2), or ε11 + ε21
    z1: float  # V
    z2: float  # V·s
    rate: float  # V/s  of the reference
    position: float  # V  x1
    velocity: float  # V/s  calculable part of dx1/dt
    known: float  # V  known part of dz2/dt


FIRST = Sample(ANEW, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def output_feedback(p: Params, before: Sample, now: Sample, rho: float, slope: float) -> Sample:
    """Sample ``now``, given with V2 as its bound, with the bound on OARC's V2.

    The bound is (5) of docs/explanation/lyapunov_bound.md.

    ``rho`` [1/s²]: weight of z2² in V2; ``slope`` [s]: ∂α1/∂x1.
    """
    bound, growth, z1, z2, rate, position, velocity, known = now
    if before.bound >= 0.0:
        m1, m2 = 0.5 * (z1 + before.z1), 0.5 * (z2 + before.z2)
        unknown = position - before.position - 0.5 * p.period * (velocity + before.velocity)
        e1 = 0.5 * (rate - before.rate)
        e2 = (z2 - before.z2 + slope * unknown) * p.rate - 0.5 * (known + before.known)
        allowed = max(growth, before.growth) + m1 * e1 + rho * m2 * e2
        gained1, gained2 = z1 - before.z1, z2 - before.z2
        curvature = 0.125 * (1.0 - p.decay) * (gained1 * gained1 + rho * gained2 * gained2)
        bound = p.decay * before.bound + p.gain * allowed + curvature
        if bound < 0.0:
            bound = 0.0
    return Sample(bound, growth, z1, z2, rate, position, velocity, known)
