"""What is left of a step after a takeover, let go without a kink."""

import math
from typing import NamedTuple


class Params(NamedTuple):
    """Critically damped decay, discretised exactly."""

    time: float  # s  time constant τ
    period: float  # s  ΔT
    decay: float  # -  exp(-ΔT/τ)


class State(NamedTuple):
    """Offset on its way to 0."""

    value: float  # V
    rate: float  # V/s


NOTHING = State(0.0, 0.0)
NEGLIGIBLE = 1e-9  # V; here a fade ends


def design(time: float, period: float) -> Params:
    """Decay with the time constant ``time`` [s], sampled every ``period`` [s]."""
    return Params(time, period, math.exp(-period / time))


def step(p: Params, s: State) -> State:
    """One period of τ²·ö + 2τ·ȯ + o = 0: it leaves its first value with slope 0 and never overshoots."""
    if abs(s.value) < NEGLIGIBLE and abs(s.rate) * p.time < NEGLIGIBLE:
        return NOTHING
    slope = s.rate + s.value / p.time
    return State((s.value + slope * p.period) * p.decay, (s.rate - slope * p.period / p.time) * p.decay)
