# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reaches a running controller for `valve-control commission`, and looks at every message meanwhile."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectoryPoint

from valve_control.control.analysis import timing
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.supervision import rate
from valve_control.design.commissioning import bench
from valve_control.design.commissioning.bench import Fault, Pause, Point, Record, SafetyLimits, Watch
from valve_control.nodes.adapter import (
    EVERYTHING,
    SAMPLES,
    NumberSubscription,
    PolledSubscription,
    encoded,
    encoded_point,
    number_of,
)
from valve_control.nodes.loop import first_line
from valve_control.nodes.rclpy_internals import WaitSet
from valve_control.parameter import ParameterError, Value, Values

MEET = 10.0  # s  in which controller and valve have to be found
ANSWER = 5.0  # s  in which a service has to answer
AGAIN = 1.5  # s  after which it is asked again: a server that does not know the client yet cannot answer
SILENT = 1.0  # s  without a reading, or without a voltage, from which on something is broken
LOOK = 0.01  # s  most between two looks at what has come
LAST_WORD = 0.2  # s  in which the last messages arrive
# Sample periods, and s at least, after which a voltage or a command is older than the loop is made for.
LATE_VOLTAGE, LATE_COMMAND = (3.0, 0.003), (6.0, 0.006)
SIMULATOR = "valve_simulator"  # gives a voltage the whole period of its reading, however late it comes
Sample = tuple[int, int, float]  # number, time of sending [ns], V


class Controller:
    """A running controller ``name`` (full name), as ``commissioning.bench.Bench`` describes it.

    ``period`` [s]: of its readings.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self.name = "/" + name.strip("/")
        namespace = self.name.rpartition("/")[0]
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._topics = {
            part: f"{namespace}/{part}"
            for part in ("spool_command", "spool_trajectory", "spool_position", "valve_voltage")
        }
        self._readings = NumberSubscription(node, self._topics["spool_position"], EVERYTHING)
        self._voltages = NumberSubscription(node, self._topics["valve_voltage"], EVERYTHING)
        self._diagnostics = PolledSubscription(node, DiagnosticArray, "/diagnostics", EVERYTHING)
        self._commands = node.create_publisher(Float64, self._topics["spool_command"], SAMPLES)
        self._points = node.create_publisher(JointTrajectoryPoint, self._topics["spool_trajectory"], SAMPLES)
        self._waits = False  # whether the valve waits for its voltage
        self._period = 0.0  # s
        self._counts = False  # whether the controller counts readings and looks at no stamp
        self._clients = {
            service: node.create_client(kind, f"{self.name}/{service}")
            for service, kind in (
                ("get_parameters", GetParameters),
                ("set_parameters_atomically", SetParametersAtomically),
                ("change_state", ChangeState),
                ("get_state", GetState),
            )
        }
        self._setting: list[Any] = []  # answers that are still to come
        self._heard = {"reading": time.monotonic(), "voltage": time.monotonic()}

    # Life

    def _wait(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Whether ``condition`` holds within ``seconds``, in which messages and answers come."""
        end = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > end:
                return False
            self._executor.spin_once(timeout_sec=LOOK)
        return True

    def meet(self) -> None:
        """Wait until the controller is there with all its services. Raises Fault."""
        clients = self._clients.values()
        if not self._wait(lambda: all(client.service_is_ready() for client in clients), MEET):
            raise Fault(f"there is no controller {self.name}; is it running, in this ROS domain?")

    def meet_valve(self) -> None:
        """Wait for readings, and see that nobody else commands. Raises Fault."""
        position = self._topics["spool_position"]
        if not self._wait(lambda: bool(self._taken(self._readings)), MEET):
            raise Fault(f"no reading has come on {position} within {MEET:g} s")

        def connected() -> bool:
            heard = self._commands.get_subscription_count() and self._points.get_subscription_count()
            return bool(heard) and self._publishers("valve_voltage") > 0

        if not self._wait(connected, MEET):
            raise Fault(f"{self.name} does not read {self._topics['spool_command']}")
        for part, topic in self._topics.items():  # what was killed stays in the graph for a while
            if not self._wait(lambda part=part: self._publishers(part) <= 1, MEET):  # type: ignore[misc]
                raise Fault(f"somebody else publishes on {topic}; end that first")
        senders = self._node.get_publishers_info_by_topic(position)
        self._waits = any(info.node_name == SIMULATOR for info in senders)

    def _publishers(self, part: str) -> int:
        return int(self._node.count_publishers(self._topics[part]))

    # Services

    def values(self) -> Values:
        """All parameters. Raises Fault."""
        self._settle()
        names = [parameter.name for parameter in CONTROLLER]
        messages = self._call("get_parameters", GetParameters.Request(names=names)).values
        values: Values = {}
        for name, message in zip(names, messages, strict=True):
            value = parameter_value_to_python(message)
            if value is None:
                raise Fault(f"{self.name} has no parameter {name}: it is no controller of this version")
            values[name] = value if isinstance(value, (bool, int, float, str)) else list(value)
        self._period = float(str(values["sample_period"]))
        self._counts = float(str(values["lvdt.period_limit"])) >= rate.ANY
        return values

    def apply(self, changes: Mapping[str, Value]) -> None:
        """Set all ``changes`` or none. Raises Fault."""
        if not changes:
            return
        request = SetParametersAtomically.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in changes.items()]
        )
        result = self._call("set_parameters_atomically", request).result
        if not result.successful:
            raise Fault(f"{self.name} refuses the parameters: {result.reason}")

    def on(self) -> None:
        """Activate the controller, and wait until it says that it controls. Raises Fault.

        It begins without a reading.
        """
        state = self._state()
        if state == State.PRIMARY_STATE_UNCONFIGURED:
            self._change(Transition.TRANSITION_CONFIGURE)
            state = self._state()
        if state != State.PRIMARY_STATE_ACTIVE:
            self._change(Transition.TRANSITION_ACTIVATE)
            if self._state() != State.PRIMARY_STATE_ACTIVE:
                raise Fault(f"{self.name} cannot be activated")
        list(self._diagnostics.take())  # of before
        texts = ["nothing"]

        def controls() -> bool:
            for diagnosis in self._new_diagnoses():
                texts.append(diagnosis.text)
                if diagnosis.active and not diagnosis.safe:
                    return True
            return False

        if not self._wait(controls, ANSWER):
            raise Fault(f"the controller says: {texts[-1]}")
        list(self._readings.take())
        list(self._voltages.take())
        self._heard = dict.fromkeys(self._heard, time.monotonic())

    def _new_diagnoses(self) -> Iterator[bench.Diagnosis]:
        for message, _ in self._diagnostics.take():
            for status in message.status:
                if status.name == self.name.lstrip("/"):
                    figures = {entry.key: entry.value for entry in status.values}
                    conditions = frozenset(figures.get("conditions", "").split(", "))
                    safe = status.level == DiagnosticStatus.ERROR
                    yield bench.Diagnosis(safe, figures.get("active") == "True", conditions, status.message)

    def off(self) -> None:
        """Deactivate the controller, which gives 0 V. Raises Fault."""
        self._change(Transition.TRANSITION_DEACTIVATE)
        if self._state() == State.PRIMARY_STATE_ACTIVE:
            raise Fault(f"{self.name} is still active")

    @property
    def active(self) -> bool:
        """Whether the controller works. Raises Fault."""
        return bool(self._state() == State.PRIMARY_STATE_ACTIVE)

    def _state(self) -> int:
        return int(self._call("get_state", GetState.Request()).current_state.id)

    def _change(self, transition: int) -> None:
        self._call("change_state", ChangeState.Request(transition=Transition(id=transition)))

    def _call(self, service: str, request: Any) -> Any:
        """Answer of a service, which is asked again if it does not come. Raises Fault."""
        end, futures = time.monotonic() + ANSWER, list[Any]()
        while time.monotonic() < end:
            futures.append(self._clients[service].call_async(request))
            if service == "set_parameters_atomically":
                self._setting.append(futures[-1])
            if self._wait(lambda: any(future.done() for future in futures), AGAIN):
                return next(future.result() for future in futures if future.done())
        raise Fault(f"{self.name} does not answer {service} within {ANSWER:g} s")

    def _settle(self) -> None:
        """Wait for parameters that were being set when something else began."""
        self._wait(lambda: all(future.done() for future in self._setting), AGAIN)
        self._setting.clear()

    # Messages

    def watch(self, limits: SafetyLimits) -> None:
        """Look at what has come. Raises Fault."""
        self._look(Watch(limits))

    def drive(self, course: bench.Course, limits: SafetyLimits, elapsed: bench.Elapsed) -> Record:
        """Give the commands of ``course``, one for each reading. Raises Fault.

        A command is for the next reading. It is sent when the voltage that answers this one has come: the
        controller would take it now or then, as chance has it, if it were sent with the reading.
        """
        self._look(Watch(limits))
        watch = Watch(limits)
        wait_set = WaitSet(2, 0, 0, 0, 0, 0, self._node.context.handle)
        readings: list[Sample] = []
        voltages: list[Sample] = []
        commands: list[tuple[int, float]] = []
        following: float | Point | None = None
        began, due = time.time_ns(), 0  # due: number of the reading that the next command is for

        def ahead() -> float:
            """Time [s] until the next reading is due."""
            return min(max(0.0, self._period - (time.time_ns() - readings[-1][1]) * 1e-9), self._period)

        def give(value: float | Point) -> None:
            limited = value.position if isinstance(value, Point) else value
            limited = max(-limits.voltage, min(limits.voltage, limited))
            if isinstance(value, Point):
                # The point is of the next reading. That of now is sent to a controller that looks at stamps.
                early = 0.0 if self._counts or not readings else ahead()
                velocity = value.velocity - value.acceleration * early
                at = began + round((due * self._period - early) * 1e9)
                here = limited - (value.velocity - 0.5 * value.acceleration * early) * early
                self._points.publish(encoded_point(here, velocity, value.acceleration, at))
            else:
                self._commands.publish(encoded(limited))
            commands.append((time.time_ns(), limited))

        def record() -> Record:
            return _paired(readings, voltages, commands, self._period, self._waits)

        give(next(course))
        while True:
            wait_set.clear_entities()
            wait_set.add_subscription(self._readings.handle)
            wait_set.add_subscription(self._voltages.handle)
            wait_set.wait(round(LOOK * 1e9))
            try:
                new, answers = self._look(watch)
            except Pause as pause:
                raise Pause(str(pause), record() if readings and voltages else None) from pause
            voltages += answers
            if new:
                if following is not None:
                    give(following)
                readings += new
                # A middleware that does not number has 0 for all.
                number = new[-1][0] - readings[0][0] or len(readings) - 1
                due = number + 1
                elapsed(number * self._period)
                try:
                    following = course.send(bench.Instant(due * self._period, new[-1][2]))
                except StopIteration:
                    if not voltages:
                        raise Fault(f"no voltage has come on {self._topics['valve_voltage']}") from None
                    return record()
            if following is not None and voltages and voltages[-1][1] >= readings[-1][1]:
                give(following)
                following = None

    def _look(self, watch: Watch) -> tuple[list[Sample], list[Sample]]:
        """New readings and voltages. Raises Fault at the first message that is not as it should be."""
        voltages, readings = self._taken(self._voltages), self._taken(self._readings)
        now = time.monotonic()
        for _, _, value in voltages:
            watch.voltage(value)
        for _, _, value in readings:
            watch.reading(value)
        for diagnosis in self._new_diagnoses():
            watch.diagnosis(diagnosis)
        for name, new in (("reading", readings), ("voltage", voltages)):
            if new:
                self._heard[name] = now
            elif now > self._heard[name] + SILENT:
                raise Fault(f"no {name} has come for {now - self._heard[name]:.1f} s")
        return readings, voltages

    @staticmethod
    def _taken(subscription: NumberSubscription) -> list[Sample]:
        return [(number_of(info), info["source_timestamp"], value) for value, info in subscription.take()]


def _paired(
    readings: list[Sample],
    voltages: list[Sample],
    commands: list[tuple[int, float]],
    period: float,
    waits: bool,
) -> Record:
    """Each reading with the voltage that acted until the next one, and the command of that voltage.

    A valve that ``waits`` for its voltage gives it the whole time between two readings, and its time goes on
    with its readings. Any other applies a voltage when it comes: the mean counts, and readings that were late
    do not.
    """
    numbers = np.array([number for number, _, _ in readings])
    index = numbers - numbers[0]
    if np.any(np.diff(index) <= 0):  # a middleware that does not number
        index = np.arange(len(readings))
    first = readings[0][1]
    sent = np.array([stamp - first for _, stamp, _ in readings]) * 1e-9
    answered = np.array([stamp - first for _, stamp, _ in voltages]) * 1e-9
    volts = np.array([value for _, _, value in voltages])
    latency = timing.latencies(sent, answered)
    delayed = np.zeros(len(index), dtype=np.bool_)
    if not waits:
        index, delayed = timing.placed(sent, index, period)
    count = int(index[-1]) + 1
    reading = np.full(count, np.nan)
    reading[index] = [value for _, _, value in readings]
    reading[index[delayed]] = np.nan
    known, at = index[~delayed], sent[~delayed]  # and beyond them by the period
    known, at = np.append(known, count), np.append(at, at[-1] + (count - known[-1]) * period)
    known, at = np.append(-1, known), np.append(at[0] - (known[0] + 1) * period, at)
    edges = np.interp(np.arange(count + 1), known, at)
    if waits:
        voltage = volts[np.maximum(np.searchsorted(answered, edges[1:], side="left") - 1, 0)]
    else:
        voltage = timing.means(edges, answered, volts)
    ordered = np.array([stamp - first for stamp, _ in commands]) * 1e-9
    wanted = np.array([value for _, value in commands])
    last = np.maximum(np.searchsorted(ordered, edges[:-1], side="right") - 1, 0)
    voltage_age, command_age = (
        edges[1:] - times[np.maximum(np.searchsorted(times, edges[1:], side="right") - 1, 0)]
        for times in (answered, ordered)
    )
    late = np.zeros(count, dtype=np.bool_)
    for age, (periods, least) in ((voltage_age, LATE_VOLTAGE), (command_age, LATE_COMMAND)):
        late |= age > max(periods * period, least)
    return Record(period, reading, voltage, wanted[last], latency=latency, late=late)


@contextmanager
def connected(name: str) -> Iterator[Controller]:
    """The running controller ``name``, in a ROS context of its own.

    Raises ParameterError if there is none.
    """
    try:
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy has no public type for a folder of logs that cannot be made
        raise ParameterError(first_line(error)) from error
    node = rclpy.create_node("commissioner")
    try:
        controller = Controller(node, name)
        try:
            controller.meet()
        except Fault as fault:
            raise ParameterError(str(fault)) from fault
        yield controller
        time.sleep(LAST_WORD)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
