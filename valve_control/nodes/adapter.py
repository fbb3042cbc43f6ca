"""What the nodes share: parameters from the table, polled subscriptions, start and clean end."""

from collections.abc import Callable, Iterator
from struct import pack, unpack_from
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.callback_groups import CallbackGroup
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64

from valve_control.parameters.build import as_text
from valve_control.parameters.table import (
    Parameter,
    ParameterError,
    Table,
    Value,
    Values,
    updated,
)

ENCODED = 12  # bytes of a Float64: four of head, of which the second is odd for little endian
SAMPLES = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
# For who has no use for a late one: no acknowledgements, no waiting for what is lost, any publisher matches.
NEWEST = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


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
    """Parameter value as the table has it: arrays as lists."""
    return value if isinstance(value, (bool, int, float, str)) else list(value)


class ParameterSet:
    """The table's parameters on a node: each set is checked as a whole, then applied as a whole.

    ``build`` makes the node's immutable parameters from all values or raises ParameterError; ``apply``
    takes them into use. Both run between two samples, since the node has one thread.
    """

    def __init__(
        self, node: Node, table: Table, build: Callable[[Values], Any], apply: Callable[[Values, Any], None]
    ) -> None:
        self._node = node
        self._table = table
        self._build = build
        self._apply = apply
        declared: dict[str, Value] = {}
        for parameter in table:
            try:
                got = node.declare_parameter(parameter.name, parameter.default, descriptor(parameter))
            except (InvalidParameterTypeException, InvalidParameterValueException) as error:
                override = node._parameter_overrides.get(parameter.name)
                value = getattr(override, "value", override)
                parameter.check(plain(value))
                raise ParameterError(f"{parameter.name} is {value!r}: {error}") from error
            declared[parameter.name] = plain(got.value)
        self.values = updated(table, {}, declared)
        self._prepared: tuple[Values, Any] | None = None
        apply(self.values, build(self.values))
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._use)

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
            self._prepared = (changes, self._build(changes))
        except ParameterError as error:
            self._node.get_logger().warning(f"parameters not changed: {error}")
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _use(self, parameters: list[Any]) -> None:
        values = self._changes(parameters)
        # Building costs a good part of a period: what the check built is used if it is of these values.
        if self._prepared is None or self._prepared[0] != values:
            self._prepared = (values, self._build(values))
        built = self._prepared[1]
        changed = [name for name in values if values[name] != self.values[name]]
        if not changed:
            return
        self.values = values
        self._apply(values, built)
        text = ", ".join(f"{name} = {as_text(values[name])}" for name in changed)
        self._node.get_logger().info(f"now {text}")


class Unwatched(CallbackGroup):
    """Callback group that the executor passes over; its subscriptions are polled instead."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Nothing was begun."""


class PolledSubscription:
    """Subscription that wakes nobody: messages wait until they are asked for.

    A command that arrives between two LVDT samples is of no use before the next one, and a wake-up of
    the executor costs more than the whole control law.
    """

    def __init__(self, node: Node, message_type: Any, topic: str, qos: QoSProfile, raw: bool = False) -> None:
        self._node = node
        self._type = message_type
        self._raw = raw  # messages as the bytes that came
        self._subscription = node.create_subscription(
            message_type, topic, lambda message: None, qos, callback_group=Unwatched(), raw=raw
        )

        self.handle = self._subscription.handle

    def one(self) -> tuple[Any, dict[str, Any]] | None:
        """The oldest waiting message with its message info, None if there is none."""
        with self.handle:
            return self.handle.take_message(self._type, self._raw)  # type: ignore[no-any-return]

    def take(self) -> Iterator[tuple[Any, dict[str, Any]]]:
        """Waiting messages, oldest first, each with its message info."""
        while (taken := self.one()) is not None:
            yield taken

    def destroy(self) -> None:
        """Leave the topic."""
        self._node.destroy_subscription(self._subscription)


class NumberSubscription(PolledSubscription):
    """Float64 messages as floats. A message object costs rclpy three times what their eight bytes cost."""

    def __init__(self, node: Node, topic: str, qos: QoSProfile) -> None:
        super().__init__(node, Float64, topic, qos, raw=True)

    def one(self) -> tuple[float, dict[str, Any]] | None:
        """The oldest waiting number with its message info, None if there is none."""
        while True:
            with self.handle:
                taken = self.handle.take_message(Float64, True)
            if taken is None:
                return None
            data, info = taken
            if len(data) >= ENCODED:
                form = "<d" if data[1] & 1 else ">d"
                return unpack_from(form, data, ENCODED - 8)[0], info


def encoded(number: float) -> bytes:
    """A Float64 message of ``number`` as it travels, for ``publish``."""
    return pack("<4Bd", 0, 1, 0, 0, number)


def diagnostics(node: Node, level: bytes, message: str, values: dict[str, Any]) -> DiagnosticArray:
    """One status of ``node`` with its values as text."""
    status = DiagnosticStatus(
        level=level,
        name=node.get_fully_qualified_name().lstrip("/"),
        hardware_id=node.get_namespace(),
        message=message,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )
    array = DiagnosticArray(status=[status])
    array.header.stamp = node.get_clock().now().to_msg()
    return array
