# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Asks other nodes for all their parameters, once each, and follows their changes."""

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterEvent, ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message

EVENTS = "/parameter_events"
LIST = "/list_parameters"
ASK_AGAIN = 3.0  # s; a server that has not yet seen its client does not answer
# The middleware holds up a server by 0.1 s for each answer to a client that it has not yet seen, and with it
# a running control loop: a server that we have just seen gets this long to see us.
ACQUAINT = 1.0  # s


def full_name(info: Any) -> str:
    """Full name of the node of an endpoint of the graph."""
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def lives(node: Node) -> dict[str, set[bytes]]:
    """All nodes with parameters, each with its publishers of events, which are new ones after a restart."""
    found: dict[str, set[bytes]] = {
        name.removesuffix(LIST): set()
        for name, types in node.get_service_names_and_types()
        if name.endswith(LIST) and "rcl_interfaces/srv/ListParameters" in types
    }
    for info in node.get_publishers_info_by_topic(EVENTS):
        if full_name(info) in found:
            found[full_name(info)].add(bytes(info.endpoint_gid))
    return found


class Question:
    """Asks one node for all its parameters: their names, if wanted their descriptors, then their values."""

    def __init__(self, node: Node, name: str, describe: bool = False) -> None:
        self._node = node
        kinds = (ListParameters, GetParameters, *((DescribeParameters,) if describe else ()))
        services = ("list_parameters", "get_parameters", "describe_parameters")
        self._clients = {
            kind: node.create_client(kind, f"{name}/{service}")
            for kind, service in zip(kinds, services, strict=False)
        }
        self.descriptors: Sequence[Any] = ()
        self._missed_at = time.monotonic()  # s, when one of the servers was not there
        self.answer = self._parameters()  # at each step None, or the parameters once they have come
        self.events: list[ParameterEvent] = []  # changes since the beginning

    def _parameters(self) -> Iterator[list[Parameter] | None]:
        depth = ListParameters.Request.DEPTH_RECURSIVE
        listed = yield from self._answered(ListParameters, depth=depth)
        names = listed.result.names
        if DescribeParameters in self._clients:
            self.descriptors = (yield from self._answered(DescribeParameters, names=names)).descriptors
        got = yield from self._answered(GetParameters, names=names)
        values = {
            name: Parameter(name=name, value=value)
            for name, value in zip(names, got.values, strict=False)
            if value.type != ParameterType.PARAMETER_NOT_SET
        }
        # What changed while the answer was on its way is newer, or the same.
        for event in self.events:
            for parameter in (*event.new_parameters, *event.changed_parameters):
                values[parameter.name] = parameter
            for parameter in event.deleted_parameters:
                values.pop(parameter.name, None)
        yield list(values.values())

    def _answered(self, kind: Any, **fields: Any) -> Generator[None, None, Any]:
        client, future, ask_at = self._clients[kind], None, 0.0
        while future is None or not future.done():
            now = time.monotonic()
            if not all(one.service_is_ready() for one in self._clients.values()):
                self._missed_at = now
            if now >= max(ask_at, self._missed_at + ACQUAINT):
                if future is not None:
                    client.remove_pending_request(future)
                future, ask_at = client.call_async(kind.Request(**fields)), now + ASK_AGAIN
            yield
        return future.result()

    def destroy(self) -> None:
        """Stop asking."""
        for client in self._clients.values():
            self._node.destroy_client(client)


class ParameterCapture:
    """Passes each node's parameters to ``write`` as one serialized ParameterEvent."""

    def __init__(self, node: Node, write: Callable[[bytes], None]) -> None:
        self._node = node
        self._write = write
        self._lives: dict[str, set[bytes]] = {}  # by node: its publishers of events, new ones after a restart
        self._questions: dict[str, Question] = {}

    def look(self) -> None:
        """Look which nodes have come and gone."""
        present = lives(self._node)
        present.pop(self._node.get_fully_qualified_name(), None)
        for name in self._lives.keys() - present.keys():
            self._forget(name)
        for name, publishers in present.items():
            before = self._lives.get(name)
            if before is None or (before and publishers - before):
                self._forget(name)
                self._questions[name] = Question(self._node, name)
        self._lives = present

    def _forget(self, name: str) -> None:
        if question := self._questions.pop(name, None):
            question.destroy()

    def collect(self) -> None:
        """Write the answers that have come."""
        for name, question in list(self._questions.items()):
            parameters = next(question.answer)
            if parameters is None:
                continue
            question.destroy()
            del self._questions[name]
            written = ParameterEvent(node=name, new_parameters=parameters)
            written.stamp = self._node.get_clock().now().to_msg()
            self._write(serialize_message(written))
            self._node.get_logger().info(f"has the {len(parameters)} parameters of {name}")

    def unanswered(self) -> list[str]:
        """Nodes that have not answered."""
        return sorted(self._questions)

    def observe(self, data: bytes) -> None:
        """Take in a ParameterEvent that was received, serialized."""
        try:
            event = deserialize_message(data, ParameterEvent)
        except Exception:  # rclpy has no public type for bytes that are no message
            return
        if event.node in self._questions:
            self._questions[event.node].events.append(event)
