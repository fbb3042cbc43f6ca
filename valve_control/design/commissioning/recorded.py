# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Learns a valve that is known in outline from a recording of normal operation, in closed loop.

The valve is simulated under the recorded voltages, and what one valve differs in from its like (gain, speed,
offset, friction, dead time) is fitted to the readings. The voltage is known, so that feedback biases nothing
as long as the noise of a reading tells nothing of the next one's. A quantity that the recording does not
determine stays as it was known, and in the box as wide as before. Readings tell the dead time of a valve with
solenoids as a whole: the sensor keeps what is known of it, and the rest is the actuator's.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.optimize
import scipy.signal

from valve_control.arrays import Floats
from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, NODES
from valve_control.control.plant import registry
from valve_control.control.plant.amplifier import saturate
from valve_control.control.simulation.robustness import Quantity, Settings
from valve_control.design.commissioning.plant import first_reading, positions
from valve_control.design.identification import dead_time, lvdt, recorded
from valve_control.design.identification.experiment import Experiment, held
from valve_control.design.tuning import request
from valve_control.design.tuning.trial import TuningMotion
from valve_control.parameter import ParameterError, Values, number, updated
from valve_control.recordings import recording
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.recording import Recording, ValveRecording

START = 0.3  # s  in which the simulated valve, which begins at rest, moves as the spool did
SPREAD = 8.0  # times the noise: range of some hundred readings of a spool that stands still
LEAST_MOTION = 5.0  # times the noise: least standard deviation of readings that tell something
QUIET = 1e-3  # V  noise that is assumed at least
CONFIDENCE = 1.96
LAGS = 2.0  # s  over which residuals may be alike
EVALUATIONS = 30
STEP = 2e-3  # of a unit below, for the Jacobian
COARSE = 1e-2  # likewise with solenoids, whose play and friction make the residual rough
DEAD_TIMES = [0.0002 * i for i in range(16)]  # s  from which a search with solenoids begins, if one is better
ROUGH = 1e-4  # s  by which such a search ends beside the least residual, which no Jacobian shows


class Learnt(NamedTuple):
    """One quantity as the recording shows it."""

    name: str
    unit: str
    value: float  # of gain and speed: times that of the known valve
    bound: float  # half-width of its 95 % confidence interval
    determined: bool

    @property
    def sentence(self) -> str:
        """For the user."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        times = " (times the known valve's)" if self.name in FACTORS else ""
        if self.determined:
            digits = max(0, 1 - math.floor(math.log10(max(self.bound, 1e-9))))
            return f"{self.name}: {self.value:z.{digits}f} ± {self.bound:.{digits}f}{unit}{times}"
        return f"{self.name}: not determined by this recording; stays {self.value:.4g}{unit}{times}"


class RecordedValve(NamedTuple):
    """The valve of a recording."""

    values: Values  # of the simulated valve
    learnt: list[Learnt]
    residual: float  # V  rms, of the readings
    notes: list[str]


class RecordedRun(NamedTuple):
    """What a recorded run says of its valve, and what to tune on."""

    fitted: RecordedValve
    settings: Settings  # parameters by node
    box: list[Quantity]  # around the fitted valve
    motion: TuningMotion
    notes: Sequence[str]


class _Form(NamedTuple):
    name: str
    unit: str
    scale: float  # of a unit of the search
    certain: float  # largest bound that counts as determined
    margin: float  # that the box has beyond what was found, for another day
    least: float  # bounds of the search
    most: float


FORMS = (
    _Form("gain", "-", 0.1, 0.1, 0.05, 0.2, 5.0),
    _Form("speed", "-", 0.1, 0.1, 0.05, 0.2, 5.0),
    _Form("disturbance.offset", "V", 0.1, 0.05, 0.1, -9.0, 9.0),
    _Form("friction.coulomb", "V", 0.1, 0.05, 0.1, 0.0, 9.0),
    _Form("lvdt.delay", "s", 0.001, 0.0005, 0.00025, 0.0, 0.02),
)
FACTORS = ("gain", "speed")  # of the known valve's
BEFORE_COIL = "solenoid.dead_time"  # of the actuator
WHOLE = "dead_time"  # name of that of actuator and sensor together


def run(
    name: str,
    loaded: Recording,
    valve: ValveRecording,
    settings: Settings,
    quantities: Sequence[Quantity],
    fixed: Sequence[str],
    chosen: Values,
) -> RecordedRun:
    """What the recording ``name`` of a ``valve`` says, beside the known ``settings``.

    ``quantities`` of the box that it does not determine stay; ``fixed`` ones keep their value. ``chosen``:
    the controller's parameters that somebody has chosen; else those of the recording. Raises ParameterError
    and BagError.
    """
    if "spool_command" not in valve.signals or len(valve.signals["spool_command"].time) == 0:
        raise BagError(f"{valve.name} has no spool_command, so there is nothing to tune on")
    tested = recorded.recorded(loaded, valve)
    fitted = learnt(tested, settings["valve_simulator"], fixed)
    controller = settings["controller"]
    if valve.controller is not None:
        last = dict(valve.controller.initial)
        for change in valve.controller.changes:
            last.update(change.values)
        controller = updated(CONTROLLER, valve.controller.table_values(last)[0], chosen)
    u_max = number(fitted.values, "u_max")
    controller = updated(CONTROLLER, controller, {"sample_period": tested.period, "u_max": u_max})
    command = recording.align(valve).command
    wanted = motion(command, tested.period, number(controller, "command_limit"))
    source = {**settings["command_source"], "sample_period": tested.period}
    own = {**settings, "controller": controller, "valve_simulator": fitted.values, "command_source": source}
    moved = request.motion_of(name, wanted, own)
    return RecordedRun(fitted, own, box(fitted, quantities), moved, [*fitted.notes, *tested.notes])


def as_dict(fitted: RecordedValve) -> dict[str, Any]:
    """For JSON: the quantities of the fitted valve, and the rms residual [V] of its readings."""
    rows = {
        name: {"value": value, "bound": bound if determined else None, "determined": determined}
        for name, _, value, bound, determined in fitted.learnt
    }
    return {"valve": rows, "residual": fitted.residual}


def learnt(tested: Experiment, known: Values, fixed: Sequence[str]) -> RecordedValve:
    """What the recording ``tested`` shows of the ``known`` valve; quantities ``fixed`` stay as they are.

    Raises ParameterError, one sentence, for a recording without excitation.
    """
    voltage, reading, times, notes = held(tested.voltage), tested.position, tested.times, list[str]()
    if times is not None:
        voltage, reading = times.voltage, np.where(times.late, np.nan, reading)
        notes = dead_time.way_notes(times.way)
    voltage, seen, usable = np.nan_to_num(voltage), lvdt.observe(reading), np.isfinite(reading)
    moved = float(np.std(reading[usable])) if np.any(usable) else 0.0
    noise = max(QUIET, float(np.hypot(seen.noise, seen.resolution / np.sqrt(12.0))))
    if moved < LEAST_MOTION * noise:
        raise ParameterError(
            f"{tested.source} has no excitation: the readings move by {moved:.2g} V (standard deviation) and "
            f"have {noise:.2g} V of noise; record the loop while its command moves"
        )
    # With sample period and limits of the recording, and without steps of the converters.
    changes = {"sample_period": tested.period, "u_max": max(0.1, tested.u_max)}
    changes |= {"lvdt.resolution": 0.0, "solenoid.bits": 0}
    if number(known, "solenoid.u_min") == -number(known, "u_max"):
        changes["solenoid.u_min"] = -changes["u_max"]
    base = updated(NODES["valve_simulator"], known, changes)
    begin = {form.name: 1.0 if form.name in FACTORS else number(base, form.name) for form in FORMS}
    begin["lvdt.delay"] += number(base, BEFORE_COIL) if _has_coil(base) else 0.0
    free = [form for form in FORMS if form.name not in fixed]
    usable[: round(START / tested.period)] = False
    unknown: list[Learnt] = []
    while free:
        found, residual = _search(base, begin, free, voltage, reading, usable)
        worst = int(np.argmax([one.bound / form.certain for one, form in zip(found, free, strict=True)]))
        if found[worst].determined:
            lvdt_of = {"lvdt.noise": seen.noise, "lvdt.resolution": seen.resolution}
            values = _with(base, {one.name: one.value for one in found})
            values = updated(NODES["valve_simulator"], values, lvdt_of)
            whole = {"lvdt.delay": WHOLE} if _has_coil(base) else {}
            quantities = [one._replace(name=whole.get(one.name, one.name)) for one in (*found, *unknown)]
            return RecordedValve(values, quantities, residual, notes)
        unknown.append(found[worst]._replace(value=begin[found[worst].name]))
        del free[worst]
    raise ParameterError(
        f"{tested.source} has no excitation: its motion determines none of "
        f"{', '.join(one.name for one in unknown)}; record the loop while its command moves"
    )


def box(fitted: RecordedValve, usual: Sequence[Quantity]) -> list[Quantity]:
    """The ``usual`` box, narrower in what was determined, around the ``fitted`` valve."""
    named = {"lvdt.delay" if one.name == WHOLE else one.name: one for one in fitted.learnt}
    margins = {form.name: form.margin for form in FORMS}
    quantities = {q.name: q for q in usual if q.name in margins}
    for name, q in quantities.items():
        if name in named and named[name].determined:
            middle = 1.0 if name in FACTORS else number(fitted.values, name)
            reach = named[name].bound + margins[name]
            low = max(0.0, middle - reach) if q.low >= 0.0 else middle - reach
            quantities[name] = q._replace(low=low, high=middle + reach)
    return list(quantities.values())


def _has_coil(values: Values) -> bool:
    return registry.chosen(values).name == "solenoid"


def _with(base: Values, quantities: Mapping[str, float]) -> Values:
    """``base`` with the quantities in their places. Raises ParameterError."""
    gain, speed = quantities.get("gain", 1.0), quantities.get("speed", 1.0)
    others = {name: value for name, value in quantities.items() if name not in FACTORS}
    if "lvdt.delay" in others and _has_coil(base):
        behind = min(others["lvdt.delay"], number(base, "lvdt.delay"))
        others |= {"lvdt.delay": behind, BEFORE_COIL: others["lvdt.delay"] - behind}
    scaled = registry.chosen(base).scaled(base, gain, speed)
    return updated(NODES["valve_simulator"], base, {**others, **scaled})


def _search(
    base: Values,
    begin: Mapping[str, float],
    free: Sequence[_Form],
    voltage: Floats,
    reading: Floats,
    usable: npt.NDArray[np.bool_],
) -> tuple[list[Learnt], float]:
    """The ``free`` quantities as ``reading`` [V] shows them, and the rms residual [V]."""
    quiet = {**base, "lvdt.noise": 0.0}
    period = number(base, "sample_period")
    begin_at = _standing(reading, period)

    def quantities(x: Floats) -> dict[str, float]:
        return {
            form.name: float(begin[form.name] + form.scale * (v - 1.0))
            for form, v in zip(free, x.tolist(), strict=True)
        }

    def residual(x: Floats) -> Floats:
        with np.errstate(over="ignore", invalid="ignore"):
            position = positions(build.valve_params(_with(quiet, quantities(x))), voltage, begin_at)
        rest: Floats = np.clip(np.nan_to_num(position - reading, nan=1e3)[usable], -1e3, 1e3)
        return rest

    low = [1.0 + (form.least - begin[form.name]) / form.scale for form in free]
    high = [1.0 + (form.most - begin[form.name]) / form.scale for form in free]
    start = np.clip(np.ones(len(free)), np.array(low) + 0.02, np.array(high) - 0.02)
    rough = _has_coil(base)
    if rough and free[-1].name == "lvdt.delay":
        units = [1.0 + (d - begin["lvdt.delay"]) / free[-1].scale for d in DEAD_TIMES]
        tried = [start, *(np.append(start[:-1], max(unit, low[-1] + 0.02)) for unit in units)]
        start = min(tried, key=lambda x: float(np.sum(residual(x) ** 2)))
    done = scipy.optimize.least_squares(
        residual, start, bounds=(low, high), diff_step=COARSE if rough else STEP, max_nfev=EVALUATIONS
    )
    rest = np.asarray(done.fun, dtype=np.float64)
    variance = float(np.mean(rest**2)) * _alike(rest, period)
    inverse = np.linalg.pinv(done.jac.T @ done.jac, rcond=1e-12)
    seen = np.linalg.norm(done.jac, axis=0)
    deviation = np.sqrt(np.diag(inverse) * variance)
    bounds = CONFIDENCE * np.where(seen > 0.0, deviation, np.inf) * [form.scale for form in free]
    if rough:
        late = [form.name == "lvdt.delay" for form in free]
        bounds = np.where(late, np.hypot(bounds, ROUGH), bounds)
    values = quantities(np.asarray(done.x))
    found = [
        Learnt(form.name, form.unit, values[form.name], bound, bound <= form.certain)
        for form, bound in zip(free, bounds.tolist(), strict=True)
    ]
    return found, float(np.sqrt(np.mean(rest**2)))


def _standing(reading: Floats, period: float) -> float | None:
    """Position [V] at which the spool stands during START [s] of ``reading`` [V], n; None: it moves.

    A spool that moves has the friction of motion. If it began at rest, static friction would hold it first.
    """
    first = reading[: round(START / period)]
    first = first[np.isfinite(first)]
    seen = lvdt.observe(reading)
    most = SPREAD * max(QUIET, seen.noise) + seen.resolution
    return first_reading(reading, period) if len(first) and np.ptp(first) <= most else None


def _alike(rest: Floats, period: float) -> float:
    """Samples of residual that tell as much as one: they are alike over a while, as a model's errors are."""
    centred = rest - np.mean(rest)
    correlation = scipy.signal.correlate(centred, centred, method="fft")[len(centred) - 1 :]
    correlation = correlation[: max(2, round(LAGS / period))]
    if correlation[0] <= 0.0:
        return 1.0
    end = int(np.argmax(np.append(correlation, 0.0) < 0.05 * correlation[0]))
    return float(1.0 + 2.0 * np.sum(correlation[1:end]) / correlation[0])


def motion(command: Floats, period: float, limit: float, longest: float = 8.0) -> Floats:
    """Up to ``longest`` [s] of a recorded ``command`` [V] in which it moves most, reached from 0 V gently."""
    known = np.flatnonzero(np.isfinite(command))
    if len(known) == 0:
        raise ParameterError("the recording has no command, so there is nothing to tune on")
    filled = np.interp(np.arange(len(command)), known, command[known])
    filled = np.array([saturate(float(v), limit) for v in filled])
    length = round(longest / period)
    if len(filled) > length:
        total = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(filled, prepend=filled[0])))])
        first = int(np.argmax(total[length:] - total[:-length]))
        filled = filled[first : first + length]
    ramp = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, max(2, round(0.5 / period))))
    gentle: Floats = np.concatenate([ramp * filled[0], filled])
    return gentle
