# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Holds what the nodes share: parameters from the table, polled subscriptions, messages, diagnostics."""

import contextlib
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from struct import pack, unpack_from
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterNotDeclaredException,
)
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.utilities import get_rmw_implementation_identifier
from std_msgs.msg import Float64, Float64MultiArray

from valve_control import outputs
from valve_control.control.parameters import arguments
from valve_control.control.parameters.ros_file import from_text
from valve_control.nodes import realtime
from valve_control.nodes.rclpy_internals import override
from valve_control.nodes.services import Unwatched
from valve_control.parameter import Parameter, ParameterError, Table, Value, Values, missing, updated

PROCESS = 12  # bytes of an endpoint's address in DDS that all endpoints of a process have in common
UNNUMBERED = 2**64 - 1  # in rmw's message info, of a middleware that numbers no messages, such as Cyclone DDS
UNKNOWN = "this middleware numbers no messages: losses are unknown"
ENCODED = 12  # bytes of a Float64: four of head, of which the second is odd for little endian
SAMPLES = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# For who has no use for a late one: no acknowledgements, no waiting for what is lost, any publisher matches.
NEWEST = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)

# For who keeps every message, and fetches them now and then.
EVERYTHING = QoSProfile(depth=50000, reliability=ReliabilityPolicy.RELIABLE)


def descriptor(parameter: Parameter) -> ParameterDescriptor:
    """ROS descriptor: text with unit, finite range, choices."""
    unit = f" [{parameter.unit}]" if parameter.unit not in ("", "-") else ""
    result = ParameterDescriptor(description=parameter.text + unit)
    if parameter.choices:
        result.additional_constraints = "one of " + ", ".join(parameter.choices)
    if isinstance(parameter.default, float):
        result.floating_point_range = [
            FloatingPointRange(from_value=parameter.low, to_value=parameter.high, step=0.0)
        ]
    elif isinstance(parameter.default, int) and not isinstance(parameter.default, bool):
        result.integer_range = [
            IntegerRange(from_value=int(parameter.low), to_value=int(parameter.high), step=0)
        ]
    return result


def plain(value: Any) -> Any:
    """Parameter value in the types of the table: arrays as lists."""
    return value if isinstance(value, (bool, int, float, str)) else list(value)


def with_numbers(table: Table, parameters: Sequence[Any]) -> list[Any]:
    """``parameters`` that a client sent, with the numbers that came as words.

    `ros2 param set` and `ros2 param load` read 1e-05 as YAML 1.1 does, which wants a point in a number.
    """
    known = {parameter.name: parameter for parameter in table}
    made = list(parameters)
    for i, sent in enumerate(parameters):
        parameter = known.get(sent.name)
        if parameter and isinstance(sent.value, str) and isinstance(parameter.default, (float, list)):
            with contextlib.suppress(ParameterError):  # what is no number stays the word, which ROS refuses
                made[i] = RosParameter(sent.name, value=from_text(parameter, sent.value))
    return made


def admit(node: Node, nodes: Mapping[str, Table]) -> None:
    """Check the command line for the process's ``nodes`` (tables by full name); ``node`` logs the warnings.

    Raises ParameterError.
    """
    for warning in arguments.check(sys.argv[1:], nodes):
        node.get_logger().warning(warning)


def has_override(name: str, parameter: str, remap: list[str] | None = None) -> bool:
    """Whether the command line gives a ``parameter`` to the node ``name``, before this node exists."""
    probe = Node(name, cli_args=remap, enable_rosout=False, start_parameter_services=False)
    try:
        return override(probe, parameter) is not None
    finally:
        probe.destroy_node()


def _declared(node: Node, parameter: Parameter) -> Value:
    """Declare a parameter on ``node``; returns its value. Raises ParameterError."""
    try:
        got = node.declare_parameter(parameter.name, parameter.default, descriptor(parameter))
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        given = override(node, parameter.name)
        value = plain(getattr(given, "value", given))
        parameter.check(value)
        raise ParameterError(f"{parameter.name} is {value!r}: {error}") from error
    return plain(got.value)  # type: ignore[no-any-return]


class ParameterSet:
    """The table's parameters on a node: each change is checked as a whole, then applied as a whole.

    ``build`` makes the node's immutable parameters from all values or raises ParameterError; ``apply``
    takes them into use. Both run between two samples, since the node has one thread. ``alone``: whether the
    process has no other node; otherwise its maker calls ``admit`` for all of them. ``fixed``: parameters that
    do not change while the node runs. Parameters of the scheduler, if the table has them, need nothing else.
    """

    def __init__(
        self,
        node: Node,
        table: Table,
        build: Callable[[Values], Any],
        apply: Callable[[Values, Any], None] = lambda values, built: None,
        alone: bool = True,
        fixed: Collection[str] = (),
    ) -> None:
        if alone:
            admit(node, {node.get_fully_qualified_name(): table})
        self._node = node
        self._table = table
        self._build = build
        self._apply = apply
        self._fixed = fixed
        self._realtime = realtime.UNCHANGED
        self.values = updated(table, {}, {parameter.name: _declared(node, parameter) for parameter in table})
        self._prepared = (self.values, self._made(self.values))
        self._take()
        node.add_pre_set_parameters_callback(self._known)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._use)

    def _made(self, values: Values) -> Any:
        realtime.request(values)
        return self._build(values)

    def _take(self) -> None:
        self.values, self.built = self._prepared
        self._apply(self.values, self.built)
        wanted = realtime.request(self.values)
        if wanted != self._realtime:
            self._realtime = wanted
            realtime.obtain(wanted, self._node.get_logger().warning)

    def _known(self, parameters: list[Any]) -> list[Any]:
        unknown = [p.name for p in parameters if not self._node.has_parameter(p.name)]
        if unknown:
            error = ParameterNotDeclaredException(unknown)
            error.args = (missing(self._table, unknown),)  # rclpy's own text leaves out the first
            raise error
        return with_numbers(self._table, parameters)

    def _changes(self, parameters: list[Any]) -> Values:
        names = {p.name for p in self._table}
        return updated(
            self._table,
            self.values,
            {p.name: plain(p.value) for p in parameters if p.name in names},
        )

    def _check(self, parameters: list[Any]) -> SetParametersResult:
        try:
            changes = self._changes(parameters)
            for name in self._fixed:
                if changes[name] != self.values[name]:
                    raise ParameterError(f"{name} of a running node does not change; start it again")
            self._prepared = (changes, self._made(changes))
        except ParameterError as error:
            reason = outputs.printable(str(error))
            self._node.get_logger().warning(f"parameters not changed: {reason}")
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)

    def _use(self, parameters: list[Any]) -> None:
        values = self._changes(parameters)
        # Building costs a good part of a period: what the check built is used if it is of these values.
        if self._prepared[0] != values:
            self._prepared = (values, self._made(values))
        if values != self.values:
            self._take()


def number_of(info: Mapping[str, Any]) -> int:
    """Number that its publisher gave a message, 0 if the middleware numbers none."""
    number = info["publication_sequence_number"]
    return 0 if number == UNNUMBERED else number


def needs_numbers(what: str) -> str:
    """One sentence: why ``what`` does not work here."""
    middleware = get_rmw_implementation_identifier()
    return (
        f"{what} needs a middleware that numbers messages, and {middleware} does not; "
        "set RMW_IMPLEMENTATION=rmw_fastrtps_cpp"
    )


class PolledSubscription:
    """Subscription without callback: messages wait until the node asks for them.

    A command that arrives between two LVDT samples is of no use before the next one, and a wake-up of
    the executor costs more than the whole control law. Bytes that are no message are passed over.
    """

    def __init__(self, node: Node, message_type: Any, topic: str, qos: QoSProfile, raw: bool = False) -> None:
        self._node = node
        self._type = message_type
        self._raw = raw  # whether messages stay the bytes that came
        self._depth = qos.depth
        self._subscription = node.create_subscription(
            message_type, topic, lambda message: None, qos, callback_group=Unwatched(), raw=True
        )
        self.handle = self._subscription.handle

    def one(self) -> tuple[Any, dict[str, Any]] | None:
        """The oldest waiting message with its message info, None if there is none."""
        while True:
            with self.handle:
                taken: tuple[Any, dict[str, Any]] | None = self.handle.take_message(self._type, True)
            if taken is None or self._raw:
                return taken
            with contextlib.suppress(Exception):  # rclpy has no public type for bytes that are no message
                return deserialize_message(taken[0], self._type), taken[1]

    def take(self) -> Iterator[tuple[Any, dict[str, Any]]]:
        """Waiting messages, oldest first, each with its message info; at most as many as can wait at once.

        More come while these are worked on. Where they come faster, others have their turn nevertheless: a
        signal to end, a service, another valve of the process.
        """
        for _ in range(self._depth):
            taken = self.one()
            if taken is None:
                return
            yield taken

    def destroy(self) -> None:
        """End the subscription."""
        self._node.destroy_subscription(self._subscription)


class NumberSubscription(PolledSubscription):
    """Subscription of Float64 as floats; rclpy's message object would take three times as long to make."""

    def __init__(self, node: Node, topic: str, qos: QoSProfile) -> None:
        super().__init__(node, Float64, topic, qos, raw=True)

    def one(self) -> tuple[float, dict[str, Any]] | None:
        """The oldest waiting number with its message info, None if there is none."""
        while taken := super().one():
            data, info = taken
            if len(data) >= ENCODED:
                form = "<d" if data[1] & 1 else ">d"
                return unpack_from(form, data, ENCODED - 8)[0], info
        return None


def encoded_point(position: float, velocity: float, acceleration: float, time: int = 0) -> bytes:
    """A JointTrajectoryPoint of one joint as it travels; ``time`` [ns]: time_from_start."""
    numbers = 1, position, 1, velocity, 1, acceleration
    return pack("<4BI4xdI4xdI4xdIiI", 0, 1, 0, 0, *numbers, 0, *divmod(time, 10**9))


def encoded(number: float) -> bytes:
    """A Float64 message of ``number`` as serialized bytes, for ``publish``."""
    return pack("<4Bd", 0, 1, 0, 0, number)


def head(message: Float64MultiArray, count: int) -> bytes:
    """Bytes before the numbers in a serialized ``message`` that ends with ``count`` of them."""
    message.data = [0.0] * count
    serialized: bytes = serialize_message(message)
    return serialized[: len(serialized) - 8 * count]


def acquainted(node: Node, publisher: Any, topic: str) -> bool:
    """Whether each process that publishes on ``topic`` has discovered ``publisher``, and so will hear it.

    A publisher sends nothing to subscriptions that it does not know yet, though they may know it.
    """
    listening = node.get_subscriptions_info_by_topic(publisher.topic_name)
    processes = {bytes(info.endpoint_gid[:PROCESS]) for info in listening}
    others = node.get_publishers_info_by_topic(topic)
    return (
        len(others) > 0
        and all(bytes(info.endpoint_gid[:PROCESS]) in processes for info in others)
        and publisher.get_subscription_count() >= len(listening)
    )


class Diagnostics:
    """Publishes what a node says of itself on /diagnostics, in pieces between two readings.

    ``diagnose`` is called once a second. All at once it takes 5 to 12 ms of a virtual core whose caches have
    forgotten it since the last second.
    """

    def __init__(self, node: Any, diagnose: Callable[[], None] | None = None) -> None:
        self._node = node
        self.publisher = node.create_publisher(DiagnosticArray, "/diagnostics", SAMPLES)
        if diagnose is not None:
            node.create_timer(1.0, diagnose, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def tell(self, level: bytes, message: str, values: dict[str, Any], *later: Callable[[], Any]) -> None:
        """Publish a status with ``values`` and those of each of ``later``, which is a piece of its own.

        A managed node that does not work says that instead of ``level`` and ``message``.
        """
        if not getattr(self._node, "working", True):
            level, message = DiagnosticStatus.OK, "inactive" if self._node.configured else "unconfigured"
            if self._node.halted and self._node.configured:
                level, message = DiagnosticStatus.ERROR, f"inactive: {self._node.halted}"
        stamp = self._node.get_clock().now().to_msg()

        def pieces() -> Iterator[None]:
            for part in later:
                values.update(part())
                yield
            status = DiagnosticStatus(
                level=level,
                name=self._node.get_fully_qualified_name().lstrip("/"),
                hardware_id=self._node.get_namespace(),
                message=message,
                values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
            )
            array = DiagnosticArray(status=[status])
            array.header.stamp = stamp
            yield
            self.publisher.publish(array)
            yield

        self._node.later(pieces())
