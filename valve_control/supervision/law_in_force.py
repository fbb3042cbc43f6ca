"""Steps the law in force: its command, its voltage, gaps without readings, takeover by another law."""

import math
from collections.abc import Callable
from typing import Any

from valve_control.laws import command_lead, reshaping, velocity
from valve_control.laws.registry import LAWS
from valve_control.laws.signals import Start
from valve_control.parameter import Values, number, word
from valve_control.plant.amplifier import saturate
from valve_control.supervision import bumpless_transfer, command_course, command_watch, law_watch, trajectory
from valve_control.supervision.record import Record


def unused(voltage: float) -> None:
    """Placeholder for a receiver of the voltage, where nobody needs it before the sample ends."""


class LawInForce(Record):
    """The law in force with its command and voltage; whether readings are believable is judged elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self._form: tuple[Any, ...] = ()  # after whose change the law's state means something else
        self._limited: Any = None  # parameters of the law with the voltage of a probation
        self._give: Callable[[float], None] = unused
        self._leading: command_lead.Params | None = None
        self._joining: command_course.Params | None = None
        self._reshaping: reshaping.Params | None = None  # of a law that reshapes
        self._motion = trajectory.Motion(0.0, 0.0, 0.0)  # wanted by the trajectory at this sample

    def _use(self, values: Values, params: Any) -> None:
        """Take parameters into use; another law, or another form of it, takes over without a bump."""
        former = self._params
        name = word(values, "controller")
        self.values = values
        self._params = params
        period = number(values, "sample_period")
        reshaped = LAWS[name].reshapes(params)
        self._reshaping = getattr(params, "reshaping", None) if reshaped else None
        self._decay = bumpless_transfer.design(number(values, "transfer_time"), period)
        self._watch_law = law_watch.design(values)
        self._watch_command = command_watch.design(values)
        before, self._leading = self._leading, command_lead.build(values, reshaped)
        if before is None or self._leading is None or before.period != period:
            self._lead = None
        self._joining = command_course.design(values)
        if self._joining is None:
            self._course = None
        self.voltage = saturate(self.voltage, self._watch_law.u_max)
        self._command = command_watch.limited(self._watch_command, self._command)
        form = (name, period, *(values[key] for key in LAWS[name].form))
        estimates = getattr(params, "theta_initial", None)
        anew = form[0] == self.name and estimates != getattr(former, "theta_initial", None)
        if anew and self._state is None:
            self._former = None
        if form != self._form or anew:
            self._form = form
            self.name = name
            same_reference = self._descriptor is not None and self._descriptor.reshapes(former)
            self._descriptor = LAWS[name]
            self._law = self._descriptor.module
            self._watched = law_watch.watched(self._law.Terms._fields)
            self._terms = ()
            if self._state is not None:
                begun = self._state._replace(theta=estimates) if anew else self._state
                self._take_over(begun, same_reference and self._descriptor.reshapes(params), following=True)

    def _begin(self, reading: float) -> None:
        """Start the law: as offline if all is at rest, without a bump if spool or command are elsewhere."""
        self._measurement, self._velocity = reading, velocity.State(reading, 0.0)
        self._welcome(reading)
        wanted = 0.0 if self._command.value is None else self._command.value
        if self.values["lockstep"] or max(abs(reading), abs(wanted)) <= number(self.values, "lvdt.tolerance"):
            start = Start(reading, self.voltage, reading, 0.0, 0.0)
            self._state = self._law.initial(self._params, start)
        else:
            self._take_over(None)

    def _welcome(self, reading: float) -> None:
        """Let the law hold the valve at ``reading`` [V] until a command comes."""
        self._clear("lvdt_missing")
        self._command = command_watch.welcomed(self._watch_command, self._command, reading, self._now)
        if self._command.homing is not None:
            self._report("command_silent", command_watch.SILENT)
        if self._command.value is None:
            self._report("command_missing", "no command yet")

    def _step_over(self, gap: int, reading: float, tachometer: velocity.Params) -> bool:
        """Step the law over ``gap`` samples without a reading, on a straight line to ``reading`` [V].

        False if it left the finite numbers.
        """
        slope = (reading - self._measurement) / (gap + 1)
        newest, used = self._command.value, self._used
        period = self._decay.period
        finite = True
        for i in range(1, gap + 1):
            between = self._measurement + i * slope
            now = self._now - (gap + 1 - i) * period
            if self._course is not None or self._trajectory is not None:
                self._follow(now)
            elif newest is not None and used is not None and self._command.homing is None:
                self._command = self._command._replace(value=used + i * (newest - used) / (gap + 1))
            self._velocity = velocity.step(tachometer, self._velocity, between)
            self._take_in(now)
            try:
                self._state = self._law.hold(self._params, self._state, self._target(), between, self.voltage)
            except (ArithmeticError, ValueError):
                finite = False
                break
            self._transfer = bumpless_transfer.step(self._decay, self._transfer)
        self._command = self._command._replace(value=newest)
        return finite

    def _control(self, reading: float) -> bool:
        """Compute one step of the law and hand out its voltage; False, and none, if it is not finite."""
        law, params = self._law, self._params if self._trust.doubt.times == 0.0 else self._limited
        self._follow(self._now)
        self._take_in(self._now)
        command = self._effective = self._target()
        self._used = self._command.value
        try:
            if self._transfer.taking_over:
                _, _, terms = law.step(params, self._state, command, reading, 0.0)
                self._transfer = bumpless_transfer.begun(
                    self._transfer, self.voltage - terms.unsaturated_voltage
                )
            voltage, state, terms = law.step(
                params, self._state, command, reading, self._transfer.voltage.value
            )
            finite = math.isfinite(voltage + sum(terms))
        except (ArithmeticError, ValueError):
            return False
        if finite:
            self.voltage = voltage
            self._hand_out(voltage)
            self._state = state
            self._terms = terms
            self._watch(terms, voltage)
            if self._transfer is not bumpless_transfer.NOTHING:
                self._transfer = bumpless_transfer.step(self._decay, self._transfer)
        return finite

    def _hand_out(self, voltage: float) -> None:
        give, self._give = self._give, unused
        give(voltage)

    def _watch(self, terms: Any, voltage: float) -> None:
        self._saturated_for, self._cycle, said = law_watch.step(
            self._watch_law, self._saturated_for, self._cycle, self._said, self._now, voltage, self._effective
        )
        if said is not self._said:
            self._tell(said)
        if abs(voltage) >= self._watch_law.u_max:
            self.counts["saturated"] += 1
        if self._watched is not None:
            at, text = self._watched
            if terms[at] > terms[at + 1]:
                self.counts["assumption_violations"] += 1
                self._latch("assumptions", text)

    def _follow(self, now: float) -> None:
        """The command in force is that of trajectory or course at ``now`` [s], if there is one."""
        if self._trajectory is not None:
            self._motion = trajectory.motion(self._trajectory, now, self._watch_command.limit)
            self._command = self._command._replace(value=self._motion.position)
        elif self._course is not None and self._joining is not None:
            value = saturate(command_course.value(self._course, now), self._joining.limit)
            self._command = self._command._replace(value=value)

    def _take_in(self, now: float) -> None:
        """The command of the sample at ``now`` [s], from which its lead follows."""
        value = self._command.value
        if self._trajectory is not None:
            self._lead = None
        elif self._leading is not None and value is not None:
            before = command_lead.initial(value) if self._lead is None else self._lead
            if self._course is None:
                self._lead = command_lead.step(self._leading, before, value)
            else:
                rate = command_course.rate(self._course, now)
                self._lead = command_lead.known(self._leading, before, value, rate, 0.0)

    def _target(self) -> float:
        """Command [V] of this sample, with its lead or its derivatives, and with its offset."""
        before = self._command
        command, self._command, offset = command_watch.step(
            self._watch_command, before, self._transfer.command, self._now
        )
        if self._command is not before:  # the way back to neutral has begun or ended
            if self._command.homing is not None:
                self._report("command_silent", command_watch.SILENT)
            else:
                self._transfer = self._transfer._replace(command=offset)
                self._clear("command_silent")
        value = self._command.value
        if value is None or self._command.homing is not None:
            return command
        if self._trajectory is not None and self._reshaping is not None:
            return reshaping.command_of(self._reshaping, *self._motion) + self._transfer.command.value
        if self._leading is None or self._lead is None:
            return command
        return command_lead.led(self._leading, self._lead, value) + self._transfer.command.value

    def _take_over(self, former: Any, same_reference: bool = False, following: bool = False) -> None:
        """Start the law where the spool is: reading, voltage, motion, reference and estimates.

        ``following``: the spool has been following the command until now.
        """
        assert self._descriptor is not None, "apply comes first"
        self._follow(self._now)
        y, v = self._measurement, self._velocity.velocity
        start = Start(y, self.voltage, y, v, v)
        base = self._target()  # which may end a way home and begin an offset
        base -= self._transfer.command.value
        self._state, self._transfer = bumpless_transfer.taken_over(
            self._descriptor, self._params, former, self._transfer, start, base, same_reference, following
        )
