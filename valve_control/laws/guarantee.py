"""Guaranteed bound on V2: what (25) and (52) promise as long as the valve keeps to its assumed ranges.

Both proofs end in dV2/dt <= -2λ·V2 + growth. By the comparison lemma V2 then stays below the solution of the
equation with the equals sign that starts at V2(0), here integrated exactly with ``growth`` held over a
period. With the robust term ``growth`` is ε and the bound is (25) or (52) itself. Without it, completing
the square with half of the feedback gain k leaves growth = h²/(2k) per error, h being the bound on
|θ̃ᵀφ| + |d̃| over the assumed ranges, and half of the decay rate.
"""

import math
from typing import NamedTuple

ANEW = -1.0  # V²/s² or V²  a bound that begins at the next V2


class Params(NamedTuple):
    """Exact discretisation of db/dt = -2λ·b + growth."""

    decay: float  # -  exp(-2λ·ΔT)
    gain: float  # s  (1 - exp(-2λ·ΔT))/(2λ)


def design(decay_rate: float, period: float) -> Params:
    """Bound with ``decay_rate`` 2λ [1/s], sampled every ``period`` [s]."""
    return Params(math.exp(-decay_rate * period), -math.expm1(-decay_rate * period) / decay_rate)


def begin(bound: float, lyapunov: float) -> float:
    """Bound at this sample: ``bound``, or V2 itself if it begins ANEW here."""
    return lyapunov if bound < 0.0 else bound


def advance(p: Params, bound: float, growth: float, applied: bool) -> float:
    """Bound one period later; nothing is promised unless the law's own voltage was applied."""
    return p.decay * bound + p.gain * growth if applied else ANEW
