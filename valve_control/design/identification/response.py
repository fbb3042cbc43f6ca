# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Estimates the frequency response from voltage to position, with its uncertainty.

Everything is in samples: voltage k is held from reading k to reading k+1, so that no time of the middleware
enters. What is estimated is the response from held voltage to sampled position; its delay of half a sample
belongs to the model that is fitted (``bode.held_response``).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.fft

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
DISTORTED = 0.02  # of the amplitude, harmonics that are told
APART = 0.1  # of a voltage's spectrum in a band, what must not look like a transient
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


def stepped(
    voltage: Floats, position: Floats, segments: Sequence[Segment], period: float, settle: float
) -> Response:
    """Response at the frequency of each segment, from the whole cycles after its first ``settle`` [s].

    A sine, a cosine and a constant are fitted to voltage and position; the residual of the position gives the
    uncertainty. Samples that are NaN are left out. Raises ParameterError if too little is left.
    """
    points, notes = [], list[str]()
    most, at = DISTORTED, 0.0
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
        u, _ = phasor(voltage[k], k, turns)
        y, noise = phasor(position[k], k, turns)
        if abs(u) < 1e-6:
            raise ParameterError(f"the voltage does not move at {frequency:.4g} Hz; there is no excitation")
        harmonics = _harmonics(position[k], k, turns) / max(abs(y), 1e-300)
        most, at = max((most, at), (harmonics, frequency), key=lambda one: one[0])
        deviation = noise * math.sqrt(2.0 / len(k)) / abs(u)
        value = y / u
        if abs(value) < RESOLUTION * deviation:
            notes.append(
                f"{frequency:.4g} Hz is left out: its response of {abs(value):.2g} V/V is lost in "
                f"noise of {deviation:.2g} V/V"
            )
            continue
        coherence = 0.5 * abs(y) ** 2 / (0.5 * abs(y) ** 2 + noise**2)
        points.append((frequency, value, max(deviation, CERTAIN * abs(value)), coherence))
    if at > 0.0:
        notes.append(
            f"the position has harmonics of up to {100.0 * most:.3g} % (at {at:.4g} Hz): friction or another "
            "nonlinearity, so the response holds for this amplitude alone"
        )
    return _response(points, period, "stepped sine", notes)


def _harmonics(signal: Floats, index: npt.NDArray[np.int64], turns: float) -> float:
    """Amplitude of the second to fifth harmonic together, as far as they stand out of the noise."""
    orders = np.arange(1, min(5, math.floor(0.49 / turns)) + 1)
    waves = np.exp(2j * np.pi * turns * np.outer(index, orders))
    matrix = np.column_stack([np.ones(len(index)), waves.real, waves.imag])
    if len(index) <= 2 * matrix.shape[1]:
        return 0.0
    fit, _, _, _ = np.linalg.lstsq(matrix, signal, rcond=None)
    rest = signal - matrix @ fit
    floor = 2.0 * RESOLUTION * math.sqrt(2.0 * float(rest @ rest)) / len(index)
    sizes = np.hypot(fit[1 : len(orders) + 1], fit[len(orders) + 1 :])[1:]
    return math.hypot(*sizes[sizes > floor])


def phasor(signal: Floats, index: npt.NDArray[np.int64], turns: float) -> tuple[complex, float]:
    """Complex amplitude of ``turns`` per sample in ``signal``, and the standard deviation of the rest."""
    angle = 2.0 * np.pi * turns * index
    columns = np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(index))])
    fit, _, _, _ = np.linalg.lstsq(columns, signal, rcond=None)
    rest = signal - columns @ fit
    return complex(fit[0], -fit[1]), math.sqrt(float(rest @ rest) / (len(index) - 3))


def spectral(voltage: Floats, position: Floats, period: float, lowest: float, highest: float) -> Response:
    """Response from ``lowest`` to ``highest`` [Hz] by local polynomials [1], for a sweep or any other motion.

    Over a finite record the reading's spectrum is response·(voltage's spectrum) + transient, where the
    transient comes of what the record does not show, before its beginning and after its end. Response and
    transient are smooth, the voltage's spectrum is not: in each band of frequencies both are polynomials of
    second degree, fitted by least squares, and the response counts at the band's middle. So a record may
    begin and end in motion, and averaging over a band bends nothing. scipy.signal.csd and welch would cut a
    sweep into pieces, of which one alone holds a frequency. Residuals give the uncertainty. Raises
    ParameterError if too little is left.

    [1] R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapter 7.
    """
    refuse_aliased(highest, period)
    length = len(voltage) * period
    if lowest * length < LEAST_CYCLES:
        raise ParameterError(
            f"{lowest:g} Hz makes {lowest * length:.2g} cycles in {length:.3g} s; it needs {LEAST_CYCLES} "
            "(--band, or a longer test)"
        )
    # Increments: a mean that is not 0 stays out. No padding: it would turn the transient's phase.
    u, y = (
        np.asarray(scipy.fft.rfft(np.diff(signal)), dtype=np.complex128) for signal in (voltage, position)
    )
    frequency: Floats = np.fft.rfftfreq(len(voltage) - 1, period).astype(np.float64)
    strongest = float(np.max(np.abs(u[1:]) / frequency[1:]))
    points = []
    left_out = 0
    first = int(np.searchsorted(frequency, lowest))
    while first < len(frequency) and frequency[first] <= highest:
        end = max(first + BAND_BINS, int(np.searchsorted(frequency, frequency[first] * BAND_RATIO)))
        band = slice(first, end)
        first = end
        if end > len(frequency) or frequency[end - 1] > highest:
            break
        moved = _without_smooth(u[band])
        power = np.abs(moved) ** 2
        told_apart = np.sum(power) > APART**2 * np.sum(np.abs(u[band]) ** 2)
        if not told_apart or np.max(np.abs(moved) / frequency[band]) <= SILENT * strongest:
            left_out += 1
            continue
        middle = float(np.sum(power * frequency[band]) / np.sum(power))
        lines = float(np.sum(power)) ** 2 / float(np.sum(power**2))
        degree = DEGREE if lines >= 2 * (DEGREE + 1) else 0
        value, deviation, coherence = _local(u[band], y[band], frequency[band] - middle, degree)
        if coherence < LEAST_COHERENCE or abs(value) < RESOLUTION * deviation:
            left_out += 1
            continue
        points.append((middle, value, max(deviation, CERTAIN * abs(value)), coherence))
    reason = "the voltage does not move there, or the position is lost in noise"
    notes = [f"{left_out} bands of frequency are left out: {reason}"] if left_out else []
    return _response(points, period, "local polynomials", notes)


def _without_smooth(spectrum: Complexes) -> Complexes:
    """The part of a band of a spectrum that is not smooth, as a transient would be."""
    smooth, _ = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, len(spectrum)), DEGREE + 1))
    rest: Complexes = spectrum - smooth @ (smooth.T @ spectrum)
    return rest


def _local(u: Complexes, y: Complexes, offset: Floats, degree: int) -> tuple[complex, float, float]:
    """Response at ``offset`` [Hz] 0 of a band, its standard deviation (as in ``Response``) and coherence.

    ``degree``: of the response's polynomial, 0 where the voltage moves at a few frequencies alone.
    """
    smooth = np.vander(offset / np.max(np.abs(offset)), DEGREE + 1, increasing=True)
    columns = np.hstack([u[:, None] * smooth[:, : degree + 1], float(np.max(np.abs(u))) * smooth])
    inverse = np.linalg.pinv(columns, rcond=1e-10)
    found = inverse @ y
    free = len(u) - columns.shape[1]
    noise = float(np.sum(np.abs(y - columns @ found) ** 2)) / free
    deviation = math.sqrt(0.5 * noise * float(np.sum(np.abs(inverse[0]) ** 2)))
    motion = float(np.sum(np.abs(_without_smooth(y)) ** 2)) / (len(u) - DEGREE - 1)
    return complex(found[0]), deviation, min(1.0, max(0.0, 1.0 - noise / max(motion, 1e-300)))


def _response(
    points: list[tuple[float, complex, float, float]], period: float, method: str, notes: list[str]
) -> Response:
    if not points:
        reason = notes[0] if notes else "no frequency was excited"
        raise ParameterError(f"no frequency can be used: {reason}")
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
    found: list[Segment] = []
    first = 0
    for i in range(1, len(length) + 1):
        tolerance = max(SAME * length[first], JITTER)
        if i < len(length) and abs(length[i] - np.mean(length[first:i])) <= tolerance:
            continue
        if i - first >= LEAST_CYCLES:
            begin, end = math.ceil(passage[first]), math.floor(passage[i]) + 1
            segment = refined(u, begin, end, (i - first) / (passage[i] - passage[first]), period, PURE)
            found += [segment] if segment is not None else []
        first = i
    covered = sum(segment.end - segment.first for segment in found)
    # Of other motions, such as those of a controller, a few cycles may look alike by chance.
    if covered < COVERED * (passage[-1] - passage[0]):
        return []
    return [] if _swept(u, found, period) else found


def _swept(u: Floats, segments: Sequence[Segment], period: float) -> bool:
    """Whether the frequency rises or falls within the segments, so that they are pieces of a sweep."""
    drifts = []
    for first, end, frequency in segments:
        middle, turns = (first + end) // 2, frequency * period
        before = refined(u, first, middle, turns, period, 10.0 * PURE)
        behind = refined(u, middle, end, turns, period, 10.0 * PURE)
        if before is not None and behind is not None:
            drifts.append(abs(behind.frequency / before.frequency - 1.0))
    return bool(drifts) and float(np.median(drifts)) > DRIFT


def refined(
    voltage: Floats, first: int, end: int, turns: float, period: float, pure: float
) -> Segment | None:
    """The stretch with its frequency of about ``turns`` per sample made exact, if a sine is what it is.

    ``pure``: what may be left of it without the sine, over the sine's amplitude.
    """
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
    if abs(sine) < 1e-6 or rest > pure * abs(sine):
        return None
    return Segment(first, end, turns / period)
