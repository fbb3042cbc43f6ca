"""One valve under supervision: a law fed with what is believable, its voltage switched off when it must be.

Three modes:

ok        the law has the valve;
degraded  the law has the valve, but something is reported: a silent or refused command, bridged readings,
          long saturation, a broken assumption, a second publisher;
safe      0 V, the spring centres the spool: the LVDT cannot be believed, or the law left the finite numbers.

Time is counted in samples, so that a run is repeatable; only the silence of the LVDT, during which no sample
comes, has to be told from outside (``silence``).
"""

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

from valve_control.laws import reshaping, velocity
from valve_control.laws.projection import Theta, clip
from valve_control.laws.signals import Start, saturate
from valve_control.parameters import build
from valve_control.parameters.table import CONTROLLER, Values
from valve_control.simulation.closed_loop import LAWS
from valve_control.simulation.scenarios import stroke
from valve_control.supervision import fade, lvdt

TACHOMETER_CUTOFF = 50.0  # Hz, of the velocity with which a law takes over
LATCH = 1.0  # s for which a passing event stays reported
REST = 10.0  # V/s; a spool that moves faster has not yet come to rest ...
REST_LIMIT = 0.5  # s  ... but a noisy reading must not keep the valve off for ever
HEAD = ("sample", "mode", "command", "measurement", "voltage", "offset")
# Parameters after whose change a law's state means something else, so that it takes over from itself.
FORMS = {
    "oarc": ("oarc.k1", "oarc.k2"),
    "pid": ("pid.form",),
    "compensator": tuple(p.name for p in CONTROLLER if p.name.startswith("compensator.")),
}


class Mode(IntEnum):
    """Who has the valve."""

    OK = 0
    DEGRADED = 1
    SAFE = 2


def reshapes(params: Any) -> bool:
    """Whether the law of ``params`` follows a reshaped reference; the plain PID only carries the command."""
    return "reshaping" in params._fields and getattr(params, "plain", 0.0) == 0.0


def unused(voltage: float) -> None:
    """The voltage is not given before the sample ends."""


class Homing(NamedTuple):
    """The way back to neutral."""

    origin: float  # V  where it began
    began: float  # s
    rate: float  # V/s
    accel: float  # V/s²


class Supervisor:
    """Controller of one valve: readings and commands in, voltages out, and what to say about them."""

    def __init__(self) -> None:
        self.name = ""
        self.voltage = 0.0  # V
        self.samples = 0
        self.changed = False  # set with each change of the reported conditions, cleared by the reader
        self.counts = dict.fromkeys(
            (
                "lvdt_lost",
                "lvdt_refused",
                "command_refused",
                "command_limited",
                "saturated",
                "assumption_violations",
                "law_not_finite",
                "safe_stops",
            ),
            0,
        )
        self.conditions: dict[str, str] = {}
        self._expiry: dict[str, float] = {}
        self._blocked = ""  # name of the condition that switched the voltage off
        self._form: tuple[Any, ...] = ()
        self._law: Any = None
        self._params: Any = None
        self.values: Values = {}  # in use
        self._monitor: lvdt.Monitor | None = None
        self._give: Callable[[float], None] = unused
        self._kept: tuple[str, tuple[float, ...] | None] = ("", None)  # law and its estimates before start
        self._state: Any = None
        self._former: Any = None
        self.start()

    # Life

    def start(self) -> None:
        """Begin at rest with 0 V, as after switching on; parameters and counters stay."""
        if self.theta is not None:
            self._kept = (self.name, self.theta)
        self.voltage = 0.0
        self._state = None
        self._former = None
        self._terms: tuple[float, ...] = ()
        self._now = 0.0  # s
        self._sequence: int | None = None
        self._measurement = math.nan
        self._start_position = 0.0
        self._bridged = 0
        self._sound = 0
        self._saturated_for = 0.0  # s
        self._command: float | None = None
        self._command_time = 0.0
        self._gone_since: float | None = None  # s, when the upper level left
        self._used: float | None = None  # V, the command at the sample before
        self._homing: Homing | None = None  # once begun, only a new command ends it
        self._renewed = False  # whether one has come since
        self._effective = math.nan
        self._offset = fade.NOTHING  # on the voltage; both fade after a takeover
        self._command_offset = fade.NOTHING  # on the command
        self._taking_over = False
        self._velocity = velocity.State(0.0, 0.0)
        self._blocked = ""
        self.conditions.clear()
        self._expiry.clear()
        self._report("lvdt_missing", "no LVDT reading yet")
        if self._monitor is not None:
            self._monitor.forget()

    def apply(self, values: Values, params: Any) -> None:
        """Take checked ``values`` and the law's ``params`` built from them into use, between two samples."""
        former = self._params
        name = build.word(values, "controller")
        self.values = values
        self._params = params
        self._period = build.number(values, "sample_period")
        self._u_max = build.number(values, "u_max")
        self._command_limit = build.number(values, "command_limit")
        self._command_timeout = build.number(values, "command_timeout")
        self._saturation_limit = build.number(values, "saturation_limit")
        self._hold_samples = int(build.number(values, "lvdt.hold_samples"))
        self._recovery_samples = int(build.number(values, "lvdt.recovery_samples"))
        self._tachometer = velocity.design(TACHOMETER_CUTOFF, self._period)
        self._fade = fade.design(build.number(values, "transfer_time"), self._period)
        self._neutral_rate = build.number(values, "neutral_rate")
        self._neutral_accel = build.number(values, "neutral_accel")
        watched = lvdt.Params(
            build.number(values, "lvdt.limit"),
            build.number(values, "lvdt.max_rate"),
            build.number(values, "lvdt.tolerance"),
            int(build.number(values, "lvdt.frozen_samples")),
            build.number(values, "lvdt.frozen_voltage"),
            self._period,
        )
        if self._monitor is None:
            self._monitor = lvdt.Monitor(watched)
        self._monitor.params = watched
        self.voltage = saturate(self.voltage, self._u_max)
        if self._command is not None:
            self._command = saturate(self._command, self._command_limit)
        form = (name, self._period, *(values[key] for key in FORMS.get(name, ())))
        estimates = getattr(params, "theta_initial", None)
        anew = form[0] == self.name and estimates != getattr(former, "theta_initial", None)
        if anew and self._state is None:
            self._former = None
        if form != self._form or anew:
            self._form = form
            self.name = name
            self._law = LAWS[name]
            self._terms = ()
            if self._state is not None:
                begun = self._state._replace(theta=estimates) if anew else self._state
                self._take_over(begun, reshapes(former) and reshapes(params), following=True)

    def reset(self) -> None:
        """Estimates and filters to their start, without a bump; what is believed of the LVDT stays."""
        self._former = None
        self._kept = ("", None)
        if self._state is not None:
            self._take_over(None, following=True)

    @property
    def command_in_force(self) -> float | None:
        """The command [V], None before the first."""
        return self._command

    @property
    def measurement(self) -> float:
        """The last believable reading [V], NaN before the first."""
        return self._measurement

    @property
    def command_left(self) -> bool:
        """Whether the upper level has left, and no command has come since."""
        return self._gone_since is not None

    def monitor_memory(self) -> dict[str, Any]:
        """What the watch over the LVDT remembers."""
        return (
            {} if self._monitor is None else {k: v for k, v in vars(self._monitor).items() if k != "params"}
        )

    def recall_monitor(self, memory: dict[str, Any]) -> None:
        """Give the watch over the LVDT its memory back."""
        if self._monitor is not None:
            vars(self._monitor).update(memory)

    # Inputs

    def command(self, value: float) -> None:
        """Take in a command [V] from the upper level."""
        self._gone_since = None
        if not math.isfinite(value):
            self.counts["command_refused"] += 1
            self._latch("command_refused", f"command {value} refused, the last one holds")
            return
        self._command_time = self._now + self._period  # it acts at the next sample
        self._renewed = True
        self._command = saturate(value, self._command_limit)
        self._clear("command_missing")
        if self._command != value:
            self.counts["command_limited"] += 1
            self._latch("command_limited", f"command {value:g} V limited to {self._command:g} V")

    def command_gone(self) -> None:
        """The upper level has left: its command counts as silent at once."""
        if self._gone_since is None:
            self._gone_since = self._now

    def observe(self, name: str, text: str) -> None:
        """Report ``text`` under ``name``, something seen from outside; "" ends it."""
        if text != self.conditions.get(name, ""):
            self._clear(name)
            if text:
                self._report(name, text)

    def silence(self, elapsed: float, stalled: bool = False) -> float:
        """No reading was answered for too long; returns the voltage [V].

        ``elapsed`` [s]: since the last reading or the last call; ``stalled``: readings have come, but this
        process stood still.
        """
        self._now += elapsed
        self._sound = 0
        if not self._blocked and self._state is not None:
            limit = f"for more than {self._hold_samples} samples"
            if stalled:
                self._switch_off("stalled", f"the controller's process stood still {limit}")
            else:
                self._switch_off("lvdt_silent", f"{lvdt.TEXTS['silent']} {limit}")
        return self.voltage

    def sample(
        self,
        reading: float,
        sequence: int | None = None,
        elapsed: float = 0.0,
        give: Callable[[float], None] = unused,
    ) -> float:
        """One LVDT reading [V]; returns the voltage [V] to apply until the next one.

        ``sequence``: number of the reading, from which lost ones are known; ``elapsed`` [s]: real time since
        the one before, if it is known: the spool may have moved that long. ``give`` gets the voltage too,
        once, as soon as it is certain: before what only the next sample needs. It must not raise.
        """
        self._give = give
        voltage = self._judged(reading, sequence, elapsed)
        self._say(voltage)
        return voltage

    def _say(self, voltage: float) -> None:
        give, self._give = self._give, unused
        give(voltage)

    def _judged(self, reading: float, sequence: int | None, elapsed: float) -> float:
        assert self._monitor is not None, "apply comes first"
        missed = self._count_missed(sequence)
        self.samples += 1
        # A longer gap is a silence, whose time is told there.
        self._now += (1 + min(missed, self._hold_samples)) * self._period
        if self._expiry:
            self._expire()
        fault = self._monitor.judge(reading, missed, self.voltage, bool(self._blocked), elapsed)
        if fault:
            self.counts["lvdt_refused"] += 1
            self._bridged += 1 + missed
            self._sound = 0
            if not self._blocked and (fault == "frozen" or self._bridged > self._hold_samples):
                self._switch_off(f"lvdt_{fault}", lvdt.TEXTS[fault])
            elif not self._blocked:
                self._latch(f"lvdt_{fault}_bridged", f"{lvdt.TEXTS[fault]}: bridged")
            return self.voltage
        gap, self._bridged = missed + self._bridged, 0
        if gap and not self._blocked and self._state is not None:
            if gap > self._hold_samples:
                self._switch_off("lvdt_silent", f"{gap} LVDT readings lost in a row")
            else:
                self._latch("lvdt_bridged", "LVDT readings lost: bridged")
                self._step_over(gap, reading)
        if self._blocked:
            if gap:
                self._sound = 0
            if not self._recovered(reading):
                return self.voltage
        self._measurement = reading
        if self._state is None:
            self._begin(reading)
        return self._control(reading)

    # Outputs

    @property
    def mode(self) -> Mode:
        """Present mode."""
        if self._blocked or "lvdt_missing" in self.conditions:
            return Mode.SAFE
        return Mode.DEGRADED if self.conditions else Mode.OK

    @property
    def reason(self) -> str:
        """All that is reported, in one line."""
        return "; ".join(self.conditions.values()) or "controlling"

    @property
    def theta(self) -> tuple[float, ...] | None:
        """Present estimates, of a law that adapts."""
        state = self._state if self._state is not None else self._former
        if state is None or "theta" not in state._fields or "theta_min" not in self._params._fields:
            return None
        return tuple(map(clip, state.theta, self._params.theta_min, self._params.theta_max))

    @property
    def bridged(self) -> int:
        """Readings in a row that could not be believed and are bridged now."""
        return 0 if self._blocked else self._bridged

    @property
    def begun(self) -> bool:
        """Whether a believable reading has come since the start."""
        return "lvdt_missing" not in self.conditions

    @property
    def lyapunov(self) -> tuple[float, float] | None:
        """V2 and its guaranteed bound at the last sample, of a law that has them."""
        fields = self._law.Terms._fields
        if "lyapunov" not in fields or not self._terms:
            return None
        i = fields.index("lyapunov")
        return self._terms[i], self._terms[i + 1]

    def labels(self) -> tuple[str, ...]:
        """Names of the numbers of ``telemetry``."""
        return (*HEAD, *self._law.Terms._fields)

    def telemetry(self) -> list[float]:
        """Numbers of this sample; the law's terms are NaN while it does not have the valve."""
        terms = self._terms or (math.nan,) * len(self._law.Terms._fields)
        return [
            float(self.samples),
            float(self.mode),
            self._effective,
            self._measurement,
            self.voltage,
            self._offset.value,
            *terms,
        ]

    def present_values(self) -> Values:
        """The parameters in use, with the present estimates as the initial ones of the running law."""
        values = dict(self.values)
        theta = self.theta or (self._kept[1] if self._kept[0] == self.name else None)
        if theta is not None:
            values[f"{self.name}.theta_initial"] = list(theta)
        return values

    # The way from reading to voltage

    def _count_missed(self, sequence: int | None) -> int:
        last, self._sequence = self._sequence, sequence
        if sequence is None or last is None or sequence <= last or "lvdt_publishers" in self.conditions:
            return 0
        missed = sequence - last - 1
        self.counts["lvdt_lost"] += missed
        return missed

    def _begin(self, reading: float) -> None:
        """Begin plainly from rest, as offline; without a bump where spool or command are elsewhere."""
        self._velocity = velocity.State(reading, 0.0)
        self._welcome(reading)
        wanted = 0.0 if self._command is None else self._command
        if self.values["lockstep"] or max(abs(reading), abs(wanted)) <= build.number(
            self.values, "lvdt.tolerance"
        ):
            start = Start(reading, self.voltage, reading, 0.0, 0.0)
            self._state = self._law.initial(self._params, start)
        else:
            self._take_over(None)

    def _welcome(self, reading: float) -> None:
        """The law has the valve from ``reading`` [V] on; there it stays until a command comes."""
        self._clear("lvdt_missing")
        if self._command is not None and (self._homing is not None or self._silent_since() is not None):
            # The spool is not where the old command was.
            self._go_home(reading, self._now)
        if self._command is None:
            self._start_position = reading
            self._report("command_missing", "no command yet")

    def _step_over(self, gap: int, reading: float) -> None:
        """Bring the law over ``gap`` samples without a reading, on a straight line to the next one."""
        slope = (reading - self._measurement) / (gap + 1)
        newest = self._command
        for i in range(1, gap + 1):
            between = self._measurement + i * slope
            if newest is not None and self._used is not None and self._homing is None:
                self._command = self._used + i * (newest - self._used) / (gap + 1)
            self._velocity = velocity.step(self._tachometer, self._velocity, between)
            try:
                self._state = self._law.hold(self._params, self._state, self._target(), between, self.voltage)
            except (ArithmeticError, ValueError):
                self._leave_the_finite()
                break
            self._let_fade()
        self._command = newest

    def _control(self, reading: float) -> float:
        law, params = self._law, self._params
        command = self._target()
        self._effective = command
        self._used = self._command
        try:
            if self._taking_over:
                _, _, terms = law.step(params, self._state, command, reading, 0.0)
                self._offset = fade.State(self.voltage - terms.unsaturated_voltage, 0.0)
                self._taking_over = False
            voltage, state, terms = law.step(params, self._state, command, reading, self._offset.value)
            finite = math.isfinite(voltage + sum(terms))
        except (ArithmeticError, ValueError):
            finite = False
        if finite:
            self.voltage = voltage
            self._say(voltage)
            self._state = state
            self._terms = terms
            self._watch(terms, voltage)
            self._let_fade()
        else:
            self._leave_the_finite()
        self._velocity = velocity.step(self._tachometer, self._velocity, reading)
        return self.voltage

    def _leave_the_finite(self) -> None:
        self.counts["law_not_finite"] += 1
        self._switch_off("law_not_finite", f"{self.name} left the finite numbers")
        self._former = None

    def _let_fade(self) -> None:
        self._offset = fade.step(self._fade, self._offset)
        self._command_offset = fade.step(self._fade, self._command_offset)

    def _watch(self, terms: Any, voltage: float) -> None:
        if abs(voltage) >= self._u_max:
            self.counts["saturated"] += 1
            self._saturated_for = min(self._saturated_for + self._period, 2.0 * self._saturation_limit)
            if self._saturated_for > self._saturation_limit:
                self._report("saturation", f"saturated for more than {self._saturation_limit:g} s")
        elif self._saturated_for > 0.0:
            # Noise lifts single samples off the limit: time without saturation counts against time with it.
            self._saturated_for = max(0.0, self._saturated_for - self._period)
            if self._saturated_for == 0.0:
                self._clear("saturation")
        if "lyapunov_bound" in terms._fields and terms.lyapunov > terms.lyapunov_bound:
            self.counts["assumption_violations"] += 1
            self._latch(
                "assumptions",
                "V2 is above its guaranteed bound: the valve has left the assumed parameter ranges or "
                "disturbance bound",
            )

    def _target(self) -> float:
        """Command [V] of this sample: the upper level's, the way back to neutral, or where we started."""
        offset = self._command_offset.value
        if self._command is None:
            return self._start_position + offset
        since = self._silent_since()
        if self._homing is None and since is not None:
            self._go_home(self._command, since)
        if self._homing is not None and (since is not None or not self._renewed):
            return self._home(self._homing) + offset
        if self._homing is not None:
            here, before = self._home(self._homing), self._home(self._homing, self._period)
            self._command_offset = fade.State(
                offset + here - self._command, self._command_offset.rate + (here - before) / self._period
            )
            offset = self._command_offset.value
            self._homing = None
            self._clear("command_silent")
        return self._command + offset

    def _go_home(self, origin: float, since: float) -> None:
        self._homing = Homing(origin, since, self._neutral_rate, self._neutral_accel)
        self._renewed = False
        self._report("command_silent", "command is silent, the spool returns to neutral")

    def _silent_since(self) -> float | None:
        """Since when [s] the command counts as silent, None if it does not."""
        if self._command_timeout == 0.0:
            return None
        if self._gone_since is not None:
            return self._gone_since
        end = self._command_time + self._command_timeout
        return end if self._now > end else None

    def _home(self, homing: Homing, ago: float = 0.0) -> float:
        """Command [V] on the way to neutral, ``ago`` [s] before now."""
        time = self._now - homing.began - ago
        return homing.origin + stroke(time, -homing.origin, homing.rate, homing.accel)

    # Off and on again

    def _switch_off(self, name: str, text: str) -> None:
        self._blocked = name
        self._report(name, text)
        self.counts["safe_stops"] += 1
        self.voltage = 0.0
        self._former, self._state = self._state, None
        self._terms = ()
        self._offset = self._command_offset = fade.NOTHING
        self._taking_over = False
        self._saturated_for = 0.0
        self._clear("saturation")
        self._sound = 0

    def _recovered(self, reading: float) -> bool:
        """Whether enough sound readings have come and the spool is at rest; the law is then back in force."""
        sound, self._sound = self._sound, self._sound + 1
        if sound == 0:
            self._velocity = velocity.State(reading, 0.0)
            self._measurement = reading
        resting = abs(self._velocity.velocity) <= REST or sound * self._period >= REST_LIMIT
        if self._sound < self._recovery_samples or not resting:
            self._velocity = velocity.step(self._tachometer, self._velocity, reading)
            self._measurement = reading
            return False
        self._clear(self._blocked)
        self._blocked = ""
        self._welcome(reading)
        # From the reading before: the law takes in the present one in its first step.
        self._take_over(self._former)
        return True

    def _take_over(self, former: Any, same_reference: bool = False, following: bool = False) -> None:
        """Begin with the law where the spool is: reading, voltage, motion, reference and estimates.

        ``following``: the spool has been following the command until now.
        """
        params = self._params
        y, v = self._measurement, self._velocity.velocity
        start = Start(y, self.voltage, y, v, v)
        base = self._target()  # which may end a way home and begin a fade
        base -= self._command_offset.value
        if same_reference:
            reference, rate = former.reference
            start = start._replace(reference=reference, reference_rate=rate)
        else:
            # A spool that follows has the rate of the command; one from elsewhere has to lose its own.
            rate = 0.0 if following else v
            self._command_offset = fade.State(self._steady_command(start) - base, rate)
        if former is not None and "theta" in former._fields and "theta" in self._law.State._fields:
            theta = Theta(*map(clip, former.theta, params.theta_min, params.theta_max))
            params = params._replace(theta_initial=theta)
        self._state = self._law.initial(params, start)
        self._taking_over = True

    def _steady_command(self, start: Start) -> float:
        """Command under which the law would go on as at ``start``; the real one is faded in from there."""
        if "static_gain" in self._params._fields:
            return start.voltage / float(self._params.static_gain)
        if getattr(self._params, "plain", 0.0) > 0.0:
            return start.measurement
        return reshaping.steady_command(self._params.reshaping, start.measurement, start.velocity)

    # What is reported

    def _report(self, name: str, text: str) -> None:
        if name not in self.conditions:
            self.changed = True
            self.conditions[name] = text

    def _clear(self, name: str) -> None:
        if self.conditions.pop(name, None) is not None:
            self._expiry.pop(name, None)
            self.changed = True

    def _latch(self, name: str, text: str) -> None:
        self._report(name, text)
        self._expiry[name] = self._now + LATCH

    def _expire(self) -> None:
        for name in [name for name, time in self._expiry.items() if self._now > time]:
            self._clear(name)
