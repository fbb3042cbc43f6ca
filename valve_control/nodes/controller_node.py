# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The node `controller` with topics: for each LVDT reading one step of the law and one voltage."""

import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectoryPoint

from valve_control import outputs, parameter
from valve_control.control.laws.registry import LAWS, LEFT_OUT
from valve_control.control.parameters import arguments, build, ros_file
from valve_control.control.parameters.controller import CONTROLLER
from valve_control.control.supervision import rate
from valve_control.control.supervision.command_course import Motion
from valve_control.control.supervision.journal import OBSERVED, TYPES, Journal
from valve_control.control.supervision.memory import Mode
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.nodes import realtime
from valve_control.nodes.adapter import (
    NEWEST,
    SAMPLES,
    UNKNOWN,
    Diagnostics,
    NumberSubscription,
    ParameterSet,
    PolledSubscription,
    acquainted,
    encoded,
    number_of,
)
from valve_control.nodes.lifecycle import Managed
from valve_control.nodes.lockstep import COMMANDING, Lockstep
from valve_control.nodes.loop import stood_still
from valve_control.nodes.rclpy_internals import sender
from valve_control.nodes.right_of_way import Rivals
from valve_control.nodes.telemetry import JournalTopics, Telemetry
from valve_control.nodes.timing import Timing
from valve_control.parameter import ParameterError, Values, word

LEVELS = {
    Mode.OK: DiagnosticStatus.OK,
    Mode.DEGRADED: DiagnosticStatus.WARN,
    Mode.SAFE: DiagnosticStatus.ERROR,
}
REMIND = 0.1  # s between two voltages of 0 V while the LVDT is silent
WATCH_GRAPH = 0.1  # s between two looks at who publishes and reads, and between two parts of the journal
LAST_WORD = 0.2  # s to see the last voltage of 0 V received
NEVER = math.inf
LOOK = 0.65  # of a period after a reading, when commands are taken: for the next reading it is late
RIVAL = "another publisher on valve_voltage controls this valve: end it, then activate this controller"
QUIET = 0.05  # s between two changes that are told, but safe mode at once; each costs two periods or more


class Controller(Managed):
    """Reads `spool_position`, `spool_command`, `spool_trajectory`, publishes `valve_voltage` and `~/state`.

    ``alone``: whether the process has no other node.
    """

    table: parameter.Table = CONTROLLER

    def __init__(self, alone: bool = True, **options: Any) -> None:
        super().__init__("controller", **options)
        self._journal = Journal()
        self._supervisor = Supervisor(self._journal.note)
        self._said: tuple[Mode, str] | None = None
        self._announced: dict[str, float] = {}  # s, when a change was last told, by source
        self._lockstep: Lockstep | None = None
        self._silent_at = NEVER  # s, from when on the LVDT counts as silent
        self._catching_up = False  # whether readings of a standstill come in a burst
        self._alone, self._commands_at = alone, NEVER  # s, when commands are taken for the next reading
        self._seen = 0.0  # s, last reading or silence
        self._first_pace: rate.State | None = None  # of the readings before the first that is used
        self._last_number = 0  # of a reading before the first that is used
        self._counts: dict[str, int] = {}  # of publishers, by topic
        self._strange: dict[str, int] = {}  # of those with another message type
        self._values: Values = {}
        self._rivals = Rivals(self)
        self._telemetry = Telemetry(self)
        self._journal_topics = JournalTopics(self, self._journal, self._supervisor)
        self._timing = Timing()
        self._commanded = False  # whether there has been an upper level
        self._published = 0  # ns, when the last voltage was
        self._unchecked = False
        self._checked: Future[None]
        self._checker = ThreadPoolExecutor(1)  # a thread's start takes milliseconds where memory is locked
        self._unnumbered = False  # whether the middleware has numbered no reading
        self._diagnostics = Diagnostics(self, self._diagnose)
        self._settings = ParameterSet(self, self.table, self._build, self._apply, alone, ("lockstep",))
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/save_parameters", self._on_save)
        self.create_service(Trigger, "~/load_parameters", self._on_load)
        self.create_timer(WATCH_GRAPH, self._watch_graph, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._check_stability()
        self._checked.result()
        if self._values["autostart"]:
            self.autostart()

    def _build(self, values: Values) -> Any:
        if refusal := self._supervisor.period_refusal(parameter.number(values, "sample_period")):
            raise ParameterError(refusal)
        return build.law_params(values, self._values)

    def _apply(self, values: Values, built: Any) -> None:
        self._values = values
        self._supervisor.apply(values, built)
        self._params = built
        self._period = parameter.number(values, "sample_period")
        self._clocked = parameter.number(values, "lvdt.period_limit") < rate.ANY
        self._journal_topics.period = parameter.number(values, "memory_period")
        self._in_lockstep = values["lockstep"] is True
        # Periods: half of one more than the last reading that may still come in time.
        self._silent_after = 1.5 + parameter.number(values, "lvdt.hold_samples")
        every = int(parameter.number(values, "state_decimation"))
        self._telemetry.apply(self._supervisor.labels(), every)
        self._unchecked = True
        self._journal_topics.publish()

    # Life

    def open(self) -> None:
        """Create publishers and subscriptions."""
        self._voltages = self.create_publisher(Float64, "valve_voltage", SAMPLES)
        self._send_voltage = sender(self._voltages)
        self._telemetry.open()
        self._journal_topics.open()
        # In lockstep each message is waited for.
        qos = SAMPLES if self._in_lockstep else NEWEST
        self._commands = NumberSubscription(self, "spool_command", qos)
        self._trajectories = PolledSubscription(self, JointTrajectoryPoint, "spool_trajectory", qos)
        self._readings = self._source(qos)
        sources = (self._commands, self._trajectories)
        self._lockstep = Lockstep(self, sources, self._relay, self._acquainted) if self._in_lockstep else None

    def _source(self, qos: QoSProfile) -> NumberSubscription:
        """Readings of the LVDT with their numbers."""
        return NumberSubscription(self, "spool_position", qos)

    def begin(self) -> None:
        """Start from rest; messages that already wait are stale and dropped, but not in lockstep."""
        self._rivals.given = 0
        if not self._in_lockstep:
            for topic in (self._readings, self._commands, self._trajectories):
                for _ in topic.take():
                    pass
        self._supervisor.start()
        self._journal_topics.publish()
        self._said = None
        self._seen = time.monotonic()
        self._silent_at = NEVER if self._in_lockstep else self._seen + REMIND
        self._first_pace = None if self._in_lockstep else rate.UNKNOWN
        self._catching_up = False
        self._timing.clear()
        for sentence in LEFT_OUT.values():
            self.get_logger().warning(sentence)
        self.get_logger().info(
            f"{self._supervisor.name} at {1.0 / self._period:g} Hz, waiting for spool_position"
        )

    def end(self) -> None:
        """Publish 0 V once and stop."""
        self._give_voltage(self._supervisor.stop())
        self._rivals.listen(False, self._period)
        self._journal_topics.publish()
        self._silent_at = NEVER
        self.get_logger().info("inactive, 0 V")

    def deliver(self) -> None:
        """Wait until the last 0 V is acknowledged; not in ``end``, where other valves would have to wait."""
        if self.configured:
            for publisher in (self._voltages, self._journal_topics.publisher):
                publisher.wait_for_all_acked(Duration(seconds=LAST_WORD))

    # Work

    def inputs(self) -> Sequence[PolledSubscription]:
        """Subscription of the LVDT; in lockstep those of commands while a reading waits for one."""
        if not self.working:
            return ()
        if self._lockstep is None or self._lockstep.waiting is None:
            return (self._readings,)
        return self._lockstep.inputs()

    def due(self) -> float:
        """Next time [s] to act without a message: LVDT silent, commands, lockstep check."""
        look_at = NEVER if self._lockstep is None else self._lockstep.look_at
        return min(self._silent_at, self._commands_at, look_at) if self.working else NEVER

    def work(self) -> bool:
        """Answer each waiting reading, or take commands for the next; without one in time, switch off."""
        if not self.working:
            return False
        if self._lockstep is not None:
            taken = self._lockstep.next(self._readings)
            if taken is not None:
                self._answer(*taken)
            return taken is not None
        worked = False
        for reading, info in self._readings.take():
            self._answer(reading, info)
            worked = True
        now = time.monotonic()
        if self._commands_at <= now < self._silent_at and not worked:
            self._commands_at = NEVER
            self._take_commands()
        if now >= self._silent_at and not worked:
            self._catching_up = self._stood_still(now)
            self._take_commands()
            if self._first_pace is not None:
                self._first_pace = rate.interrupted(self._first_pace)
            voltage = self._supervisor.silence(self._lap(now), self._catching_up)
            if self._supervisor.begun:
                self._give_voltage(voltage)
            self._silent_at = now + REMIND
            worked = True
        return worked

    def _stood_still(self, now: float) -> bool:
        """Whether this process stood still until ``now`` [s], so that it did not look in time."""
        return stood_still(self._silent_at, now)

    def _answer(self, reading: float, info: dict[str, Any]) -> None:
        began = time.monotonic()
        number = number_of(info)
        if number == 0 and not self._unnumbered:
            self._unnumbered = True
            self.get_logger().warning(UNKNOWN)
        if not self._in_lockstep:
            self._take_commands()
        if self._first_pace is not None and not self._measure_period(self._first_pace, number, began):
            return
        # What was sent while this process stood still comes in a burst afterwards and is stale.
        if self._stood_still(began):
            self._catching_up = True
        elif self._catching_up:
            arrivals = self._timing.arrivals
            self._catching_up = bool(arrivals) and began - arrivals[-1] < 0.5 * self._period
        if self._catching_up:
            self._give_voltage(self._supervisor.skip(reading, number, self._lap(began)))
        else:
            lap = self._lap(began)
            self._supervisor.sample(reading, number, 0.0 if self._in_lockstep else lap, self._give_voltage)
        ended = time.monotonic()
        latency = (self._published - info["source_timestamp"]) * 1e-9
        self._timing.note(began, ended, latency, self._period)
        if not self._in_lockstep:
            if self._alone:
                self._commands_at = began + LOOK * self._period
            self._silent_at = began + (self._silent_after - self._supervisor.bridged) * self._period
        self._telemetry.note(self._supervisor)

    def _measure_period(self, before: rate.State, number: int, now: float) -> bool:
        """Measure the period with reading ``number`` at ``now`` [s]; whether a first voltage may follow."""
        expected = self._supervisor.params.lvdt.pace
        periods = max(1, number - self._last_number) if self._last_number else 1
        self._last_number = number
        pace = rate.step(expected, before, self._lap(now), periods)
        self._silent_at = now + self._silent_after * self._period
        if rate.is_right(expected, pace):
            self._first_pace, self._last_number = None, 0
            return True
        self._first_pace = pace
        if pace.level == 2 and before.level < 2:
            self._supervisor.observe("lvdt_missing", rate.text(expected, pace))
        return False

    def _lap(self, now: float) -> float:
        """Time [s] from the last call to this one, at ``now`` [s]."""
        elapsed, self._seen = now - self._seen, now
        return elapsed

    def _give_voltage(self, voltage: float) -> None:
        self._rivals.given += 1
        self._send_voltage(encoded(voltage))
        self._published = time.time_ns()

    def _take_commands(self) -> None:
        """Pass waiting commands to the supervisor."""
        for source in (self._commands, self._trajectories):
            for message, info in source.take():
                self._relay(message, info)

    def _relay(self, message: Any, info: Mapping[str, Any] = {}) -> None:  # noqa: B006
        """Pass on a command or a point.

        Times mean nothing in lockstep, without ``info``, and where readings may come at any pace.
        """
        since = math.nan
        if info and self._clocked:  # s after the last reading or silence, by the middleware, or by now
            received = info["received_timestamp"]
            ago = (time.time_ns() - received) * 1e-9 if received else 0.0
            since = time.monotonic() - self._seen - ago
        supervisor, journal, sent = self._supervisor, self._journal, info.get("source_timestamp", 0)
        if not isinstance(message, JointTrajectoryPoint):
            supervisor.command(message, journal.seconds("command", sent * self._clocked), since)
            return
        counts = len(message.positions), len(message.velocities), len(message.accelerations)
        if counts == (1, 1, 1):
            motion = Motion(*message.positions, *message.velocities, *message.accelerations)
            own = message.time_from_start.sec * 10**9 + message.time_from_start.nanosec
            supervisor.trajectory(motion, journal.seconds("trajectory", own or sent), since)
        else:
            supervisor.trajectory_refused(*counts)

    def _acquainted(self) -> bool:
        """Whether who gives the readings will hear the voltages."""
        return acquainted(self, self._voltages, "spool_position")

    # What is around

    def _watch_graph(self) -> None:
        if not self.configured:
            return
        self._journal_topics.look()
        counts = {topic: self.count_publishers(topic) for topic in OBSERVED}
        for topic, count in counts.items():
            if count != self._counts.get(topic):  # their types take longer
                types = [info.topic_type for info in self.get_publishers_info_by_topic(topic)]
                self._strange[topic] = len(types) - types.count(TYPES[topic])
            self._supervisor.publishers(topic, -self._strange[topic] or count)
        self._counts = counts
        self._give_way(counts["valve_voltage"] > 1)
        commanded = any(counts[topic] > self._strange[topic] for topic in COMMANDING)
        self._commanded = self._commanded or commanded
        if self._commanded and not self._in_lockstep:
            if not commanded:
                self._supervisor.command_gone()
            elif counts["spool_trajectory"] == self._strange["spool_trajectory"]:
                self._supervisor.trajectory_gone()

    def _give_way(self, several: bool) -> None:
        """Deactivate this controller if somebody else controls the valve."""
        self._rivals.listen(several and self.working and not self._in_lockstep, self._period)
        if self._rivals.control(self._period):
            self.halt(RIVAL)

    def _check_stability(self) -> None:
        """Warn about unstable gains: in a thread, since the check takes up to twenty periods."""
        if self._unchecked:
            self._unchecked = False
            self._checked = self._checker.submit(self._warn_of, LAWS[self._supervisor.name], self._params)

    def _warn_of(self, law: Any, params: Any) -> None:
        from valve_control.control.linear import stability  # with all plants; the first time before the loop

        if text := stability.warning(law, params):
            self.get_logger().warning(text)

    # Services

    def _on_reset(self, request: Any, response: Any) -> Any:
        with self._answering(response, "not reset"):
            self._supervisor.reset()
            response.message = "estimates and filters are at their start"
        return response

    @contextmanager
    def _answering(self, response: Any, otherwise: str) -> Iterator[None]:
        """Tell whether the block succeeds; if not, answer with ``otherwise`` and the reason."""
        try:
            yield
            response.success = True
            self.get_logger().info(response.message)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            response.message, response.success = outputs.printable(f"{otherwise}: {reason}"), False
            self.get_logger().warning(response.message)

    def _save_file(self) -> str:
        own = self.get_fully_qualified_name().strip("/").replace("/", "_")
        return word(self._values, "save_file") or f"{own}.yaml"

    def _on_save(self, request: Any, response: Any) -> Any:
        name = self._save_file()
        with self._answering(response, f"{name} cannot be written"):
            path = Path(os.path.expanduser(name)).absolute()
            ros_file.save(path, self.get_fully_qualified_name(), self._supervisor.present_values())
            response.message = f"wrote {outputs.shown(path)}"
        return response

    def _on_load(self, request: Any, response: Any) -> Any:
        with self._answering(response, "no parameter changed"):
            name = word(self._values, "load_file") or self._save_file()
            path = Path(os.path.expanduser(name)).absolute()
            values = arguments.addressed(str(path), self.get_fully_qualified_name(), self.table)
            changes = {n: value for n, value in values.items() if value != self._settings.values[n]}
            if changes:
                wanted = [Parameter(n, value=value) for n, value in changes.items()]
                result = self.set_parameters_atomically(wanted)
                if not result.successful:
                    raise ParameterError(f"{path}: {result.reason}")
            count = f"{len(values)} parameters from {outputs.shown(path)}"
            response.message = f"{count}, of which {len(changes)} changed"
        return response

    # What is said

    def report(self) -> None:
        """Publish telemetry, and diagnostics if something has changed."""
        self._telemetry.publish()
        self._journal_topics.publish_many()
        supervisor = self._supervisor
        if self.working and supervisor.memory.changed and self._may_tell(supervisor.mode is Mode.SAFE):
            self._announce()

    def _may_tell(self, safe: bool, of: str = "supervisor") -> bool:
        """Whether it is time to tell a change ``of`` something; if it is, it counts as told."""
        now = time.monotonic()
        if now < self._announced.get(of, -NEVER) + QUIET and not safe:
            return False
        self._announced[of] = now
        return True

    def _announce(self) -> None:
        """Log a change of mode or reason once, and publish it at once."""
        supervisor = self._supervisor
        supervisor.memory.changed = False
        now = (supervisor.mode, supervisor.reason)
        if now != self._said:
            before = self._said[0].name.lower() if self._said else "off"
            names = f" ({', '.join(supervisor.conditions)})" if supervisor.conditions else ""
            text = f"{before} → {now[0].name.lower()}{names}: {now[1]}"
            self.later(self._logged(Mode.OK if self._said is None else now[0], text))
            self._said = now
        self._publish_diagnostics()

    def _logged(self, mode: Mode, text: str) -> Iterator[None]:
        if mode is Mode.OK:
            self.get_logger().info(text)
        elif mode is Mode.SAFE:
            self.get_logger().error(text)
        else:
            self.get_logger().warning(text)
        yield

    def _diagnose(self) -> None:
        if self._checked.done():
            self._checked.result()  # an error of the check ends the node, as any other does
        self._check_stability()
        self._publish_diagnostics()

    def _publish_diagnostics(self) -> None:
        figures = partial(self._timing.figures, self._period)
        self._diagnostics.tell(*self._status(), self._figures(), figures, realtime.obtained)

    def _status(self) -> tuple[bytes, str]:
        """Level and sentence of the diagnostics."""
        return LEVELS[self._supervisor.mode], self._supervisor.reason

    def _figures(self) -> dict[str, Any]:
        supervisor, memory = self._supervisor, self._supervisor.memory
        values: dict[str, Any] = {
            "controller": supervisor.name,
            "active": self.working,
            "mode": supervisor.mode.name.lower(),
            "conditions": ", ".join(supervisor.conditions),
            "samples": memory.samples,
            **memory.counts,
            "overruns": self._timing.overruns,
            "voltage_V": f"{supervisor.voltage:.4f}",
        }
        if memory.samples:
            values["saturation_share"] = f"{memory.counts['saturated'] / memory.samples:.4f}"
        if supervisor.theta is not None:
            values["theta"] = ", ".join(f"{v:.6g}" for v in supervisor.theta)
        values |= {name: f"{v:.6g}" for name, v in supervisor.assumed.items()}
        return {**values, "pid": os.getpid()}
