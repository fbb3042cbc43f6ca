# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node `dashboard`: a page in the browser, on this machine only, that shows and tunes all valves."""

import os
import secrets
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterEvent, ParameterType
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectoryPoint

from valve_control.control.parameters.table import DASHBOARD
from valve_control.dashboard.machine import RESTING, Answer, Machine
from valve_control.dashboard.valve import NodeState, Valve
from valve_control.nodes.adapter import (
    EVERYTHING,
    NumberSubscription,
    ParameterSet,
    PolledSubscription,
    number_of,
    plain,
)
from valve_control.nodes.loop import Failure, Worker, run
from valve_control.nodes.parameter_capture import EVENTS, Question, full_name, lives
from valve_control.parameter import Parameter, Value, Values, number, word

POLL = 0.015  # s between two looks at what has come
LOOK = 0.25  # s between two looks at the graph
ANSWER = 3.0  # s for an answer, then the request is given up
NANO = 1e-9
# The loop must not wait for a page: no acknowledgements, and room for what comes while the page is busy.
WATCHED = QoSProfile(depth=4000, reliability=ReliabilityPolicy.BEST_EFFORT)
NUMBER = "std_msgs/msg/Float64"
READINGS = {"spool_position": NUMBER, "valve_voltage": NUMBER}
AXIS = {
    "joint_states": ("sensor_msgs/msg/JointState", JointState),
    "pressure_a": ("sensor_msgs/msg/FluidPressure", FluidPressure),
    "pressure_b": ("sensor_msgs/msg/FluidPressure", FluidPressure),
    "axis_goal": ("trajectory_msgs/msg/JointTrajectoryPoint", JointTrajectoryPoint),
}
COMMANDS = ("spool_command", "spool_trajectory")
MOST_JOINTS = 6  # of one message
BAR = 1e5  # Pa
# A node that publishes one of these is, for the valve of this namespace, ...
PARTIES = {
    "valve_voltage": "controller",
    "spool_position": "simulator",
    "axis_goal": "upper",
    **dict.fromkeys(COMMANDS, "source"),
}
SAVE = "/save_parameters"
LEVELS = ("info", "warning", "error", "error")
DEFAULTS: dict[int, Value] = {
    ParameterType.PARAMETER_BOOL: False,
    ParameterType.PARAMETER_INTEGER: 0,
    ParameterType.PARAMETER_DOUBLE: 0.0,
    ParameterType.PARAMETER_STRING: "",
    ParameterType.PARAMETER_DOUBLE_ARRAY: [0.0],
    ParameterType.PARAMETER_STRING_ARRAY: [""],
}
ONE_OF = "one of "  # before the choices in a descriptor's constraints
TRANSITIONS = {
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
}


def field(descriptor: Any) -> Parameter | None:
    """A parameter from its ROS descriptor, None for what the page does not show."""
    if descriptor.type not in DEFAULTS or descriptor.read_only:
        return None
    result = Parameter(descriptor.name, DEFAULTS[descriptor.type], "", descriptor.description)
    for limits in (*descriptor.floating_point_range, *descriptor.integer_range):
        result = result._replace(low=float(limits.from_value), high=float(limits.to_value))
    constraints = descriptor.additional_constraints
    if constraints.startswith(ONE_OF):
        result = result._replace(choices=tuple(constraints.removeprefix(ONE_OF).split(", ")))
    return result


class Remote:
    """The services of another node, with what it has told of its parameters."""

    def __init__(self, owner: "Dashboard", valve: Valve, state: NodeState) -> None:
        self.valve, self.state = valve, state
        self._owner = owner
        self._clients: dict[str, Any] = {}
        self._question: Question | None = Question(owner, state.name, describe=True)  # None: answered
        self.client(SetParametersAtomically, "set_parameters_atomically")  # which takes a while to be ready

    def client(self, kind: Any, service: str) -> Any:
        """Client of one of the node's services."""
        if service not in self._clients:
            self._clients[service] = self._owner.create_client(kind, f"{self.state.name}/{service}")
        return self._clients[service]

    def learn(self) -> None:
        """Ask for names, descriptions and values, until they have come."""
        parameters = None if self._question is None else next(self._question.answer)
        if self._question is None or parameters is None:
            return
        fields = {f.name: f for f in map(field, self._question.descriptors) if f is not None}
        values = {name: value for name, value in _values(parameters).items() if name in fields}
        self._question.destroy()
        self._question = None
        self._owner.learned(self, fields, values)

    def event(self, event: ParameterEvent) -> None:
        """Take in what the node has published of its parameters.

        A node that declares what it is known to have was started anew: its values are asked for when the
        graph shows that, and are no change that somebody made.
        """
        if self._question is not None:
            self._question.events.append(event)
        elif changed := _values(event.changed_parameters):
            self._owner.machine.observed(self.valve, self.state, changed)

    def destroy(self) -> None:
        """Give its clients back."""
        if self._question is not None:
            self._question.destroy()
        for client in self._clients.values():
            self._owner.destroy_client(client)


class Watched:
    """The subscriptions to one valve's topics."""

    def __init__(self, node: "Dashboard", valve: Valve) -> None:
        self.valve = valve
        self._node = node
        self._base = valve.namespace.rstrip("/")
        self._numbers = {
            name: NumberSubscription(node, f"{self._base}/{name}", WATCHED)
            for name in ("spool_command", "spool_position", "valve_voltage")
        }
        self._points = PolledSubscription(
            node, JointTrajectoryPoint, f"{self._base}/spool_trajectory", WATCHED
        )
        self._axis: dict[str, PolledSubscription] = {}
        self._states: PolledSubscription | None = None
        self._last: dict[str, int] = {}

    def watch_state(self, topic: str) -> None:
        """Read the controller's state from ``topic``."""
        if self._states is not None:
            self._states.destroy()
        self._states = PolledSubscription(self._node, Float64MultiArray, topic, WATCHED)

    def watch_axis(self, name: str) -> None:
        """Read a topic of the axis that the valve moves."""
        if name not in self._axis:
            topic = f"{self._base}/{name}"
            self._axis[name] = PolledSubscription(self._node, AXIS[name][1], topic, WATCHED)

    def poll(self) -> None:
        """Hand on all that has come."""
        # Voltages first, commands last: what caused something is there when that is looked at.
        voltages, readings = self._taken("valve_voltage"), self._taken("spool_position")
        commands = self._taken("spool_command") or [
            (info["source_timestamp"], p.positions[0]) for p, info in self._points.take() if p.positions
        ]
        others: dict[str, list[tuple[int, float]]] = {}
        for name, stamp, value in (*self._terms(), *self._moved()):
            others.setdefault(name, []).append((stamp, value))
        with self._node.machine.lock:
            for name, data in {"command": commands, "position": readings, "voltage": voltages}.items():
                if data:
                    stamps, values = np.array(data, dtype=np.float64).T
                    if name == "position":
                        self.valve.read(NANO * stamps, values)
                    else:
                        self.valve.add(name, NANO * stamps, values)
            for name, data in others.items():
                stamps, values = np.array(data, dtype=np.float64).T
                self.valve.add(name, NANO * stamps, values)

    def _taken(self, name: str) -> list[tuple[int, float]]:
        taken = []
        last = self._last.get(name, 0)
        for value, info in self._numbers[name].take():
            sequence = number_of(info)
            # Numbers that jump far are those of another publisher.
            if 1 < sequence - last < 1000 and last:
                self.valve.missing += sequence - last - 1
            last = sequence
            taken.append((info["source_timestamp"], value))
        self._last[name] = last
        return taken

    def _terms(self) -> Iterator[tuple[str, int, float]]:
        """Name, stamp [ns] and value of each number of the controller's state that has a name."""
        for message, info in self._states.take() if self._states is not None else ():
            if len(message.layout.dim) == len(message.data):
                for dimension, value in zip(message.layout.dim, message.data, strict=True):
                    yield f"term.{dimension.label}", info["source_timestamp"], value

    def _moved(self) -> Iterator[tuple[str, int, float]]:
        """Name, stamp [ns] and value of each signal of the axis: positions in m, pressures in bar."""
        for topic, subscription in self._axis.items():
            for message, info in subscription.take():
                stamp = info["source_timestamp"]
                if topic == "axis_goal":
                    if message.positions:
                        yield "axis.goal", stamp, message.positions[0]
                    continue
                if topic != "joint_states":
                    yield f"axis.{topic}", stamp, message.fluid_pressure / BAR
                    continue
                several = len(message.position) > 1
                for name, value in list(zip(message.name, message.position, strict=False))[:MOST_JOINTS]:
                    yield f"axis.position of {name}" if several else "axis.position", stamp, value


class Dashboard(Worker):
    """Watches all valves of the graph, hands the page's wishes to their nodes; the page runs in a thread."""

    def __init__(self) -> None:
        super().__init__("dashboard")
        self.machine = Machine(self)
        self._wishes: deque[Iterator[None]] = deque()  # each is done, or goes on at the next poll
        self._watched: dict[str, Watched] = {}
        self._remotes: dict[str, Remote] = {}
        self._lives: dict[str, set[bytes]] = {}
        self._server: Any = None
        fixed = {parameter.name for parameter in DASHBOARD}
        self._values = ParameterSet(self, DASHBOARD, lambda values: None, fixed=fixed).values
        self._events = PolledSubscription(self, ParameterEvent, EVENTS, EVERYTHING)
        self._diagnostics = PolledSubscription(self, DiagnosticArray, "/diagnostics", EVERYTHING)
        self._next = self._look_at = time.monotonic()
        self._serve()

    def _serve(self) -> None:
        try:
            from valve_control.dashboard.server import PortTaken, Server
        except ModuleNotFoundError as error:
            if (error.name or "").startswith("valve_control"):
                raise
            raise Failure(
                f"the dashboard needs {error.name}, which is not installed: "
                "pip install 'valve_control[dashboard]'"
            ) from error
        token = word(self._values, "token") or secrets.token_urlsafe(9)
        folder = Path(os.path.expanduser(word(self._values, "folder"))).absolute()
        try:
            self._server = Server(self.machine, int(number(self._values, "port")), token, folder)
        except PortTaken as error:
            raise Failure(str(error)) from error
        self._server.start()
        self.get_logger().info(
            f"open {self._server.address}?token={token} to see and tune; without the token one may only look"
        )

    # Link: called by the page's thread

    def set_parameters(self, node: str, values: Values) -> "Future[Answer]":
        """Set all ``values`` of ``node`` or none."""
        messages = [RosParameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=messages)

        def read(answer: Any) -> Answer:
            return Answer(answer.result.successful, answer.result.reason or "refused without a reason")

        return self._request(node, SetParametersAtomically, "set_parameters_atomically", request, read)

    def trigger(self, node: str, service: str) -> "Future[Answer]":
        """Call a service of type std_srvs/Trigger."""
        return self._request(
            node, Trigger, service, Trigger.Request(), lambda a: Answer(a.success, a.message)
        )

    def transition(self, node: str, name: str) -> "Future[Answer]":
        """Lead a managed node through a transition such as activate."""
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[name]))
        refusal = f"{node} refused to {name}"
        return self._request(node, ChangeState, "change_state", request, lambda a: Answer(a.success, refusal))

    def _request(
        self, node: str, kind: Any, name: str, request: Any, read: Callable[[Any], Answer]
    ) -> "Future[Answer]":
        answer: Future[Answer] = Future()

        def act() -> Iterator[None]:
            remote = self._remotes.get(node)
            if remote is None or not remote.client(kind, name).service_is_ready():
                answer.set_result(Answer(False, f"{node} has no service {name}, or is gone", False))
                return
            client, until = remote.client(kind, name), time.monotonic() + ANSWER
            future = client.call_async(request)
            while not future.done():
                if time.monotonic() > until:
                    client.remove_pending_request(future)
                    late = f"{node} did not answer within {ANSWER:g} s; it may be gone"
                    answer.set_result(Answer(False, late, False))
                    return
                yield
            answer.set_result(read(future.result()))

        self._wishes.append(act())
        return answer

    # Work

    def due(self) -> float:
        """Time [s] of the next poll."""
        return self._next

    def work(self) -> bool:
        """Take in what has come, do what the page wants, now and then look at the graph."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + POLL
        if not self._server.running:
            raise Failure("the page's server has ended; its reason stands above")
        for watched in self._watched.values():
            watched.poll()
        for event, _ in self._events.take():
            if remote := self._remotes.get(event.node):
                remote.event(event)
        for remote in self._remotes.values():
            remote.learn()
        for array, _ in self._diagnostics.take():
            for status in array.status:
                remote = self._remotes.get(f"/{status.name.lstrip('/')}")
                if remote is not None:
                    self._take_status(remote, status)
        for _ in range(len(self._wishes)):
            wish = self._wishes.popleft()
            if next(wish, self) is not self:
                self._wishes.append(wish)
        if now >= self._look_at:
            self._look_at = now + LOOK
            self._look(now)
        return False

    def _take_status(self, remote: Remote, status: Any) -> None:
        valve, state, level = remote.valve, remote.state, LEVELS[min(status.level[0], 3)]
        now = time.time()
        with self.machine.lock:
            if state is valve.controller:
                figures = {entry.key: entry.value for entry in status.values}
                resting = next((s for s in RESTING if status.message.startswith(s)), "")
                state.state = resting or "active"
                mode = resting or figures.get("mode", "")
                valve.status("warning" if resting else level, mode, status.message, figures, now)
            else:
                state.failing = level == "error"
                if status.message != state.state and (status.level[0] or state.state):
                    valve.say(now, level, f"{state.name}: {status.message}")
                state.state = status.message

    # The graph

    def _look(self, now: float) -> None:
        """Find valves and their nodes, and see which nodes have come, gone or been started anew."""
        services = dict(self.get_service_names_and_types())
        nodes = lives(self)
        for name in services:
            node = name.removesuffix(SAVE)
            if name.endswith(SAVE) and node in nodes:
                self._meet(node.rpartition("/")[0] or "/", node, "controller")
        moving = []
        for topic, types in self.get_topic_names_and_types():
            base, _, last = topic.rpartition("/")
            if READINGS.get(last) in types and self.count_publishers(topic):
                self._valve(base or "/")
            elif last in AXIS and AXIS[last][0] in types and self.count_publishers(topic):
                moving.append((base or "/", last))
        for namespace, name in moving:
            if namespace in self._watched:
                self._watched[namespace].watch_axis(name)
        for namespace, watched in self._watched.items():
            publishers = {
                topic: [
                    full_name(i)
                    for i in self.get_publishers_info_by_topic(f"{namespace.rstrip('/')}/{topic}")
                ]
                for topic in PARTIES
            }
            for topic, party in PARTIES.items():
                for name in nodes.keys() & {*publishers[topic]}:
                    self._meet(namespace, name, party)
            watched.valve.commanders = sorted({name for topic in COMMANDS for name in publishers[topic]})
        for name, remote in list(self._remotes.items()):
            self._look_at_node(name, remote, nodes.get(name, set()), services)

    def _valve(self, namespace: str) -> Valve:
        valve = self.machine.valve(namespace)
        if namespace not in self._watched:
            self._watched[namespace] = Watched(self, valve)
            with self.machine.lock:
                valve.say(time.time(), "info", f"found in namespace {namespace}")
        return valve

    def _meet(self, namespace: str, name: str, party: str) -> None:
        """Get to know a node of a valve."""
        valve = self._valve(namespace)
        if name in self._remotes or (party in valve.nodes and valve.nodes[party].present):
            return
        state = NodeState(name)
        with self.machine.lock:
            valve.nodes[party] = state
        if party == "controller":
            self._watched[namespace].watch_state(f"{name}/state")
        self._remotes[name] = Remote(self, valve, state)

    def _look_at_node(self, name: str, remote: Remote, alive: set[bytes], services: Iterable[str]) -> None:
        before = self._lives.get(name)
        state, valve, now = remote.state, remote.valve, time.time()
        self._lives[name] = alive if before is None else alive | (before if not alive else set())
        with self.machine.lock:
            state.services = frozenset(
                service.removeprefix(f"{name}/") for service in services if service.startswith(f"{name}/")
            )
            if state.present != bool(alive) and (alive or before):
                state.present = bool(alive)
                valve.say(now, "info" if alive else "error", f"{name} is {'back' if alive else 'gone'}")
            if before and alive - before:
                valve.say(now, "warning", f"{name} was started anew")
                valve.mark(now, f"{name} started anew")
                state.asking = True
                remote.destroy()
                self._remotes[name] = Remote(self, valve, state)

    def learned(self, remote: Remote, fields: Mapping[str, Parameter], values: Values) -> None:
        """Take in the parameters of a node."""
        with self.machine.lock:
            remote.state.answered(fields, values)
            remote.valve.say(time.time(), "info", f"{remote.state.name} has {len(values)} parameters")

    def finish(self) -> None:
        """End the page and the recorder that it has started."""
        if self._server is not None:
            with suppress(RuntimeError):
                self._server.stop()


def _values(parameters: Sequence[Any]) -> Values:
    return {p.name: plain(parameter_value_to_python(p.value)) for p in parameters if p.value.type}


def main() -> int:
    """Entry point of `ros2 run valve_control dashboard`."""
    return run(lambda: [Dashboard()])


if __name__ == "__main__":
    sys.exit(main())
