"""One law under the supervisor's watch over LVDT and command, as pure steps that can be exported to C.

What supervisor.py does with one law of fixed parameters, without what only a node has: other laws,
trajectories and commands that are joined, the period of the readings, and the reports. ``sample`` gives the
voltages and states of the supervisor to the last bit (test/supervision/test_watch.py): the parts are the
same functions. ``bound`` puts the functions of a law in the places that are kept for them.
"""

import collections
import math
import sys
import types
from typing import Any, NamedTuple, get_type_hints

from valve_control.laws import command_lead, velocity
from valve_control.laws.law import Law
from valve_control.laws.projection import Theta, clip
from valve_control.laws.registry import LAWS
from valve_control.laws.signals import Start
from valve_control.parameter import ParameterError, Values, number, word
from valve_control.supervision import (
    bumpless_transfer,
    command_watch,
    conditions,
    lvdt,
    lvdt_watch,
    plausibility,
)

NEVER = -1.0  # s


class Params(NamedTuple):
    """A law and what is expected of its inputs."""

    law: Any  # of the law
    command: command_watch.Params
    lvdt: lvdt_watch.Params
    lead: command_lead.Params | None  # of the command
    transfer: bumpless_transfer.Params
    probation: float  # V  limit of the voltage while readings are doubted
    lockstep: bool  # whether the law starts as offline, wherever spool and command are


class State(NamedTuple):
    """All that is remembered between two samples."""

    now: float  # s  since init
    voltage: float  # V
    judged: lvdt.State  # the readings one by one
    trust: lvdt_watch.State  # in the LVDT
    measurement: float  # V  last believable reading
    velocity: velocity.State
    evidence: plausibility.State | None  # whether readings answer the voltage
    command: command_watch.State
    used: float | None  # V  the command at the sample before, without offset
    transfer: bumpless_transfer.State
    lead: command_lead.State | None
    law: Any  # state of the law, none while it does not have the valve
    former: Any  # state of the law when it had the valve last, none if that is of no use
    jumped_until: float  # s  until when a jump that was bridged counts, -1: there is none


def law_initial(p: Any, start: Start) -> Any:
    """Place of the law's ``initial``."""
    raise NotImplementedError


def law_step(p: Any, s: Any, command: float, measurement: float, offset: float) -> Any:
    """Place of the law's ``step``."""
    raise NotImplementedError


def law_hold(p: Any, s: Any, command: float, measurement: float, voltage: float) -> Any:
    """Place of the law's ``hold``."""
    raise NotImplementedError


def law_steady_command(p: Any, start: Start) -> float:
    """Place of the law's ``steady_command``."""
    raise NotImplementedError


def law_resumed(p: Any, former: Any) -> Any:
    """Place of ``as_designed`` or ``with_estimates``."""
    raise NotImplementedError


def as_designed(p: Any, former: Any) -> Any:
    """Parameters with which a law without estimates starts again."""
    return p


def with_estimates(p: Any, former: Any) -> Any:
    """Parameters with which a law starts again from the estimates that it had."""
    return p._replace(theta_initial=Theta(*map(clip, former.theta, p.theta_min, p.theta_max)))


def design(values: Values, law: Any) -> Params:
    """Params from the controller's values and the Params of its ``law``. Raises ParameterError."""
    if values["command.interpolation"] != "hold":
        raise ParameterError(
            "the watch takes one command a sample and joins none; set command.interpolation to hold"
        )
    period = number(values, "sample_period")
    return Params(
        law,
        command_watch.design(values),
        lvdt_watch.design(values, law),
        command_lead.build(values, LAWS[word(values, "controller")].reshapes(law)),
        bumpless_transfer.design(number(values, "transfer_time"), period),
        lvdt_watch.PROBATION * number(values, "lvdt.disturbance"),
        bool(values["lockstep"]),
    )


def at_rest() -> State:
    """State after switching on: 0 V, no reading and no command yet."""
    return State(
        0.0,
        0.0,
        lvdt.NOTHING,
        lvdt_watch.NOTHING,
        0.0,
        velocity.State(0.0, 0.0),
        None,
        command_watch.NOTHING,
        None,
        bumpless_transfer.NOTHING,
        None,
        None,
        None,
        NEVER,
    )


def commanded(p: Params, s: State, value: float) -> State:
    """State after a command ``value`` [V], which is limited, or refused if it is not finite."""
    return s._replace(command=command_watch.taken(p.command, s.command, value, s.now))


def left(s: State) -> State:
    """State after the upper level has left: its command counts as silent at once."""
    return s._replace(command=command_watch.left(s.command, s.now))


def silent(p: Params, s: State, elapsed: float) -> State:
    """State after a time ``elapsed`` [s] since the last reading that is too long to be bridged: 0 V."""
    s = s._replace(now=s.now + elapsed, trust=s.trust._replace(sound=0))
    if s.trust.blocked != "" or s.law is None:
        return s
    return _switched_off(p, s, "lvdt_silent", _leapt(s))


def reset(p: Params, s: State) -> State:
    """State with estimates and filters at their start, without a bump; doubts about the LVDT are dropped."""
    s = s._replace(trust=s.trust._replace(doubt=plausibility.TRUST), former=None)
    return s if s.law is None else _taken_over(p, s, False, True)


def sample(p: Params, s: State, reading: float, lost: int) -> tuple[float, State]:
    """Voltage [V] until the next reading, after this one [V], before which ``lost`` ones did not come.

    A reading that is not finite counts as one that cannot be believed: it is bridged like one.
    """
    s = s._replace(now=s.now + (1 + min(lost, p.lvdt.hold_samples)) * p.lvdt.period)
    if s.now > s.jumped_until:
        s = s._replace(jumped_until=NEVER)
    blocked = s.trust.blocked != ""
    fault, judged = lvdt.step(p.lvdt.judge, s.judged, reading, lost, s.voltage, blocked, 0.0)
    s = s._replace(judged=judged)
    if fault != lvdt.SOUND:
        s = _refused(p, s, fault, lost)
        return s.voltage, s
    gap = lost + s.trust.bridged
    if gap > 0:
        s = _bridged(p, s, gap, reading)
    applied = s.voltage
    if s.trust.blocked != "":
        s = _recovered(p, s, reading, gap > 0)
        if s.trust.blocked != "":
            evidence = lvdt_watch.weighed(p.lvdt.comparison, s.evidence, reading, applied, 1 + gap)
            return applied, s._replace(evidence=evidence)
    if s.law is None:
        s = _begun(p, s, reading)
    s = _controlled(p, s, reading)
    voltage = s.voltage
    s = s._replace(
        measurement=reading,
        velocity=velocity.step(p.lvdt.tachometer, s.velocity, reading),
        evidence=lvdt_watch.weighed(p.lvdt.comparison, s.evidence, reading, applied, 1 + gap),
    )
    return voltage, _confronted(p, s)


def _leapt(s: State) -> bool:
    """Whether readings that are being bridged leapt: after a gap they would be taken for motion."""
    return s.trust.bridged > 0 and s.jumped_until >= 0.0


def _named(fault: str) -> str:
    """Name of the condition of a reading's ``fault``."""
    if fault == "not_finite":
        return "lvdt_not_finite"
    if fault == "out_of_range":
        return "lvdt_out_of_range"
    if fault == "jump":
        return "lvdt_jump"
    return "lvdt_frozen"


def _refused(p: Params, s: State, fault: str, lost: int) -> State:
    """State after a reading that cannot be believed: bridged, or off if there have been too many."""
    s = s._replace(trust=lvdt_watch.refused(s.trust, lost))
    if s.trust.blocked != "":
        return s
    if fault == "frozen" or s.trust.bridged > p.lvdt.hold_samples:
        return _switched_off(p, s, _named(fault), False)
    if fault == "jump":
        return s._replace(jumped_until=s.now + conditions.LATCH)
    return s


def _bridged(p: Params, s: State, gap: int, reading: float) -> State:
    """State with the law stepped over ``gap`` samples before a sound reading, or off."""
    leapt = _leapt(s)
    s = s._replace(trust=s.trust._replace(bridged=0))
    if s.trust.blocked != "" or s.law is None:
        return s
    if gap > p.lvdt.hold_samples:
        return _switched_off(p, s, "lvdt_silent", leapt)
    slope = (reading - s.measurement) / (gap + 1)
    newest, used = s.command.value, s.used
    for i in range(1, gap + 1):
        between = s.measurement + i * slope
        if newest is not None and used is not None and s.command.homing is None:
            s = s._replace(command=s.command._replace(value=used + i * (newest - used) / (gap + 1)))
        s = _taken_in(p, s._replace(velocity=velocity.step(p.lvdt.tachometer, s.velocity, between)))
        command, s = _target(p, s)
        s = s._replace(
            law=law_hold(p.law, s.law, command, between, s.voltage), transfer=_decayed(p, s.transfer)
        )
    return s._replace(command=s.command._replace(value=newest))


def _decayed(p: Params, s: bumpless_transfer.State) -> bumpless_transfer.State:
    """Both offsets one period later."""
    return s._replace(
        voltage=bumpless_transfer.decayed(p.transfer, s.voltage),
        command=bumpless_transfer.decayed(p.transfer, s.command),
    )


def _confronted(p: Params, s: State) -> State:
    """State after a block of readings has been compared with the voltage."""
    if p.lvdt.comparison is None or s.evidence is None or s.trust.blocked != "":
        return s
    if s.evidence.held != 0.0:
        return s
    found, doubt = plausibility.verdict(p.lvdt.comparison, s.evidence, s.trust.doubt)
    if found != "":
        return _switched_off(p, s, "lvdt_disagrees", False)
    return s._replace(trust=s.trust._replace(doubt=doubt))


def _switched_off(p: Params, s: State, name: str, leapt: bool) -> State:
    """State with 0 V because of ``name``."""
    return s._replace(
        trust=lvdt_watch.switched_off(p.lvdt, s.trust, s.evidence, name, s.now, True, leapt),
        voltage=0.0,
        former=s.law,
        law=None,
        transfer=bumpless_transfer.NOTHING,
        lead=None,
    )


def _recovered(p: Params, s: State, reading: float, anew: bool) -> State:
    """State after a sound reading while the voltage is off; the law is back in force after enough of them."""
    before = lvdt_watch.Motion(s.measurement, s.velocity, s.evidence)
    trust, motion = lvdt_watch.recovered(p.lvdt, s.trust, before, reading, anew, s.now)
    s = s._replace(
        trust=trust, measurement=motion.measurement, velocity=motion.velocity, evidence=motion.evidence
    )
    if trust.blocked != "":
        return s
    s = s._replace(command=command_watch.welcomed(p.command, s.command, reading, s.now))
    return _taken_over(p, s, s.former is not None, False)


def _begun(p: Params, s: State, reading: float) -> State:
    """State at the first believable reading: as offline at rest, else without a bump."""
    s = s._replace(
        measurement=reading,
        velocity=velocity.State(reading, 0.0),
        command=command_watch.welcomed(p.command, s.command, reading, s.now),
    )
    wanted = 0.0 if s.command.value is None else s.command.value
    if p.lockstep or max(abs(reading), abs(wanted)) <= p.lvdt.judge.tolerance:
        return s._replace(law=law_initial(p.law, Start(reading, s.voltage, reading, 0.0, 0.0)))
    return _taken_over(p, s, False, False)


def _taken_over(p: Params, s: State, again: bool, following: bool) -> State:
    """State in which the law begins where the spool is.

    ``again``: with the estimates that it had; ``following``: the spool has been following the command.
    """
    y, v = s.measurement, s.velocity.velocity
    start = Start(y, s.voltage, y, v, v)
    base, s = _target(p, s)
    base -= s.transfer.command.value
    offset = bumpless_transfer.Offset(law_steady_command(p.law, start) - base, 0.0 if following else v)
    law = law_resumed(p.law, s.former) if again else p.law
    return s._replace(
        law=law_initial(law, start), transfer=bumpless_transfer.State(s.transfer.voltage, offset, True)
    )


def _taken_in(p: Params, s: State) -> State:
    """State with the lead of this sample's command."""
    value = s.command.value
    if p.lead is None or value is None:
        return s
    before = command_lead.initial(value) if s.lead is None else s.lead
    return s._replace(lead=command_lead.step(p.lead, before, value))


def _target(p: Params, s: State) -> tuple[float, State]:
    """Command [V] of this sample, with its lead and its offset."""
    command, following, offset = command_watch.step(p.command, s.command, s.transfer.command, s.now)
    s = s._replace(command=following, transfer=s.transfer._replace(command=offset))
    value = following.value
    if value is None or following.homing is not None or p.lead is None or s.lead is None:
        return command, s
    return command_lead.led(p.lead, s.lead, value) + offset.value, s


def _controlled(p: Params, s: State, reading: float) -> State:
    """State after one step of the law; off if it leaves the finite numbers."""
    law = p.law
    if s.trust.doubt.times != 0.0:
        law = law._replace(u_max=min(law.u_max, p.probation))
    command, s = _target(p, _taken_in(p, s))
    s = s._replace(used=s.command.value)
    if s.transfer.taking_over:
        _, _, first = law_step(law, s.law, command, reading, 0.0)
        s = s._replace(transfer=bumpless_transfer.begun(s.transfer, s.voltage - first.unsaturated_voltage))
    voltage, after, terms = law_step(law, s.law, command, reading, s.transfer.voltage.value)
    if not (math.isfinite(voltage) and all(map(math.isfinite, terms))):
        return _switched_off(p, s, "law_not_finite", False)._replace(former=None)
    return s._replace(voltage=voltage, law=after, transfer=_decayed(p, s.transfer))


def bound(law: Law) -> types.SimpleNamespace:
    """Params, State and the functions of this file for ``law``, whose functions are in their places."""
    module = law.module
    hints = get_type_hints(module.Params)
    adapts = law.adapts and "theta_initial" in hints
    params = _record(Params, {"law": module.Params})
    state = _record(State, {"law": module.State | None, "former": module.State | None})
    scope: dict[str, Any] = {
        **vars(sys.modules[__name__]),
        "Params": params,
        "State": state,
        "law_initial": module.initial,
        "law_step": module.step,
        "law_hold": module.hold,
        "law_steady_command": law.steady_command,
        "Theta": hints["theta_initial"] if adapts else Theta,
        "law_resumed": with_estimates if adapts else as_designed,
    }
    others = {Params: params, State: state, tuple[float, State]: tuple[float, state]}  # type: ignore[valid-type]
    own = {n: f for n, f in scope.items() if isinstance(f, types.FunctionType) and f.__module__ == __name__}
    for name, function in own.items():
        again = types.FunctionType(function.__code__, scope, function.__name__, function.__defaults__)
        kinds = function.__annotations__
        again.__annotations__ = {argument: others.get(kind, kind) for argument, kind in kinds.items()}
        scope[name] = again
    return types.SimpleNamespace(**scope)


def _record(template: Any, given: dict[str, Any]) -> Any:
    """The NamedTuple ``template`` with other types of some fields."""
    made: Any = collections.namedtuple(template.__name__, template._fields)  # type: ignore[misc]
    made.__annotations__ = {**get_type_hints(template), **given}
    made.__module__, made.__doc__ = template.__module__, template.__doc__
    return made
