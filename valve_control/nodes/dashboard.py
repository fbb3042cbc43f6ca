# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node `dashboard`: a page in the browser, on this machine only, that shows and tunes all valves."""

import secrets
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.qos import QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from valve_control.control.parameters.table import DASHBOARD
from valve_control.dashboard.entry import Field
from valve_control.dashboard.machine import Answer, Machine
from valve_control.dashboard.valve import LAW, NodeState, Valve
from valve_control.inputs import expanded
from valve_control.nodes.adapter import (
    EVERYTHING,
    SAMPLES,
    NumberSubscription,
    ParameterSet,
    PointSubscription,
    PolledSubscription,
    number_of,
    plain,
)
from valve_control.nodes.loop import Failure, Worker, run
from valve_control.parameter import ParameterError, Values, number, word

POLL = 0.015  # s between two looks at what has come
LOOK = 0.25  # s between two looks at the graph
ACQUAINT = 0.5  # s that a server gets to see its new client
ANSWER = 3.0  # s for an answer, then the request is given up
# The loop must not wait for a page: no acknowledgements, and room for what comes while the page is busy.
WATCHED = QoSProfile(depth=4000, reliability=ReliabilityPolicy.BEST_EFFORT)
EVENTS = "/parameter_events"
NUMBER = "std_msgs/msg/Float64"
POINT = "trajectory_msgs/msg/JointTrajectoryPoint"
READINGS = {"spool_position": NUMBER, "valve_voltage": NUMBER}
AXIS = {
    "joint_states": "sensor_msgs/msg/JointState",
    "pressure_a": "sensor_msgs/msg/FluidPressure",
    "pressure_b": "sensor_msgs/msg/FluidPressure",
    "axis_goal": POINT,
}
MOST_JOINTS = 6  # of one message
BAR = 1e5  # Pa
# What publishes these is a valve's ...
PARTIES = {"valve_voltage": "controller", "spool_position": "simulator", "axis_goal": "upper"}
NEEDED = ("list_parameters", "describe_parameters", "get_parameters", "set_parameters_atomically")
# What a controller of this version has beside them, and what goes without it.
EXPECTED = {
    "change_state": "it cannot be stopped or activated from here",
    "save_parameters": "its parameters cannot be saved",
    "load_parameters": "no file can be loaded",
}
MUTE = 5.0  # s after which a node that does not tell its parameters is said not to
LIST, SAVE = "/list_parameters", "/save_parameters"
LEVELS = ("info", "warning", "error", "error")
KINDS = {1: "bool", 2: "integer", 3: "double", 4: "string", 8: "doubles", 9: "strings"}
TYPES = {
    "bool": Parameter.Type.BOOL,
    "integer": Parameter.Type.INTEGER,
    "double": Parameter.Type.DOUBLE,
    "string": Parameter.Type.STRING,
    "doubles": Parameter.Type.DOUBLE_ARRAY,
    "strings": Parameter.Type.STRING_ARRAY,
}
ONE_OF = "one of "  # before the choices in a descriptor's constraints
TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
}


def field(descriptor: Any) -> Field | None:
    """A parameter from its ROS descriptor, None for types that the page does not show."""
    kind = KINDS.get(descriptor.type)
    if kind is None:
        return None
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    limits = {"low": float(ranges[0].from_value), "high": float(ranges[0].to_value)} if ranges else {}
    constraints = descriptor.additional_constraints
    choices = tuple(constraints.removeprefix(ONE_OF).split(", ")) if constraints.startswith(ONE_OF) else ()
    return Field(
        descriptor.name,
        kind,
        descriptor.description,
        choices=choices,
        read_only=descriptor.read_only,
        **limits,
    )


class Pending(NamedTuple):
    """A request that waits for its answer."""

    future: Any  # of rclpy
    client: Any
    until: float  # s
    done: Callable[[Any], None]
    late: Callable[[], None]


class Remote:
    """The services of another node, with what it has told of its parameters."""

    def __init__(self, owner: "Dashboard", valve: Valve, state: NodeState) -> None:
        self.valve, self.state = valve, state
        self._owner = owner
        self._clients: dict[str, Any] = {}
        self._seen: float | None = None
        self._asking = False
        self._met = time.monotonic()
        self._events: list[Values] = []
        self.known = False

    def client(self, kind: Any, service: str) -> Any:
        """Client of one of the node's services."""
        if service not in self._clients:
            self._clients[service] = self._owner.create_client(kind, f"{self.state.name}/{service}")
        return self._clients[service]

    def ask(self, kind: Any, service: str, request: Any, done: Any, late: Any) -> None:
        """Send a request; ``done`` gets the answer, or ``late`` is called after a while without one."""
        client = self.client(kind, service)
        future = client.call_async(request)
        self._owner.pending.append(Pending(future, client, time.monotonic() + ANSWER, done, late))

    def learn(self, now: float) -> None:
        """Ask for names, descriptions and values, until they have come."""
        if self.known or self._asking:
            return
        kinds = (ListParameters, DescribeParameters, GetParameters, SetParametersAtomically)
        clients = [self.client(kind, name) for kind, name in zip(kinds, NEEDED, strict=True)]
        if not all(client.service_is_ready() for client in clients):
            self._seen = None
            self._told_nothing(now)
            return
        self._seen = now if self._seen is None else self._seen
        if now < self._seen + ACQUAINT:
            return
        self._asking = True

        def again() -> None:
            self._asking = False
            self._told_nothing(time.monotonic())

        def listed(answer: Any) -> None:
            names = list(answer.result.names)

            def described(answer: Any) -> None:
                fields = {f.name: f for f in map(field, answer.descriptors) if f is not None}

                def got(answer: Any) -> None:
                    values = {
                        name: plain(parameter_value_to_python(value))
                        for name, value in zip(names, answer.values, strict=False)
                        if name in fields
                    }
                    for event in self._events:
                        values.update({n: v for n, v in event.items() if n in values})
                    self.known, self._told = True, time.monotonic()
                    self.want("")
                    self._owner.learned(self, fields, values)

                self.ask(GetParameters, "get_parameters", GetParameters.Request(names=names), got, again)

            request = DescribeParameters.Request(names=names)
            self.ask(DescribeParameters, "describe_parameters", request, described, again)

        depth = ListParameters.Request.DEPTH_RECURSIVE
        self.ask(ListParameters, "list_parameters", ListParameters.Request(depth=depth), listed, again)

    def _told_nothing(self, now: float) -> None:
        """Say what is missing if the node has not told its parameters for a while."""
        if now < self._met + MUTE:
            return
        missing = [name for name in NEEDED if name not in self.state.services]
        why = f"it offers no service {' and no '.join(missing)}" if missing else "it does not answer"
        self.want(f"{self.state.name} has not told its parameters: {why}; it can be watched, not tuned")

    def want(self, text: str) -> None:
        """Say what the node lacks, once in the log."""
        with self._owner.machine.lock:
            if text != self.state.wanting:
                self.state.wanting = text
                self.state.version += 1
                if text:
                    self.valve.say(time.time(), "warning", text)

    def compare(self) -> None:
        """Say what a controller that has told its parameters lacks beside one of this version."""
        if (
            not self.known
            or self.state is not self.valve.controller
            or time.monotonic() < self._told + ACQUAINT
        ):
            return
        name, services = self.state.name, self.state.services
        lacks = [
            f"no {service} ({without})" for service, without in EXPECTED.items() if service not in services
        ]
        if LAW not in self.state.fields:
            lacks.insert(0, f"no parameter '{LAW}'")
        self.want(f"{name} is an older or another controller: it has {', '.join(lacks)}" if lacks else "")

    def event(self, declared: Values, changed: Values) -> None:
        """Take in what the node has published of its parameters.

        A node that declares what it is known to have was started anew: its values are asked for when the
        graph shows that, and are no change that somebody made.
        """
        if not self.known:
            self._events.append({**declared, **changed})
        elif changed:
            self._owner.machine.observed(self.valve, self.state, changed)

    def destroy(self) -> None:
        """Give its clients back."""
        for client in self._clients.values():
            self._owner.destroy_client(client)


def reached(subscriptions: Sequence[Any]) -> int:
    """How many of ``subscriptions``, as the graph shows them, a command reaches: of its type and quality."""
    return sum(
        info.topic_type == NUMBER
        and qos_check_compatible(SAMPLES, info.qos_profile)[0] != QoSCompatibility.ERROR
        for info in subscriptions
    )


class Watched:
    """The subscriptions to one valve's topics."""

    def __init__(self, node: "Dashboard", valve: Valve) -> None:
        self.valve = valve
        self._node = node
        base = valve.namespace.rstrip("/")
        self._numbers = {
            name: NumberSubscription(node, f"{base}/{name}", WATCHED)
            for name in ("spool_command", "spool_position", "valve_voltage")
        }
        self._points = PointSubscription(node, f"{base}/spool_trajectory", WATCHED)
        self._axis: dict[str, PolledSubscription] = {}
        self._states: PolledSubscription | None = None
        self._state_topic = ""
        self._last: dict[str, int] = {}
        self._prefix, self._labels = b"", ()  # of ~/state as it travels

    def watch_state(self, topic: str) -> None:
        """Read the controller's state from ``topic``."""
        if topic != self._state_topic:
            if self._states is not None:
                self._states.destroy()
            self._state_topic = topic
            self._states = PolledSubscription(self._node, Float64MultiArray, topic, WATCHED, raw=True)

    def watch_axis(self, name: str) -> None:
        """Read a topic of the axis that the valve moves."""
        if name not in self._axis:
            topic = f"{self.valve.namespace.rstrip('/')}/{name}"
            self._axis[name] = (
                PointSubscription(self._node, topic, WATCHED)
                if AXIS[name] == POINT
                else PolledSubscription(
                    self._node, JointState if name == "joint_states" else FluidPressure, topic, WATCHED
                )
            )

    def _moved(self) -> dict[str, list[tuple[int, float]]]:
        """What has come from the axis: times [ns] and values by the name of the signal."""
        came: dict[str, list[tuple[int, float]]] = {}
        for topic, subscription in self._axis.items():
            for message, info in subscription.take():
                for signal, value in _axis_values(topic, message):
                    came.setdefault(signal, []).append((info["source_timestamp"], value))
        return came

    def poll(self) -> None:
        """Hand on all that has come."""
        # Voltages first, commands last: what caused something is there when that is looked at.
        voltages, readings = self._taken("valve_voltage"), self._taken("spool_position")
        commands = self._taken("spool_command")
        points = [
            (info["source_timestamp"], p.positions[0]) for p, info in self._points.take() if p.positions
        ]
        moved = self._moved()
        with self._node.machine.lock:
            for name, data in moved.items():
                stamps, values = zip(*data, strict=True)
                self.valve.moved(name, 1e-9 * np.array(stamps, dtype=np.float64), np.array(values))
            for data, take in (
                (commands or points, self.valve.commanded),
                (readings, self.valve.read),
                (voltages, self.valve.answered),
            ):
                if data:
                    stamps, values = zip(*data, strict=True)
                    take(1e-9 * np.array(stamps, dtype=np.float64), np.array(values))
            self._poll_state()

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

    def _poll_state(self) -> None:
        if self._states is None:
            return
        rows: list[Any] = []
        stamps: list[int] = []
        for data, info in self._states.take():
            if not (self._prefix and data.startswith(self._prefix)):
                self._tell(rows, stamps)
                rows, stamps = [], []
                try:
                    message = deserialize_message(data, Float64MultiArray)
                except Exception:  # rclpy has no public type for bytes that are no message
                    continue
                labels = tuple(dim.label for dim in message.layout.dim)
                count = len(message.data)
                self.valve.unnamed = count > 0 and len(labels) != count
                if count == 0 or self.valve.unnamed or data[1] != 1:
                    continue
                row = np.array(message.data)
                at = data.rfind(row.tobytes())
                self._prefix, self._labels = (data[:at], labels) if at > 0 else (b"", ())
                if not self._prefix:
                    continue
            at = len(self._prefix)
            rows.append(np.frombuffer(data, "<f8", len(self._labels), at))
            stamps.append(info["source_timestamp"])
        self._tell(rows, stamps)

    def _tell(self, rows: list[Any], stamps: list[int]) -> None:
        if rows:
            self.valve.told(self._labels, 1e-9 * np.array(stamps, dtype=np.float64), np.array(rows))


def _axis_values(topic: str, message: Any) -> Iterator[tuple[str, float]]:
    """Signals of a message of the axis: positions in m, pressures in bar."""
    if topic == "joint_states":
        several = len(message.position) > 1
        for name, value in list(zip(message.name, message.position, strict=False))[:MOST_JOINTS]:
            yield (f"position of {name}" if several else "position"), value
    elif topic == "axis_goal":
        if message.positions:
            yield "goal", message.positions[0]
    else:
        yield topic, message.fluid_pressure / BAR


class Dashboard(Worker):
    """Watches all valves of the graph, hands the page's wishes to their nodes; the page runs in a thread."""

    def __init__(self) -> None:
        super().__init__("dashboard")
        self._values: Values = {}
        self.pending: list[Pending] = []
        self.machine = Machine(self)
        self._wishes: deque[Callable[[], None]] = deque()
        self._watched: dict[str, Watched] = {}
        self._remotes: dict[str, Remote] = {}
        self._lives: dict[str, set[bytes]] = {}
        self._server: Any = None
        ParameterSet(self, DASHBOARD, self._fixed, self._apply)
        self._events = PolledSubscription(self, ParameterEvent, EVENTS, EVERYTHING, raw=True)
        self._diagnostics = PolledSubscription(self, DiagnosticArray, "/diagnostics", EVERYTHING, raw=True)
        self._next = self._look_at = time.monotonic()
        self._serve()

    def _fixed(self, values: Values) -> None:
        if self._values and values != self._values:
            raise ParameterError("the parameters of a running dashboard do not change; start it again")

    def _apply(self, values: Values, built: None) -> None:
        self._values = values

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
        folder = expanded(word(self._values, "folder"), "folder").absolute()
        try:
            self._server = Server(self.machine, int(number(self._values, "port")), token, folder)
        except PortTaken as error:
            raise Failure(str(error)) from error
        self._server.start()
        self.get_logger().info(
            f"open {self._server.address}?token={token} to see and tune; without the token one may only look"
        )

    # Link: called by the page's thread

    def set_parameters(self, node: str, values: Values) -> "Future[str]":
        """Set all ``values`` of ``node`` or none; the reason of a refusal, "" if they are in force."""
        answer: Future[str] = Future()

        def act() -> None:
            remote = self._remotes.get(node)
            if remote is None:
                answer.set_result(f"{node} is not on the graph; nothing was changed")
                return
            fields = remote.state.fields
            messages = [
                Parameter(name, TYPES[fields[name].kind], value).to_parameter_msg()
                for name, value in values.items()
            ]
            remote.ask(
                SetParametersAtomically,
                "set_parameters_atomically",
                SetParametersAtomically.Request(parameters=messages),
                lambda got: answer.set_result(
                    "" if got.result.successful else got.result.reason or "refused without a reason"
                ),
                lambda: answer.set_result(f"{node} did not answer within {ANSWER:g} s; it may be gone"),
            )

        self._wishes.append(_guarded(act, answer, str))
        return answer

    def trigger(self, service: str) -> "Future[Answer]":
        """Call a service of type std_srvs/Trigger."""
        node, _, name = service.rpartition("/")
        return self._request(
            node, Trigger, name, Trigger.Request(), lambda got: Answer(got.success, got.message)
        )

    def transition(self, node: str, name: str) -> "Future[Answer]":
        """Lead a managed node through a transition such as activate."""
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[name]))
        return self._request(
            node,
            ChangeState,
            "change_state",
            request,
            lambda got: Answer(got.success, "" if got.success else f"{node} refused to {name}"),
        )

    def _request(self, node: str, kind: Any, name: str, request: Any, read: Any) -> "Future[Answer]":
        answer: Future[Answer] = Future()

        def act() -> None:
            remote = self._remotes.get(node)
            if remote is None or not remote.client(kind, name).service_is_ready():
                answer.set_result(Answer(False, f"{node} has no service {name}, or is gone"))
                return
            late = Answer(False, f"{node} did not answer within {ANSWER:g} s; it may be gone")
            remote.ask(
                kind, name, request, lambda got: answer.set_result(read(got)), lambda: answer.set_result(late)
            )

        self._wishes.append(_guarded(act, answer, lambda text: Answer(False, text)))
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
        self._take_events()
        self._take_diagnostics()
        for _ in range(len(self._wishes)):
            self._wishes.popleft()()
        self._settle(now)
        if now >= self._look_at:
            self._look_at = now + LOOK
            self._look(now)
        return False

    def _settle(self, now: float) -> None:
        """Hand on the answers that have come, and give up what is late."""
        waiting, self.pending = self.pending, []
        for request in waiting:
            if request.future.done():
                try:
                    answer = request.future.result()
                except Exception as error:  # of rclpy: an answer that cannot be read
                    self.get_logger().warning(str(error))
                    request.late()
                else:
                    request.done(answer)
            elif now > request.until:
                request.client.remove_pending_request(request.future)
                request.late()
            else:
                self.pending.append(request)

    def _take_events(self) -> None:
        for data, _ in self._events.take():
            try:
                event = deserialize_message(data, ParameterEvent)
            except Exception:  # rclpy has no public type for bytes that are no message
                continue
            remote = self._remotes.get(event.node)
            if remote is not None:
                remote.event(_values(event.new_parameters), _values(event.changed_parameters))

    def _take_diagnostics(self) -> None:
        for data, _ in self._diagnostics.take():
            try:
                array = deserialize_message(data, DiagnosticArray)
            except Exception:  # likewise
                continue
            for status in array.status:
                remote = self._remotes.get(f"/{status.name.lstrip('/')}")
                if remote is not None:
                    self._take_status(remote, status)

    def _take_status(self, remote: Remote, status: Any) -> None:
        valve = remote.valve
        figures = {entry.key: entry.value for entry in status.values}
        now = time.time()
        with self.machine.lock:
            if remote.state is valve.controller:
                resting = status.message if status.message in ("inactive", "unconfigured") else ""
                remote.state.state = resting or "active"
                mode = resting or figures.get("mode", "")
                level = LEVELS[min(status.level[0], 3)] if not resting else "warning"
                valve.status(level, mode, status.message, figures, now)
            else:
                remote.state.failing = LEVELS[min(status.level[0], 3)] == "error"
                if status.message != remote.state.state and (status.level[0] or remote.state.state):
                    valve.say(now, LEVELS[min(status.level[0], 3)], f"{remote.state.name}: {status.message}")
                remote.state.state = status.message

    # The graph

    def _look(self, now: float) -> None:
        """Find valves and their nodes, and see which nodes have come, gone or been started anew."""
        services = dict(self.get_service_names_and_types())
        nodes = {name.removesuffix(LIST) for name in services if name.endswith(LIST)}
        lives: dict[str, set[bytes]] = {}
        for info in self.get_publishers_info_by_topic(EVENTS):
            name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            if name in nodes:
                lives.setdefault(name, set()).add(bytes(info.endpoint_gid))
        for name in services:
            if name.endswith(SAVE) and name.removesuffix(SAVE) in nodes:
                node = name.removesuffix(SAVE)
                self._meet(node.rpartition("/")[0] or "/", node, "controller")
        moving = []
        for topic, types in self.get_topic_names_and_types():
            base, _, last = topic.rpartition("/")
            if READINGS.get(last) in types and self.count_publishers(topic):
                self._valve(base or "/")
            elif AXIS.get(last) in types and self.count_publishers(topic):
                moving.append((base or "/", last))
        for namespace, name in moving:
            if namespace in self._watched:
                self._watched[namespace].watch_axis(name)
        for namespace in self._watched:
            self._look_at_valve(namespace, nodes)
        for name, remote in list(self._remotes.items()):
            self._look_at_node(name, remote, lives.get(name, set()), services)
            self._remotes[name].learn(now)
            self._remotes[name].compare()

    def _look_at_valve(self, namespace: str, nodes: set[str]) -> None:
        base = namespace.rstrip("/")
        strangers = set()
        for topic, party in PARTIES.items():
            for info in self.get_publishers_info_by_topic(f"{base}/{topic}"):
                name = f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                if name in nodes:
                    self._meet(namespace, name, party)
                elif topic == "valve_voltage":
                    strangers.add(name)
        commanders = {
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for topic in ("spool_command", "spool_trajectory")
            for info in self.get_publishers_info_by_topic(f"{base}/{topic}")
        }
        heard = reached(self.get_subscriptions_info_by_topic(f"{base}/spool_command"))
        with self.machine.lock:
            valve = self._watched[namespace].valve
            valve.listeners = heard
            valve.commanders = sorted(commanders)
            valve.strangers = sorted(strangers)

    def _valve(self, namespace: str) -> Valve:
        valve = self.machine.valve(namespace)
        if namespace not in self._watched:
            self._watched[namespace] = Watched(self, valve)
            with self.machine.lock:
                valve.say(time.time(), "info", f"found in namespace {namespace}")
        return valve

    def _meet(self, namespace: str, name: str, party: str) -> None:
        """Get to know a node of a valve: its controller, its simulator, or the upper level of its axis."""
        valve = self._valve(namespace)
        if name in self._remotes or getattr(valve, party) is not None:
            return
        with self.machine.lock:
            state = NodeState(name)
            setattr(valve, party, state)
            if party == "controller":
                self._watched[namespace].watch_state(f"{name}/state")
        self._remotes[name] = Remote(self, valve, state)

    def _look_at_node(
        self, name: str, remote: Remote, alive: set[bytes], services: Mapping[str, Any]
    ) -> None:
        before = self._lives.get(name)
        state, valve, now = remote.state, remote.valve, time.time()
        self._lives[name] = alive if before is None else alive | (before if not alive else set())
        with self.machine.lock:
            state.services = frozenset(
                service.removeprefix(f"{name}/") for service in services if service.startswith(f"{name}/")
            )
            if state.present != bool(alive) and (alive or before):
                state.present = bool(alive)
                state.version += 1
                valve.say(now, "info" if alive else "error", f"{name} is {'back' if alive else 'gone'}")
            if before and alive - before:
                valve.say(now, "warning", f"{name} was started anew")
                valve.mark(now, f"{name} started anew")
                state.asking = True
                remote.destroy()
                self._remotes[name] = Remote(self, valve, state)

    def learned(self, remote: Remote, fields: dict[str, Field], values: Values) -> None:
        """Take in the parameters of a node."""
        valve, state = remote.valve, remote.state
        with self.machine.lock:
            state.answered(fields, values)
            now = time.time()
            valve.say(now, "info", f"{state.name} has {len(values)} parameters")
            if state.lost:
                names = ", ".join(sorted(state.lost))
                valve.say(now, "warning", f"{state.name} came back with other values of {names}")

    def finish(self) -> None:
        """End the page and the programs that it has started."""
        if self._server is not None:
            with suppress(RuntimeError):
                self._server.stop()


def _values(parameters: Sequence[Any]) -> Values:
    return {p.name: plain(parameter_value_to_python(p.value)) for p in parameters if p.value.type}


def _guarded(act: Callable[[], None], answer: Any, refused: Callable[[str], Any]) -> Callable[[], None]:
    """``act``, whose errors become the answer: whatever the page sends must not end the node."""

    def guarded() -> None:
        try:
            act()
        except Exception as error:
            answer.set_result(refused(f"{error}"))

    return guarded


def main() -> int:
    """Entry point of `ros2 run valve_control dashboard`."""
    return run(lambda: [Dashboard()])


if __name__ == "__main__":
    sys.exit(main())
