# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the fault campaign: each fault at a random moment in motion, on each controller, over real DDS."""

import json
import math
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from research.campaigns import drivers, strangers
from research.campaigns.joiners import crowd
from research.campaigns.processes import (
    Listener,
    bar,
    node_arguments,
    parse_tool,
    process,
    run_tool,
    tool_options,
    wait_until,
)
from valve_control import outputs
from valve_control.control.laws.registry import LAWS
from valve_control.control.supervision import law_watch, rate
from valve_control.nodes.adapter import EVERYTHING, PolledSubscription

Array = npt.NDArray[np.float64]
CONTROLLERS = tuple(LAWS)
FEEDBACK = tuple(name for name, law in LAWS.items() if law.feedback)
FORWARD = tuple(name for name, law in LAWS.items() if not law.feedback)
BOUNDED = tuple(name for name, law in LAWS.items() if law_watch.bounded_term(law.term_labels))
U_MAX = 10.0  # V
PERIOD = 0.001  # s
HOLD = 20  # samples
FROZEN = 20  # samples
FROZEN_VOLTAGE = 0.5  # V
LEAST_GAIN = 1.07  # V/V  voltage over command of the compensator (13), at rest
# A reliable reader holds back what follows until the writer has forgotten the lost ones: n cost 2·n periods.
LOST = 3  # samples
COMMAND_TIMEOUT = 0.5  # s
VOLTAGE_TIMEOUT = 0.1  # s
SATURATION = 0.1  # s
AMPLITUDE = 2.0  # V
FREQUENCY = 1.5  # Hz
NEUTRAL_RATE = 20.0  # V/s
CENTRED = 0.2  # V from neutral
# What a desktop without real-time scheduling adds to every configured time.
ALLOWANCE = 0.015  # s
SETTLE = 0.3  # s for the spool to come to rest
OBSERVE = 5.0  # s of undisturbed motion; it and its beginning show the steps that command and noise give
CENTRES = "spring centres"  # what the simulator says without a voltage
BACK = 10.0  # s within which everything is in order again
STEP_FACTOR = 2.0  # on the largest step of undisturbed motion; noise makes each maximum a little different
FADE = 0.05  # V, what the fade of a takeover adds
MEET = 1.0  # s
TRIES = 3  # of a fault
PAUSE = 0.003  # s between two commands or readings that only the operating system makes
SETTLED = 0.03  # s after it
OTHER_PERIODS = {"slow": 2.0 * PERIOD, "fast": 0.8 * PERIOD}  # s, of the LVDT
LEAVERS = 10
JOINERS = 10
STORM = 3.0  # s
ANSWERED = 0.02  # s within which half of a storm's calls are answered
HARMLESS = ("transfer_time", 0.05, 0.06)

SETTINGS: dict[str, Any] = {
    "lvdt.hold_samples": HOLD,
    "lvdt.frozen_samples": FROZEN,
    "lvdt.frozen_voltage": FROZEN_VOLTAGE,
    "command_timeout": COMMAND_TIMEOUT,
    "command_limit": 3.0,
    "neutral_rate": NEUTRAL_RATE,
    "saturation_limit": SATURATION,
    "voltage_timeout": VOLTAGE_TIMEOUT,
    "state_decimation": 0,
    "realtime.lock_memory": True,
    "scenario": "sine",
    "amplitude": AMPLITUDE,
    "frequency": FREQUENCY,
    "start": 0.0,
    "duration": 3600.0,
    "trigger": "spool_position",
    # Ranges that the simulated valve just fills, so that the guaranteed bound is tight.
    "arc.theta_min": [15.0, 1000.0, 1100.0, -1000.0],
    "arc.theta_max": [40.0, 1400.0, 1500.0, 1000.0],
    "oarc.theta_min": [15.0, 1000.0, 1100.0, -1000.0],
    "oarc.theta_max": [40.0, 1400.0, 1500.0, 1000.0],
    "oarc.disturbance_bound": 1.0,
    "arc.disturbance_bound": 1000.0,
    # Little noise on the voltage, so that a bump would show.
    "arc.velocity_cutoff": 40.0,
    "pid.derivative_cutoff": 40.0,
}
VALVES = {
    True: ("d3fxe.yaml",),  # friction, flow force, noise
    False: (),  # without feedback a spool does not come back against friction
}
NOISE = {"lvdt.noise": 0.0056, "lvdt.resolution": 0.0037}


class Fault(NamedTuple):
    """One fault: who injects it, how long it lasts, and what must follow.

    ``node`` is others for what a stranger on the graph does, which lasts as long as it takes him; a rival
    publishes on the topic ``parameter``.
    """

    name: str
    node: str  # that injects it
    parameter: str
    value: str
    samples: int  # that it lasts
    follows: str  # safe, bridged, neutral, reported, centred or undisturbed
    word: str  # of the diagnostics
    limit: float  # s
    controllers: Sequence[str]


SILENT = (HOLD + 1.5) * PERIOD + ALLOWANCE
# A frozen LVDT is found once FROZEN equal readings have come and the voltage has moved by FROZEN_VOLTAGE.
# It moves slowest around the crest of its sine, whose amplitude is least with the compensator.
CREST = math.acos(1.0 - FROZEN_VOLTAGE / (LEAST_GAIN * AMPLITUDE)) / (math.pi * FREQUENCY)
FROZEN_FOR = max(FROZEN * PERIOD, CREST) + PERIOD + ALLOWANCE
FLIPPED = 0.15 + ALLOWANCE
REPORT = 0.1 + ALLOWANCE
OTHER_PERIOD = (1 + (rate.WINDOWS + 1) // 2) * rate.WINDOW + ALLOWANCE  # one window was begun before
RETURN = AMPLITUDE / NEUTRAL_RATE + SETTLE + ALLOWANCE
FAULTS = (
    Fault("lvdt_lost", "valve_simulator", "fault.lvdt", "lost", LOST, "bridged", "bridged",
          2 * LOST * PERIOD + ALLOWANCE, CONTROLLERS),
    Fault("lvdt_silent", "valve_simulator", "fault.lvdt", "silent", 300, "safe", "silent",
          SILENT, CONTROLLERS),
    Fault("lvdt_frozen", "valve_simulator", "fault.lvdt", "frozen", 400, "safe", "stand still",
          FROZEN_FOR, CONTROLLERS),
    Fault("lvdt_out_of_range", "valve_simulator", "fault.lvdt", "out_of_range", 300, "safe", "out of range",
          SILENT, CONTROLLERS),
    Fault("lvdt_not_finite", "valve_simulator", "fault.lvdt", "not_finite", 300, "safe", "not finite",
          SILENT, CONTROLLERS),
    Fault("lvdt_brief", "valve_simulator", "fault.lvdt", "not_finite", HOLD + 3, "safe", "not finite",
          SILENT, CONTROLLERS),
    Fault("lvdt_jump", "valve_simulator", "fault.lvdt", "jump", 300, "safe", "jump", SILENT, CONTROLLERS),
    Fault("lvdt_flipped", "valve_simulator", "fault.lvdt", "flipped", 1500, "safe", "wrong sign",
          FLIPPED, FEEDBACK),
    Fault("lvdt_flipped_ahead", "valve_simulator", "fault.lvdt", "flipped", 3000, "safe", "wrong sign",
          2.0 / FREQUENCY + FLIPPED, FORWARD),
    Fault("lvdt_half", "valve_simulator", "fault.lvdt", "half", 3000, "safe", "disagree with the voltage",
          SILENT, CONTROLLERS),
    Fault("lvdt_publishers", "others", "spool_position", "rival", 700, "reported",
          "publishers on spool_position", 0.5 + ALLOWANCE, CONTROLLERS),
    Fault("lvdt_slow", "valve_simulator", "sample_period", "slow", 2000, "safe", "LVDT readings come every",
          OTHER_PERIOD, CONTROLLERS),
    Fault("lvdt_fast", "valve_simulator", "sample_period", "fast", 2000, "safe", "LVDT readings come every",
          OTHER_PERIOD, CONTROLLERS),
    Fault("voltage_publishers", "others", "valve_voltage", "rival", 700, "reported",
          "publishers on valve_voltage", 0.5 + ALLOWANCE, CONTROLLERS),
    Fault("leaving_clients", "others", "", "leave", 0, "undisturbed", "", SILENT, CONTROLLERS),
    Fault("parameter_storm", "others", "", "storm", 0, "undisturbed", "", SILENT, CONTROLLERS),
    Fault("joiners", "others", "", "join", 0, "undisturbed", "", SILENT, CONTROLLERS),
    Fault("command_silent", "command_source", "fault.command", "silent", 1500, "neutral", "command is silent",
          COMMAND_TIMEOUT + RETURN, CONTROLLERS),
    Fault("command_not_finite", "command_source", "fault.command", "not_finite", 200, "reported", "refused",
          REPORT, CONTROLLERS),
    Fault("command_out_of_range", "command_source", "fault.command", "out_of_range", 50, "reported",
          "limited",
          REPORT, CONTROLLERS),
    Fault("command_publishers", "others", "spool_command", "rival", 700, "reported",
          "publishers on spool_command", 0.5 + ALLOWANCE, CONTROLLERS),
    Fault("spool_stuck", "valve_simulator", "fault.valve", "stuck", 1500, "safe", "does not follow",
          1.0 / FREQUENCY + REPORT, FEEDBACK),
    Fault("valve_weak", "valve_simulator", "fault.valve", "weak", 1500, "safe", "does not follow",
          1.0 / FREQUENCY + REPORT, BOUNDED),
    Fault("controller_stopped", "controller", "", "", 400, "centred", "stood still",
          VOLTAGE_TIMEOUT + ALLOWANCE, CONTROLLERS),
)  # fmt: skip


class Campaign:
    """Runs one cascade in motion, injects faults into it, and reads the reaction from the messages."""

    def __init__(self, controller: str, children: dict[str, Any], listener: Listener) -> None:
        self.controller = controller
        self.children = children
        self.listener = listener
        self.said: list[tuple[float, str, bytes, str]] = []  # stamp, node, level, message
        self._diagnostics = PolledSubscription(listener, DiagnosticArray, "/diagnostics", EVERYTHING)
        self._clients = {
            node: AsyncParameterClient(listener, node) for node in ("valve_simulator", "command_source")
        }

    def fetch(self) -> None:
        """Take in the messages that have arrived."""
        self.listener.fetch()
        for message, _ in self._diagnostics.take():
            stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
            for status in message.status:
                self.said.append((stamp, status.name, status.level, status.message))

    def until(self, condition: Callable[[], bool], what: str, limit: float) -> None:
        """Fetch messages until ``condition`` holds. Raises RuntimeError after ``limit`` [s]."""

        def fetched() -> bool:
            self.fetch()
            return condition()

        wait_until(fetched, what, list(self.children.values()), limit)

    def go_on(self, duration: float) -> None:
        """Let the motion continue for ``duration`` [s]."""
        end = time.monotonic() + duration
        self.until(lambda: time.monotonic() >= end, "the motion", duration + 5.0)

    def inject(self, fault: Fault, folder: Path) -> dict[str, Any]:
        """Inject ``fault`` and hear its effect; returns what a process of strangers.py counted."""
        start = self.mark()
        with ExitStack() as others:
            if fault.node == "controller":
                self.children["controller"].send_signal(signal.SIGSTOP)
                self.go_on(fault.samples * PERIOD)
                self.children["controller"].send_signal(signal.SIGCONT)
            elif fault.value == "rival":
                others.enter_context(strangers.rival(self.listener, fault.parameter))
            elif fault.value == "join":
                log = folder / f"faults_{self.controller}_{fault.name}.log"
                crew = others.enter_context(crowd(JOINERS, log))
                self.until(crew.over, fault.name, 60.0)
                return {"joined_and_killed": len(crew.costs())}
            elif fault.value in ("leave", "storm"):
                call = f"leave({LEAVERS}, '/controller')"
                if fault.value == "storm":
                    name, *values = stormed(self.controller)
                    call = f"storm({STORM}, '/controller', {name!r}, {tuple(values)})"
                log = folder / f"faults_{self.controller}_{fault.name}.log"
                stranger = others.enter_context(strangers.stranger(call, log))
                self.until(stranger.over, fault.name, 60.0)
                return stranger.told()
            elif fault.parameter == "sample_period":
                self.set(fault.node, {"sample_period": OTHER_PERIODS[fault.value]})
            else:
                self.set(fault.node, {fault.parameter: fault.value})
            self.until(lambda: self.reported(fault.word, start) < math.inf, f"a word on {fault.name}", BACK)
            if fault.value == "rival" or fault.parameter == "sample_period":
                self.until(lambda: self.mark() > start + fault.samples * PERIOD, fault.name, 2.0 * BACK)
            if fault.parameter == "sample_period":
                self.set(fault.node, {"sample_period": PERIOD})
        return {}

    def set(self, node: str, values: dict[str, Any]) -> None:
        """Set parameters of ``node``, all or none. Raises RuntimeError if they are refused."""
        future = self._clients[node].set_parameters_atomically(
            [Parameter(name, value=value) for name, value in values.items()]
        )

        def answered() -> bool:
            rclpy.spin_once(self.listener, timeout_sec=0.001)
            return bool(future.done())

        self.until(answered, f"the answer to {', '.join(values)}", 5.0)
        result = future.result().result
        if not result.successful:
            raise RuntimeError(f"{values} refused: {result.reason}")

    def in_order(self) -> bool:
        """Whether the controller's last diagnostics say that all is well."""
        return next((s[2] == b"\x00" for s in reversed(self.said) if s[1] == "controller"), False)

    def mark(self) -> float:
        """Present time [s] on the clock of the messages' stamps."""
        return time.time()

    def after(self, topic: str, start: float) -> tuple[Array, Array]:
        """Values and stamps [s] of ``topic`` from ``start`` [s] on."""
        values, stamps = self.listener.arrays(topic)
        return values[stamps >= start], stamps[stamps >= start]

    def largest_step(self, start: float, end: float) -> float:
        """Largest step of the voltage a period from ``start`` to ``end`` [V]; a late one may be larger.

        Not counted is what follows within SETTLED after a pause that the operating system made in commands or
        readings: the step of the command that is in it is no doing of the controller.
        """
        values, stamps = self.listener.arrays("valve_voltage")
        inside = (stamps >= start) & (stamps <= end)
        steps = np.abs(np.diff(values[inside])) / np.maximum(1.0, np.round(np.diff(stamps[inside]) / PERIOD))
        counted = np.ones(len(steps), dtype=bool)
        for topic in ("spool_command", "spool_position"):
            _, times = self.after(topic, start - SETTLED)
            for pause in times[1:][np.diff(times) > PAUSE]:
                after = stamps[inside][1:] - pause
                counted &= (after < -PAUSE) | (after > SETTLED)
        return float(np.max(steps, where=counted, initial=0.0))

    def stopped(self, start: float) -> bool:
        """Whether the controller was in safe mode at any time from ``start`` on."""
        return any(s[0] >= start and s[1] == "controller" and s[2] == b"\x02" for s in self.said)

    def reported(self, word: str, start: float, node: str = "controller") -> float:
        """Time [s] at which ``node`` first reported ``word`` after ``start``, inf if it did not."""
        return next((s[0] for s in self.said if s[0] >= start and s[1] == node and word in s[3]), math.inf)


def stormed(controller: str) -> tuple[str, float, float]:
    """Parameter that a storm of changes sets: a gain of a law with feedback, or something harmless."""
    law = LAWS[controller]
    for parameter in law.parameters:
        if law.feedback and isinstance(parameter.default, float) and parameter.name not in law.form:
            return parameter.name, parameter.default, 0.99 * parameter.default
    return HARMLESS


def first(stamps: Array, condition: npt.NDArray[np.bool_]) -> float:
    """Stamp of the first entry for which ``condition`` holds, inf if none."""
    found = np.flatnonzero(condition)
    return float(stamps[found[0]]) if len(found) else math.inf


def onset(campaign: Campaign, fault: Fault, start: float) -> float:
    """Time [s] at which the fault began, read from the messages themselves."""
    # A fault may begin before another reading has come.
    readings, times = campaign.after("spool_position", start - 0.1)
    if fault.value == "not_finite" and fault.node == "valve_simulator":
        return first(times, ~np.isfinite(readings))
    if fault.name == "lvdt_out_of_range":
        return first(times, np.abs(readings) > U_MAX)
    if fault.name == "lvdt_jump":
        return first(times[1:], np.abs(np.diff(readings)) > 1.0)
    if fault.name == "lvdt_half":
        return first(times[1:], np.abs(np.diff(readings)) > 0.1 * AMPLITUDE)
    if fault.name == "lvdt_frozen":
        equal = np.convolve(np.diff(readings) == 0.0, np.ones(FROZEN // 2), "valid") >= FROZEN // 2
        return first(times[1:], equal)
    if fault.name == "lvdt_lost":
        numbers = np.array(campaign.listener.sequence["spool_position"])[-len(times) :]
        return first(times[:-1], np.diff(numbers) > 1) + PERIOD
    if fault.name == "lvdt_silent":
        return first(times[:-1], np.diff(times) > 0.5 * fault.samples * PERIOD) + PERIOD
    if fault.name == "command_silent":
        _, sent = campaign.after("spool_command", start - 0.1)
        return first(sent[:-1], np.diff(sent) > 0.1)
    if fault.name in ("command_not_finite", "command_out_of_range"):
        commands, sent = campaign.after("spool_command", start)
        return first(sent, ~(np.abs(commands) <= 2.0 * AMPLITUDE))
    if fault.follows == "centred":
        _, sent = campaign.after("valve_voltage", start - 0.1)
        return first(sent[:-1], np.diff(sent) > 0.1)
    return start


def reaction(campaign: Campaign, fault: Fault, began: float) -> float:
    """Time [s] from ``began`` to the reaction that must follow, inf if there was none."""
    voltages, sent = campaign.after("valve_voltage", began)
    readings, times = campaign.after("spool_position", began)
    if fault.follows == "safe":
        return first(sent, voltages == 0.0) - began
    if fault.follows == "bridged":
        after_gap = first(times, times > began + 2.0 * PERIOD)
        safe = first(sent, voltages == 0.0)
        return math.inf if safe < after_gap + 0.5 else first(sent, sent > after_gap) - began
    if fault.follows == "centred":
        return campaign.reported(CENTRES, began, "valve_simulator") - began
    if fault.follows == "neutral":
        off = np.flatnonzero(np.abs(readings[times < began + fault.limit]) > CENTRED)
        last = float(times[off[-1]]) if len(off) else began
        return last - began + PERIOD
    if fault.follows == "undisturbed":
        return math.inf if campaign.stopped(began) else float(np.max(np.diff(sent)))
    return campaign.reported(fault.word, began) - began


def served(told: dict[str, Any]) -> bool:
    """Whether all calls of a storm were answered, and soon."""
    return "asked" not in told or (
        told["answered"] == told["asked"] and not told["refused"] and told["p50_s"] < ANSWERED
    )


def run_fault(
    campaign: Campaign, fault: Fault, random: np.random.Generator, usual: float, folder: Path
) -> dict[str, Any]:
    """Inject ``fault`` at a random moment of the motion and judge what follows; ``usual`` [V]: largest step.

    One that does not pass is tried again, up to TRIES times: a machine without real-time scheduling puts a
    process aside now and then, and hides the fault or adds one of its own. The result says how often.
    """
    for repeated in range(TRIES):
        try:
            judged = _judged(campaign, fault, *_injected(campaign, fault, random, folder), usual)
        except RuntimeError:
            if repeated == TRIES - 1:
                raise
            campaign.until(campaign.in_order, f"order after {fault.name}", BACK)
            continue
        if judged["passed"]:
            break
    return {"fault": fault.name, "controller": campaign.controller, "repeated": repeated, **judged}


def _injected(
    campaign: Campaign, fault: Fault, random: np.random.Generator, folder: Path
) -> tuple[float, dict[str, Any]]:
    """Inject ``fault`` and wait until all is in order again; its time [s], and what it told."""
    if fault.parameter.startswith("fault."):
        # The first change after some seconds may take 13 ms, in which a jump of the reading cannot be seen.
        campaign.set(fault.node, {"fault.samples": fault.samples})
    campaign.go_on(float(random.uniform(0.0, 1.0 / FREQUENCY)))
    if fault.value == "half":
        # Near neutral half the reading is the reading: only from elsewhere it is a jump.
        campaign.until(
            lambda: abs(campaign.listener.values["spool_position"][-1]) > 0.9 * AMPLITUDE,
            "a deflection",
            BACK,
        )
    start = campaign.mark()
    told = campaign.inject(fault, folder)
    heard = campaign.reported(fault.word, start) if fault.word else start
    campaign.until(
        lambda: campaign.in_order() and campaign.mark() > max(heard, start + fault.samples * PERIOD),
        f"order after {fault.name}",
        BACK + fault.samples * PERIOD,
    )
    campaign.go_on(0.3)
    if fault.follows == "centred":
        # What the middleware has to send again comes late; its stamp is that of the event.
        late = time.monotonic() + BACK
        campaign.until(
            lambda: (
                campaign.reported(CENTRES, start, "valve_simulator") < math.inf or time.monotonic() > late
            ),
            "a word",
            2.0 * BACK,
        )
    return start, told


def _judged(
    campaign: Campaign, fault: Fault, start: float, told: dict[str, Any], usual: float
) -> dict[str, Any]:
    """What followed ``fault``, injected at ``start`` [s], and whether that is as it should be."""
    began = onset(campaign, fault, start)
    took = reaction(campaign, fault, began)
    voltages, sent = campaign.after("valve_voltage", start)
    zero = np.flatnonzero(voltages == 0.0)
    returned = float(sent[min(zero[-1], len(sent) - 1)]) if len(zero) else began
    if fault.follows == "neutral":
        returned = began + fault.samples * PERIOD - 0.1
    step = 0.0
    if fault.follows in ("safe", "neutral", "centred"):
        step = campaign.largest_step(returned, returned + 1.0)
    allowed = STEP_FACTOR * usual + FADE
    highest = float(np.max(np.abs(voltages))) if np.all(np.isfinite(voltages)) else None
    bounded = highest is not None and highest <= U_MAX
    return {
        "reaction_s": round(took, 5) if math.isfinite(took) else None,
        "limit_s": round(fault.limit, 5),
        "max_abs_voltage": highest,
        "largest_step_on_return_V": round(step, 4),
        "step_allowed_V": round(allowed, 4),
        "recovered": bool(step <= allowed),
        "passed": bool(bounded and took <= fault.limit and step <= allowed and served(told)),
        **told,
    }


def run_controller(
    controller: str, faults: Sequence[Fault], folder: Path, random: np.random.Generator
) -> list[dict[str, Any]]:
    """Inject all ``faults`` into one cascade with one controller; returns a result for each."""
    config = VALVES[controller in FEEDBACK]
    settings = {**SETTINGS, "controller": controller, **({} if config else NOISE)}
    names = ("controller", "valve_simulator", "command_source")
    logs = [folder / f"faults_{controller}_{name}.log" for name in names]
    results: list[dict[str, Any]] = []
    listener = Listener("faults")
    try:
        with (
            process("controller", node_arguments("controller", config, settings), logs[0]) as c,
            process("valve_simulator", node_arguments("valve_simulator", config, settings), logs[1]) as v,
            process("command_source", node_arguments("command_source", config, settings), logs[2]) as s,
            bar(controller, float(len(faults)), "faults") as progress,
        ):
            campaign = Campaign(
                controller, {"controller": c, "valve_simulator": v, "command_source": s}, listener
            )
            try:
                begun = campaign.mark()
                campaign.until(lambda: len(listener.values["spool_command"]) > 0, "the command", 30.0)
                campaign.go_on(MEET)
                campaign.until(campaign.in_order, "order at the beginning", 10.0)
                campaign.go_on(OBSERVE)
                usual = campaign.largest_step(begun, campaign.mark())
                for fault in faults:
                    results.append(run_fault(campaign, fault, random, usual, folder))
                    progress.update(1)
            finally:
                c.send_signal(signal.SIGCONT)
    finally:
        listener.destroy_node()
    return results


def table(results: Sequence[dict[str, Any]]) -> str:
    """The results as a table, one fault a line, reaction times in ms, with a prime for each repetition."""
    lines = [f"{'reaction [ms]':24}{'limit':>8}" + "".join(f"{c:>13}" for c in CONTROLLERS)]
    for fault in FAULTS:
        cells = []
        for controller in CONTROLLERS:
            entry = next(
                (r for r in results if (r["fault"], r["controller"]) == (fault.name, controller)), None
            )
            if entry is None:
                cells.append("-")
            else:
                took = "none" if entry["reaction_s"] is None else f"{1e3 * entry['reaction_s']:.1f}"
                took += "'" * entry["repeated"]
                cells.append(took if entry["passed"] else f"FAILED {took}")
        lines.append(f"{fault.name:24}{1e3 * fault.limit:8.0f}" + "".join(f"{cell:>13}" for cell in cells))
    return "\n".join(lines)


def main() -> int:
    """Entry point of `make faults`."""
    options = tool_options("faults", __doc__, (*CONTROLLERS, *drivers.KINDS))
    options.add_argument("--seed", type=int, default=1, metavar="N", help="of the moments of injection (1)")
    options.add_argument(
        "--fault",
        choices=[f.name for f in (*FAULTS, *drivers.FAULTS)],
        action="append",
        help="one fault; again for more",
    )
    arguments = parse_tool(options)
    folder = Path(arguments.out)

    def work() -> int:
        random = np.random.default_rng(arguments.seed)
        results: list[dict[str, Any]] = []
        only = arguments.only or (*CONTROLLERS, *drivers.KINDS)
        for controller in [name for name in only if name in CONTROLLERS]:
            chosen = [
                fault
                for fault in FAULTS
                if controller in fault.controllers and (not arguments.fault or fault.name in arguments.fault)
            ]
            if chosen:
                results += run_controller(controller, chosen, folder, random)
        of_devices = [
            drivers.run_fault(fault, folder)
            for fault in drivers.FAULTS
            if fault.driver in only and (not arguments.fault or fault.name in arguments.fault)
        ]
        if results:
            print(f"\n{table(results)}")
        if of_devices:
            print(f"\n{drivers.table(of_devices)}")
        results += of_devices
        path = folder / "faults.json"
        outputs.write(str(path), outputs.as_json(results))
        print(f"\nwrote {path} and the nodes' logs")
        failed = [r for r in results if not r["passed"]]
        for entry in failed:
            print(f"FAILED: {json.dumps(entry)}", file=sys.stderr)
        return 1 if failed else 0

    return run_tool("faults", folder, work)


if __name__ == "__main__":
    sys.exit(main())
