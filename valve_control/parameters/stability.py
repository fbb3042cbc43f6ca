"""Do sample period and gains fit? Poles of the sampled loop of a law around the model it believes in."""

import types
from typing import Any

import numpy as np

from valve_control.laws.signals import Start
from valve_control.plant import valve
from valve_control.plant.models import TransferFunction

GAIN_MARGIN = 1.25  # of b0; the real valve's b0 lies that far from θ(0), and so does (2)
SCALE = 1e-6  # V; small enough that nothing saturates


def flatten(state: Any) -> list[float]:
    """Numbers of a nested NamedTuple, in order."""
    if isinstance(state, tuple):
        return [number for field in state for number in flatten(field)]
    return [state]


def unflatten(like: Any, numbers: list[float]) -> Any:
    """The NamedTuple shaped as ``like`` that holds ``numbers``; the list is used up."""
    if isinstance(like, tuple):
        return type(like)(*(unflatten(field, numbers) for field in like))
    return numbers.pop(0)


def spectral_radius(law: types.ModuleType, params: Any, theta: tuple[float, ...]) -> float:
    """Largest modulus of the loop's poles, estimates frozen, on the model s² + a1·s + a0 with gain b0.

    The step of the law is linear in its state as long as nothing saturates and nothing adapts, so the
    differences of single steps are the exact columns of the loop's transition matrix. A value of 1 or
    more means that this law is unstable on its own design model at this sample period.

    ``theta``: a1 [1/s], a0 [1/s²] and b0 [1/s²] of that model.
    """
    if "gamma" in params._fields:
        params = params._replace(gamma=type(params.gamma)(0.0, 0.0, 0.0, 0.0))
    period = params.period
    model = TransferFunction((theta[2],), (1.0, theta[0], theta[1]))
    plant = valve.design(
        model, period, params.u_max, 1.0, valve.Disturbance(0, 1, 1, 1, 0, 0, 0, 0, 0), 0.0, 0.0, 0.0, 0.0
    )
    law_zero = law.initial(params, Start(0.0, 0.0, 0.0, 0.0, 0.0))
    if "started" in law_zero._fields:
        law_zero = law_zero._replace(started=1.0)
    base = flatten(law_zero)

    def advance(numbers: list[float]) -> np.ndarray[Any, np.dtype[np.float64]]:
        state = unflatten(law_zero, list(numbers[2:]))
        x = valve.Row(numbers[0], numbers[1], 0.0, 0.0)
        voltage, after, _ = law.step(params, state, 0.0, x.x0, 0.0)
        x0 = valve.dot(plant.row0, x) + plant.input.x0 * voltage
        x1 = valve.dot(plant.row1, x) + plant.input.x1 * voltage
        return np.array([x0, x1, *flatten(after)])

    start = [0.0, 0.0, *base]
    rest = advance(start)
    columns = []
    for i in range(len(start)):
        disturbed = list(start)
        disturbed[i] += SCALE
        columns.append((advance(disturbed) - rest) / SCALE)
    matrix = np.array(columns).T
    moving = [i for i in range(len(start)) if not _is_memory(law_zero, i - 2)]
    return float(np.max(np.abs(np.linalg.eigvals(matrix[np.ix_(moving, moving)]))))


def _is_memory(state: Any, index: int) -> bool:
    """Whether entry ``index`` of the flattened state is an estimate or a flag, which does not move."""
    names = [name for name, field in state._asdict().items() for _ in flatten(field)]
    return index >= 0 and names[index] in ("theta", "started", "psi", "reference", "bound")


def warning(controller: str, law: types.ModuleType, params: Any) -> str:
    """One sentence if the sampled loop is unstable with b0 as assumed or 2 dB above it, else ""."""
    if controller in ("arc", "oarc"):
        theta = tuple(params.theta_initial[:3])
    elif controller == "pid":
        theta = (params.a1, params.a0, params.b0)
    else:
        return ""
    radius = max(
        spectral_radius(law, params, theta),
        spectral_radius(law, params, (*theta[:2], GAIN_MARGIN * theta[2])),
    )
    if radius < 1.0:
        return ""
    remedy = "shorten sample_period or lower the gains"
    if controller == "oarc":
        remedy = "shorten sample_period, raise oarc.z2_weight or lower the gains"
    return (
        f"{controller} with these gains is unstable, or within 2 dB of it, at a sample period of "
        f"{params.period:g} s (largest pole of the sampled loop: {radius:.3f}); {remedy}"
    )
