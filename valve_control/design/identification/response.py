# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Estimates the frequency response from voltage to position, with its uncertainty.

Everything is in samples: voltage k is held from reading k to reading k+1, so that no time of the middleware
enters. What is estimated is the response from held voltage to sampled position; its delay of half a sample
belongs to the model that is fitted (``bode.held_response``).
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.linalg

from valve_control.arrays import Complexes, Floats
from valve_control.control.commands.arrays import refuse_aliased
from valve_control.control.commands.scenarios import Step
from valve_control.parameter import ParameterError

LEAST_CYCLES = 2
LEAST_SAMPLES = 8  # of a sine
COVERED = 0.5  # of a motion, by stretches of one frequency, from which on it is a stepped sine
SAME, JITTER = 0.02, 0.75  # of its length, and samples, by which cycles of one frequency may differ
DRIFT = 0.003  # by which the halves of a stretch of one frequency may differ
PURE = 0.2  # of a sine's amplitude that may be left without the sine: jitter of a clock leaves some
LEAST_COHERENCE = 0.5
RESOLUTION = 3.0  # standard deviations below which a response cannot be told from noise
CERTAIN = 1e-6  # relative uncertainty that no response falls below
BAND_RATIO = 1.06  # upper over lower end of a band of frequencies that is averaged over
BAND_BINS = 12  # at least, in it
DEGREE = 2  # of the polynomials in it
APART = 0.1  # of a voltage's spectrum in a band, what must not look like a transient
NEXT = "record a stepped sine or a sweep of 60 s from 0.5 Hz on, with a larger amplitude"
SILENT = 1e-3  # of the largest amplitude, below which a voltage does not move


class Segment(NamedTuple):
    """Samples with one excitation frequency, their transient included."""

    first: int
    end: int
    frequency: float  # Hz


def segments_of(steps: Sequence[Step], period: float, start: float = 0.0) -> list[Segment]:
    """Samples of the ``steps`` of a stepped sine that begins at ``start`` [s]."""
    return [
        Segment(
            math.ceil((start + step.start) / period - 1e-9),
            math.floor((start + step.end) / period + 1e-9),
            step.frequency,
        )
        for step in steps
    ]


class Response(NamedTuple):
    """Frequency response from held voltage to sampled position, with standard deviations."""

    frequency: Floats  # Hz
    value: Complexes  # V/V
    deviation: Floats  # V/V, standard deviation of real and imaginary part each
    coherence: Floats  # share of the reading's motion that is linear in the voltage
    period: float  # s
    method: str  # stepped sine or local polynomials
    notes: tuple[str, ...]  # frequencies left out, and why

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "frequency_hz": self.frequency,
            "real": self.value.real,
            "imaginary": self.value.imag,
            "deviation": self.deviation,
            "coherence": self.coherence,
        }


def stepped(
    voltage: Floats, position: Floats, segments: Sequence[Segment], period: float, settle: float
) -> Response:
    """Response at the frequency of each segment, from the whole cycles after its first ``settle`` [s].

    A sine, a cosine and a constant are fitted to voltage and position; the residuals of both give the
    uncertainty. Samples that are NaN are left out. Raises ParameterError if too little is left.
    """
    points, notes = [], list[str]()
    for first, end, frequency in segments:
        refuse_aliased(frequency, period)
        turns = frequency * period
        cycle = 1.0 / turns
        count = math.floor((end - first - settle / period) / cycle + 1e-6)
        if count < LEAST_CYCLES:
            notes.append(
                f"{frequency:.4g} Hz is left out: it has {max(0, count)} whole cycles after its "
                f"transient of {settle:g} s; it needs {LEAST_CYCLES} (cycles and step_time, or --settle)"
            )
            continue
        k = np.arange(end - round(count * cycle), end)
        k = k[np.isfinite(voltage[k]) & np.isfinite(position[k])]
        if len(k) < LEAST_SAMPLES:
            raise ParameterError(f"{frequency:.4g} Hz has only {len(k)} readings; it needs {LEAST_SAMPLES}")
        u, around = phasor(voltage[k], k, turns)
        y, noise = phasor(position[k], k, turns)
        if abs(u) < 1e-6:
            raise ParameterError(f"the voltage does not move at {frequency:.4g} Hz; there is no excitation")
        value = y / u
        deviation = math.hypot(noise, abs(value) * around) * math.sqrt(2.0 / len(k)) / abs(u)
        if abs(value) < RESOLUTION * deviation:
            notes.append(
                f"{frequency:.4g} Hz is left out: its response of {abs(value):.2g} V/V is lost in "
                f"noise of {deviation:.2g} V/V"
            )
            continue
        shares = [0.5 * abs(x) ** 2 / (0.5 * abs(x) ** 2 + n**2) for x, n in ((u, around), (y, noise))]
        points.append((frequency, value, max(deviation, CERTAIN * abs(value)), min(shares)))
    return _response(points, period, "stepped sine", notes)


def phasor(signal: Floats, index: npt.NDArray[np.int64], turns: float) -> tuple[complex, float]:
    """Complex amplitude of ``turns`` per sample in ``signal``, and the standard deviation of the rest."""
    angle = 2.0 * np.pi * turns * index
    columns = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(index))])
    fit, _, _, _ = np.linalg.lstsq(columns, signal, rcond=None)
    rest = signal - columns @ fit
    return complex(fit[0], -fit[1]), math.sqrt(float(rest @ rest) / (len(index) - 3))


def spectral(stretches: Sequence[Floats], period: float, lowest: float, highest: float) -> Response:
    """Response from ``lowest`` to ``highest`` [Hz] by local polynomials [1], for a sweep or any other motion.

    ``stretches``: whole parts of the record, each 3×samples: excitation, voltage and position [V]. Over a
    finite stretch the position's spectrum is response·(voltage's spectrum) + transient, where the transient
    comes of what the stretch does not show, before its beginning and after its end. Response and transients
    are smooth, the spectrum of the excitation is not: in each band of frequencies they are polynomials of
    second degree, one transient for each stretch, and the response counts at the band's middle. So a record
    may begin and end in motion, and averaging over a band bends nothing. scipy.signal.csd and welch would cut
    a sweep into pieces, of which one alone holds a frequency. The excitation is the instrument [2]: the
    voltage itself, which is least squares, or under feedback the command, of which noise knows nothing.
    Residuals give the uncertainty. Raises ParameterError if too little is left.

    [1] R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapter 7.
    [2] T. Söderström, P. Stoica, Instrumental Variable Methods for System Identification (1983).
    """
    refuse_aliased(highest, period)
    ordered = sorted(stretches, key=lambda stretch: -stretch.shape[1])
    length = ordered[0].shape[1] * period
    if lowest * length < LEAST_CYCLES:
        raise ParameterError(
            f"{lowest:g} Hz makes {lowest * length:.2g} cycles in {length:.3g} s; it needs {LEAST_CYCLES} "
            "(--band, or a longer test)"
        )
    # Increments: a mean that is not 0 stays out. No padding: it would turn the transient's phase.
    spectra: list[Complexes] = [
        scipy.fft.rfft(np.diff(stretch)) / math.sqrt(stretch.shape[1]) for stretch in ordered
    ]
    grids = [np.fft.rfftfreq(stretch.shape[1] - 1, period) for stretch in ordered]
    strongest = max(np.max(np.abs(s[0, 1:]) / f[1:]) for s, f in zip(spectra, grids, strict=True))
    frequency, points, first = grids[0], [], int(np.searchsorted(grids[0], lowest))
    still, incoherent = 0, dict[float, float]()  # coherence by frequency [Hz]
    while first < len(frequency) and frequency[first] <= highest:
        begin = first
        first = end = max(begin + BAND_BINS, int(np.searchsorted(frequency, frequency[begin] * BAND_RATIO)))
        if end > len(frequency) or frequency[end - 1] > highest:
            break
        within = [(f >= frequency[begin]) & (f <= frequency[end - 1]) for f in grids]
        within = [part if np.count_nonzero(part) > DEGREE + 1 else part & False for part in within]
        r, u, y = np.hstack([s[:, part] for s, part in zip(spectra, within, strict=True)])
        parts = [f[part] for f, part in zip(grids, within, strict=True)]
        at = np.concatenate(parts)
        blocks = [np.vander(part / frequency[begin] - 1.0, DEGREE + 1) for part in parts if len(part)]
        smooth, _ = np.linalg.qr(scipy.linalg.block_diag(*blocks))
        moved = _apart(r, smooth)
        power = np.abs(moved) ** 2
        told_apart = np.sum(power) > APART**2 * np.sum(np.abs(r) ** 2)
        if not told_apart or np.max(np.abs(moved) / at) <= SILENT * strongest:
            still += 1
            continue
        middle = float(np.sum(power * at) / np.sum(power))
        lines = float(np.sum(power)) ** 2 / float(np.sum(power**2))
        degree = DEGREE if lines >= 2 * (DEGREE + 1) else 0
        value, deviation, coherence = _local(r, u, y, at - middle, smooth, degree)
        if coherence < LEAST_COHERENCE or abs(value) < RESOLUTION * deviation:
            incoherent[middle] = coherence
            continue
        points.append((middle, value, max(deviation, CERTAIN * abs(value)), coherence))
    reasons = [f"in {still} the excitation does not move"] if still else []
    if incoherent:
        last = points[-1][0] if points else math.inf
        above = f" above {last:.3g} Hz" if min(incoherent) > last else ""
        least = min(incoherent.values())
        reasons.append(
            f"in {len(incoherent)}{above} the position is lost in noise or another motion: its coherence "
            f"with the excitation falls to {least:.2g}, and must be {LEAST_COHERENCE:g} at least"
        )
    count = still + len(incoherent)
    notes = [f"{count} of {count + len(points)} bands of frequency are left out: {', '.join(reasons)}"]
    return _response(points, period, "local polynomials", notes if count else [])


def _apart(spectrum: Complexes, smooth: Floats) -> Complexes:
    """The part of a band of a ``spectrum`` that is not smooth, as a transient would be."""
    rest: Complexes = spectrum - smooth @ (smooth.T @ spectrum)
    return rest


def _local(
    r: Complexes, u: Complexes, y: Complexes, offset: Floats, smooth: Floats, degree: int
) -> tuple[complex, float, float]:
    """Response at ``offset`` [Hz] 0 of a band, its standard deviation (as in ``Response``) and coherence.

    ``r``, ``u``, ``y``: excitation, voltage, position; ``smooth``: basis of transients; ``degree``: of the
    response's polynomial, 0 where the excitation moves at a few frequencies alone. Two-stage least squares:
    the voltage counts as far as excitation and transients explain it. The coherence is the lesser one of
    voltage and position with the excitation.
    """
    powers = np.vander(offset / np.max(np.abs(offset)), degree + 1, increasing=True)
    transients = float(np.max(np.abs(u))) * smooth
    instruments, columns = (np.hstack([x[:, None] * powers, transients]) for x in (r, u))
    span, _ = np.linalg.qr(instruments)
    inverse = np.linalg.pinv(span @ (span.conj().T @ columns), rcond=1e-10)
    found, free = inverse @ y, len(u) - columns.shape[1]
    noise = float(np.sum(np.abs(y - columns @ found) ** 2)) / free
    deviation = math.sqrt(0.5 * noise * float(np.sum(np.abs(inverse[0]) ** 2)))
    shares = []
    for x in (u, y):
        rest = float(np.sum(np.abs(x - span @ (span.conj().T @ x)) ** 2)) / free
        motion = float(np.sum(np.abs(_apart(x, smooth)) ** 2)) / (len(x) - smooth.shape[1])
        shares.append(1.0 - rest / max(motion, 1e-300))
    return complex(found[0]), deviation, min(1.0, max(0.0, min(shares)))


def _response(
    points: list[tuple[float, complex, float, float]], period: float, method: str, notes: list[str]
) -> Response:
    if not points:
        few = f"too few of those asked for can be seen in readings {period:.4g} s apart"
        raise ParameterError(f"no frequency can be used: {f'{notes[0]}; {NEXT}' if notes else few}")
    columns = list(zip(*sorted(points, key=lambda point: point[0]), strict=True))
    frequency, deviation, coherence = (np.array(columns[i], dtype=np.float64) for i in (0, 2, 3))
    value = np.array(columns[1], dtype=np.complex128)
    return Response(frequency, value, deviation, coherence, period, method, tuple(notes))


def find_segments(voltage: Floats, period: float) -> list[Segment]:
    """Stretches of one frequency in a recorded ``voltage`` [V]; empty for a sweep or another motion.

    Cycles lie between upward passages through the middle; neighbours of one length belong together if a sine
    is what they are.
    """
    middle = 0.5 * (float(np.nanmax(voltage)) + float(np.nanmin(voltage)))
    u = np.where(np.isfinite(voltage), voltage, middle) - middle
    before = np.flatnonzero((u[:-1] <= 0.0) & (u[1:] > 0.0))
    if len(before) < 3:
        return []
    passage = before + u[before] / (u[before] - u[before + 1])
    length = np.diff(passage)
    found, drifts, first = list[Segment](), list[float](), 0
    for i in range(1, len(length) + 1):
        tolerance = max(SAME * length[first], JITTER)
        if i < len(length) and abs(length[i] - np.mean(length[first:i])) <= tolerance:
            continue
        if i - first >= LEAST_CYCLES:
            begin, end = math.ceil(passage[first]), math.floor(passage[i]) + 1
            segment = _sine(u, begin, end, (i - first) / (passage[i] - passage[first]), period)
            if segment is not None:
                found.append(segment)
                halves = [float(np.mean(half)) for half in np.array_split(length[first:i], 2)]
                drifts.append(abs(halves[1] / halves[0] - 1.0))
        first = i
    covered = sum(segment.end - segment.first for segment in found)
    # Of other motions, such as those of a controller, a few cycles may look alike by chance; the frequency of
    # a sweep rises or falls within the segments.
    if covered < COVERED * (passage[-1] - passage[0]) or float(np.median(drifts)) > DRIFT:
        return []
    return found


def _sine(voltage: Floats, first: int, end: int, turns: float, period: float) -> Segment | None:
    """The stretch with its frequency of about ``turns`` per sample made exact, if a sine is what it is."""
    if end - first < LEAST_SAMPLES:
        return None
    k = np.arange(first, end)
    u = voltage[first:end]
    for _ in range(4):
        angle = 2.0 * np.pi * turns * k
        sine, _ = phasor(u, k, turns)
        # One more column: what the sine gains as its frequency grows.
        slope = np.real(1j * sine * np.exp(1j * angle)) * 2.0 * np.pi * (k - k.mean())
        columns = np.column_stack([np.cos(angle), np.sin(angle), slope, np.ones(len(k))])
        fit, _, _, _ = np.linalg.lstsq(columns, u, rcond=None)
        turns += float(fit[2])
        if not 0.0 < turns < 0.5:
            return None
    sine, rest = phasor(u, k, turns)
    if abs(sine) < 1e-6 or rest > PURE * abs(sine):
        return None
    return Segment(first, end, turns / period)
