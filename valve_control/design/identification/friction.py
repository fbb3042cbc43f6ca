# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Takes the friction of a valve, and the play of its magnet, off the voltage of a stepped sine."""

import math
from typing import NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.identification.experiment import Experiment
from valve_control.design.identification.response import Response, Segment, phasor

TEST: dict[str, object] = {"scenario": "triangle", "amplitude": 4.0, "frequency": 0.2, "cycles": 9}
SHARE = 0.6  # of u_max, amplitude of a stepped sine beside it: above most friction
PRESLIDING = (1e-3, 0.3)  # V  looked for
HIGHEST = 9  # harmonic of a stepped sine that is looked at
SETTLED = 0.4  # s
LEFT = 0.1  # share of the correction for friction and play that counts as its uncertainty


class Friction(NamedTuple):
    """What a triangle tells of a valve."""

    coulomb: float  # V  Coulomb friction as input voltage
    presliding: float  # V  deflection of the bristles; 0.0: not to be told
    static_gain: float  # V/V  of the valve as it was tested
    offset: float  # V  input disturbance
    strokes: int  # that it comes from


def lag_of(model: TransferFunction, delay: float) -> float:
    """Time [s] by which slow motions lag behind the voltage, with a dead time ``delay`` [s]."""
    n, d = model.numerator, model.denominator
    return d[-2] / d[-1] - (n[-2] / n[-1] if len(n) > 1 else 0.0) + delay


def without(tested: Experiment, found: Friction, play: float = 0.0, coil: float = 0.0) -> Experiment:
    """``tested``, a stepped sine, with the voltage that friction and play take of each sample taken off.

    The friction is that of a bristle which the harmonics of the position drag. ``found`` without a
    presliding has one of PRESLIDING's lower bound. The ``play`` [V], half a hysteresis, is that of the
    force, which lags behind the voltage by the ``coil`` [s].
    """
    delta = found.presliding if found.presliding > 0.0 else PRESLIDING[0]
    voltage = tested.voltage.copy()
    for segment in tested.segments:
        position = _harmonics(tested, segment)
        if position is None:
            continue
        part = slice(segment.first, segment.end)
        rubbing = found.coulomb * _dragged(position, delta)
        voltage[part] -= rubbing
        if play > 0.0:
            voltage[part] -= _of_magnet(tested.voltage[part], rubbing, segment, tested.period, play, coil)
    return tested._replace(voltage=voltage)


def _of_magnet(
    voltage: Floats, rubbing: Floats, segment: Segment, period: float, play: float, coil: float
) -> Floats:
    """Voltage [V] that play and lag of the magnet take of a sine ``voltage``; ``rubbing`` [V]: of friction.

    Friction acts on the force, so that a voltage which makes up for it leads by the coil. For the sine alone
    that counts in a response.
    """
    turns = segment.frequency * period
    index = np.arange(segment.first, segment.end)
    known = np.isfinite(voltage)
    given = phasor(voltage[known], index[known], turns)[0]
    settled = slice(len(index) // 2, None)
    rubbed = phasor(rubbing[settled], index[settled], turns)[0]
    lead = 2j * math.pi * segment.frequency * coil
    force = abs(given / (1.0 + lead))
    taken = rubbed * lead + given * (1.0 - through_play(play / force) if force > play else 0.0)
    made: Floats = np.real(taken * np.exp(2j * math.pi * turns * index))
    return made


def through_play(share: float) -> complex:
    """Describing function of a play, of which half the width is this ``share`` of the amplitude, 0 to 1.

    J.-J. Slotine, W. Li, Applied Nonlinear Control (1991), section 5.2 (backlash).
    """
    turned = 1.0 - 2.0 * share
    root = math.sqrt(1.0 - turned * turned)
    return complex(0.5 + (math.asin(turned) + turned * root) / math.pi, -(root * root) / math.pi)


def unsure(measured: Response, seen: Response) -> Response:
    """``measured`` behind ``without``, with the uncertainty of its correction of the response ``seen``.

    Otherwise poles and zeros would explain the rest of friction and play.
    """
    taken = np.abs(measured.value - np.interp(measured.frequency, seen.frequency, seen.value))
    return measured._replace(deviation=np.hypot(measured.deviation, LEFT * taken))


def _harmonics(tested: Experiment, segment: Segment) -> Floats | None:
    """Position [V] of a stretch and one sample more by its steady odd harmonics; None: too few readings."""
    count = segment.end - segment.first
    steps = np.arange(count + 1)
    omega = 2.0 * math.pi * segment.frequency * tested.period
    order = max(1, min(HIGHEST, int(0.9 * math.pi / omega)))
    angles = np.outer(steps, omega * np.arange(1, order + 1, 2))
    basis = np.column_stack([np.ones(count + 1), np.cos(angles), np.sin(angles)])
    reading = tested.position[segment.first : segment.end]
    usable = np.isfinite(reading) & (steps[:-1] >= min(SETTLED / tested.period, 0.5 * count))
    if np.count_nonzero(usable) < 2 * basis.shape[1]:
        return None
    fitted: Floats = basis @ np.linalg.lstsq(basis[:-1][usable], reading[usable], rcond=None)[0]
    return fitted


def _dragged(position: Floats, delta: float) -> Floats:
    """Deflections of a bristle, over those of sliding, at the end of each step of ``position`` [V]."""
    z = 0.0
    found = np.empty(len(position) - 1)
    for k, way in enumerate((np.diff(position) / delta).tolist()):
        z = (z + way) / (1.0 + abs(way))
        found[k] = z
    return found
