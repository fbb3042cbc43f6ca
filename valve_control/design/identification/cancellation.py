# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Designs pole-zero compensators (section 3.3) for any model, and checks sampling and voltage they need."""

from typing import NamedTuple

import numpy as np

from valve_control.control.laws import biquads, design
from valve_control.control.plant.models import TransferFunction
from valve_control.design.identification import bode
from valve_control.design.identification.bode import Corners, Root
from valve_control.parameter import ParameterError

LIGHT = 0.3  # damping below which a cancellation needs an exact model
WRONG = 0.1  # by which the valve's frequency may be off, for that warning
LOUD = 20.0  # times the static gain, amplification of the command's noise that is warned of
FAITHFUL = 0.2  # of the sampling frequency, up to which a bandwidth may go
NEAR = 0.05  # of the wanted bandwidth, by which -3 dB may miss it
MOST = 1e30  # largest coefficient of a model over its smallest
RESPONSE_TIME = 2.0  # s of the step response


class Compensator(NamedTuple):
    """A compensator, the response of valve and compensator together, and warnings."""

    model: TransferFunction
    transfer_function: TransferFunction
    sections: biquads.Params
    period: float  # s
    bandwidth: float  # Hz, wanted
    valve: Corners
    compensated: Corners
    sampled: Corners  # with hold and sampling
    largest_gain: float  # V/V, of the sampled compensator
    largest_at: float  # Hz
    largest_step: float  # V, of the command, from standstill at 0 V without saturation
    warnings: tuple[str, ...]


def make(
    model: TransferFunction,
    bandwidth: float,
    cancel_zeros: bool = True,
    order: int = 0,
    period: float = 0.001,
    u_max: float = 10.0,
) -> Compensator:
    """Design a compensator that gives ``model`` the ``bandwidth`` [Hz], and check it at ``period`` [s].

    Raises ParameterError.
    """
    try:
        check(model)
        transfer_function = design.pole_zero_compensator(model, bandwidth, cancel_zeros, order)
        sections = design.compensator_params(transfer_function, period, u_max)
    except design.DesignError as error:
        raise ParameterError(str(error)) from error
    if bandwidth >= FAITHFUL / period:
        raise ParameterError(
            f"a bandwidth of {bandwidth:g} Hz is too near to Nyquist's frequency, {0.5 / period:g} Hz; it "
            f"must be below {FAITHFUL / period:g} Hz"
        )
    valve, alone = (bode.response(one, bode.GRID) for one in (model, transfer_function))
    f = bode.GRID[np.less(bode.GRID, 0.4995 / period)]
    sampled = bode.sections_response(sections, f, period)
    loudest = int(np.argmax(np.abs(sampled)))
    designed = Compensator(
        model=model,
        transfer_function=transfer_function,
        sections=sections,
        period=period,
        bandwidth=bandwidth,
        valve=bode.corners(bode.GRID, valve),
        compensated=bode.corners(bode.GRID, valve * alone),
        sampled=bode.corners(f, bode.held_response(model, f, period) * sampled),
        largest_gain=float(np.abs(sampled[loudest])),
        largest_at=float(f[loudest]),
        largest_step=u_max / bode.step_peak(sections, min(20_000, round(RESPONSE_TIME / period))),
        warnings=(),
    )
    return designed._replace(warnings=tuple(_warnings(designed, cancel_zeros)))


def check(model: TransferFunction) -> None:
    """Raise DesignError unless ``model`` can be the response of a valve."""
    sizes = np.abs([x for part in model for x in part if x])
    if not np.all(np.isfinite(sizes)) or np.max(sizes, initial=0.0) > MOST * np.min(sizes, initial=np.inf):
        raise design.DesignError("the model has coefficients that are not finite, or of too different sizes")
    zeros, poles = (len(np.trim_zeros(np.asarray(part), "f")) - 1 for part in model)
    if not 0 <= zeros < poles:
        raise design.DesignError(
            f"the model has {zeros} zeros and {poles} poles (-1: it is 0); a valve has more poles than zeros"
        )


def _warnings(designed: Compensator, cancel_zeros: bool) -> list[str]:
    warnings = []
    zeros = bode.roots(designed.model.numerator) if cancel_zeros else []
    poles = bode.roots(designed.model.denominator)
    for part, roots in (("poles", poles), ("zeros", [root for root in zeros if root.damping > 0.0])):
        warnings += [
            f"the cancelled {part} at {root.frequency:.2f} Hz have a damping of {root.damping:.2f}: if the "
            f"valve's lie 10 % off, the response is wrong by up to {mismatch(root):.1f} dB there"
            for root in roots
            if root.pair and root.damping < LIGHT
        ]
    warnings += [
        f"the zero at {root.frequency:.2f} Hz lies to the right and stays in the response"
        for root in zeros
        if root.damping <= 0.0
    ]
    loud = designed.largest_gain / abs(designed.transfer_function.static_gain)
    if loud > LOUD:
        warnings.append(
            f"noise of the command comes out {designed.largest_gain:.3g} times larger at "
            f"{designed.largest_at:.4g} Hz ({loud:.3g} times the static gain)"
        )
    reached, sampled = designed.compensated.minus_3db, designed.sampled.minus_3db
    for frequency, also, why in (
        (reached, None, "the zeros that stay change the response"),
        (sampled, reached, f"sampled every {1e3 * designed.period:g} ms; sample faster or want less"),
    ):
        if not _near(frequency, designed.bandwidth) and not _near(frequency, also):
            there = "nowhere" if frequency is None else f"at {frequency:.2f} Hz"
            warnings.append(f"-3 dB comes {there}, not at the wanted {designed.bandwidth:g} Hz: {why}")
    return warnings


def _near(frequency: float | None, wanted: float | None) -> bool:
    return frequency is not None and wanted is not None and abs(frequency / wanted - 1.0) <= NEAR


def mismatch(root: Root) -> float:
    """Largest error [dB] of a cancelled pair if the valve's has a frequency 10 % higher or lower."""
    s = 1j * np.linspace(0.5, 2.0, 1000)
    pair, *wrong = ((s / f) ** 2 + 2.0 * root.damping * s / f + 1.0 for f in (1.0, 1.0 - WRONG, 1.0 + WRONG))
    return float(max(np.max(np.abs(20.0 * np.log10(np.abs(pair / other)))) for other in wrong))


def bode_figure(designed: Compensator, path: str) -> bytes:
    """Draw valve, compensator and both together, continuous and sampled, as the file ``path``."""
    from valve_control import outputs
    from valve_control.control.analysis.figures import COLOURS, bode_axes

    f = np.geomspace(0.1, 0.45 / designed.period, 800)
    valve, alone = bode.response(designed.model, f), bode.response(designed.transfer_function, f)
    held = bode.held_response(designed.model, f, designed.period)
    sections = bode.sections_response(designed.sections, f, designed.period)
    curves = [
        ("valve", valve, "black", "-"),
        ("compensator", alone, COLOURS[0], "-"),
        ("compensator, sampled", sections, COLOURS[0], "--"),
        ("compensated valve", valve * alone, COLOURS[1], "-"),
        ("compensated valve, sampled", held * sections, COLOURS[1], "--"),
    ]
    figure, top, bottom = bode_axes(f"pole-zero compensator for {designed.bandwidth:g} Hz", "gain [dB]")
    for label, value, colour, line in curves:
        top.semilogx(f, bode.decibels(value), color=colour, ls=line, label=label)
        bottom.semilogx(f, bode.degrees(value), color=colour, ls=line)
    top.axhline(-3.0, color="grey", lw=0.8)
    bottom.axhline(-90.0, color="grey", lw=0.8)
    top.set_ylim(-60.0, None)
    bottom.set_ylim(-500.0, None)
    top.legend(loc="lower left")
    figure.tight_layout()
    return outputs.figure_bytes(figure, path)
