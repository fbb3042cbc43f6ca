# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of runs whose every input is known: a supervised controller on a simulated valve."""

import math
import struct
from typing import NamedTuple

import changed
import numpy as np
from rosbags.typesys import Stores, get_typestore

from valve_control.control.parameters import build
from valve_control.control.parameters.table import CONTROLLER, VALVE
from valve_control.control.plant import valve
from valve_control.control.supervision.command_course import Motion
from valve_control.control.supervision.journal import Journal
from valve_control.control.supervision.state_snapshot import snapshot
from valve_control.control.supervision.supervisor import Supervisor
from valve_control.parameter import defaults, updated
from valve_control.recordings.bags.writer import BagWriter

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
FLOAT = "std_msgs/msg/Float64"
ARRAY = "std_msgs/msg/Float64MultiArray"
STRING = "std_msgs/msg/String"
POINT = "trajectory_msgs/msg/JointTrajectoryPoint"
STATUS = "diagnostic_msgs/msg/DiagnosticArray"
EVENT = "rcl_interfaces/msg/ParameterEvent"
BEGIN = 1_790_000_000_000_000_000  # ns
PERIOD = 1_000_000  # ns


class Message(NamedTuple):
    topic: str
    type: str
    time: int  # source, ns
    sequence: int
    data: bytes
    log_time: int


def number(value):
    return b"\0\1\0\0" + struct.pack("<d", value)


def parameter(name, value):
    kinds = {
        bool: (1, "bool_value"),
        int: (2, "integer_value"),
        float: (3, "double_value"),
        str: (4, "string_value"),
    }
    fields = {
        "type": 0, "bool_value": False, "integer_value": 0, "double_value": 0.0, "string_value": "",
        "byte_array_value": np.array([], dtype=np.uint8), "bool_array_value": np.array([], dtype=bool),
        "integer_array_value": np.array([], dtype=np.int64), "double_array_value": np.array([]),
        "string_array_value": [],
    }  # fmt: skip
    if isinstance(value, list) and all(isinstance(entry, str) for entry in value):
        fields["type"], fields["string_array_value"] = 9, value
    elif isinstance(value, list):
        fields["type"], fields["double_array_value"] = 8, np.array(value)
    else:
        fields["type"], field = kinds[type(value)]
        fields[field] = value
    return T["rcl_interfaces/msg/Parameter"](name, T["rcl_interfaces/msg/ParameterValue"](**fields))


def event(node, values, new=False):
    listed = [parameter(name, value) for name, value in values.items()]
    stamp = T["builtin_interfaces/msg/Time"](0, 0)
    message = T[EVENT](stamp, node, listed if new else [], [] if new else listed, [])
    return bytes(STORE.serialize_cdr(message, EVENT))


def string(text):
    return bytes(STORE.serialize_cdr(T[STRING](text), STRING))


def array(values, labels=()):
    dim = [T["std_msgs/msg/MultiArrayDimension"](label, 1, 1) for label in labels]
    layout = T["std_msgs/msg/MultiArrayLayout"](dim, 0)
    return bytes(STORE.serialize_cdr(T[ARRAY](layout, np.array(values)), ARRAY))


def trajectory_point(position, velocity, acceleration):
    """A point of one joint."""
    numbers = [np.array([value]) for value in (position, velocity, acceleration)]
    duration = T["builtin_interfaces/msg/Duration"](0, 0)
    return bytes(STORE.serialize_cdr(T[POINT](*numbers, np.array([]), duration), POINT))


def diagnostic(name, level, text, **values):
    """A status as a node of the package says it."""
    pairs = [T["diagnostic_msgs/msg/KeyValue"](key, str(value)) for key, value in values.items()]
    status = T["diagnostic_msgs/msg/DiagnosticStatus"](level, name.lstrip("/"), text, "", pairs)
    header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](0, 0), "")
    return bytes(STORE.serialize_cdr(T[STATUS](header, [status]), STATUS))


class Run:
    """A controller on a valve, from ``begin`` [ns] on."""

    def __init__(
        self,
        seed=1,
        namespace="",
        controller=None,
        simulator=None,
        memory_every=100,
        begin=BEGIN,
        stamped=False,
    ):  # fmt: skip
        self.memory_every, self.stamped = memory_every, stamped
        self.remembered = -(10**9)
        self.random = np.random.default_rng(seed)
        self.namespace = namespace
        self.values = updated(CONTROLLER, defaults(CONTROLLER), controller or {})
        self.valve_values = updated(VALVE, defaults(VALVE), {"lvdt.noise": 0.004, **(simulator or {})})
        self.time = self.clock = self.answered = begin
        self.journal = Journal(lambda: self.clock)
        self.supervisor = Supervisor(self.journal.note)
        self.supervisor.apply(self.values, build.law_params(self.values))
        self.plant = build.valve_params(self.valve_values)
        self.spool = valve.initial(self.plant)
        self.counts = {"spool_command": 0, "spool_position": 0, "valve_voltage": 0}
        self.sent = 0  # points of trajectories
        self._messages = []
        self.voltages = []
        self.readings = []
        self.say(f"{namespace}/controller", self.values, new=True)
        self.say(f"{namespace}/valve_simulator", self.valve_values, new=True)
        self.flush()

    def say(self, node, values, new=False):
        time = self.clock + 20_000
        self._messages.append(
            Message("/parameter_events", EVENT, time, 0, event(node, values, new), time + 200_000)
        )

    def put(self, part, time, value, lost=False):
        self.counts[part] += 1
        if not lost:
            log = time + int(self.random.integers(50_000, 400_000))
            name = f"{self.namespace}/{part}"
            self._messages.append(Message(name, FLOAT, time, self.counts[part], number(value), log))

    def change(self, **values):
        """A live change of parameters between two samples."""
        new = changed.dotted(values)
        if updated(CONTROLLER, self.values, new) == self.values:
            return
        self.values = updated(CONTROLLER, self.values, new)
        self.clock = max(self.time + PERIOD // 2 - 20_000, self.clock + 40_000)
        self.supervisor.apply(self.values, build.law_params(self.values))
        self.flush()
        self.say(f"{self.namespace}/controller", new)

    def times(self, stamp, kind="command"):
        """Time stamp [s] of a message, if its middleware has one, and time [s] since the last reading."""
        if not self.stamped:
            return math.nan, 0.0
        return self.journal.seconds(kind, stamp), (stamp - self.answered) * 1e-9

    def point(self, position, velocity=0.0, acceleration=0.0, ago=0):
        """A point of a trajectory for the next sample, or, with a tuple, one with other counts of entries."""
        self.clock += 1_000
        if isinstance(position, tuple):
            self.supervisor.trajectory_refused(len(position), velocity, acceleration)
        else:
            time = self.time + PERIOD - 300_000 - ago
            motion = Motion(position, velocity, acceleration)
            self.supervisor.trajectory(motion, *self.times(time, "trajectory"))
            self.sent += 1
            name = f"{self.namespace}/spool_trajectory"
            data = trajectory_point(position, velocity, acceleration)
            self._messages.append(Message(name, POINT, time, self.sent, data, max(time, self.time) + 90_000))

    def sample(self, command=None, late=False, lost=False, before=None):
        """One sample: reading, then (unless ``lost`` on its way to the controller) voltage.

        ``command`` is sent before the reading, or, ``late``, after the controller took its commands, so that
        it counts one sample later; ``before`` is called on the supervisor first.
        """
        self.time += PERIOD * max(1, -(-(self.clock + 300_000 - self.time) // PERIOD))
        self.clock = self.time - 250_000
        if before is not None:
            before(self.supervisor)
        if command is not None and not late:
            self.put("spool_command", self.time - 300_000, command)
            self.supervisor.command(command, *self.times(self.time - 300_000))
        reading = valve.read(self.plant, self.spool, float(self.random.standard_normal()))
        self.put("spool_position", self.time, reading)
        self.readings.append(reading)
        answered = self.time + int(self.random.integers(120_000, 250_000))
        if command is not None and late:
            self.put("spool_command", answered - 10_000, command)
        self.clock = answered - 5_000
        if not lost:
            elapsed, number = (self.time - self.answered) * 1e-9, self.counts["spool_position"]
            self.answered = self.time
            self.answer(answered, lambda: self.supervisor.sample(reading, number, elapsed))
            if self.supervisor.memory.changed or self.supervisor.memory.samples % 1000 == 0:
                self.diagnose()
            if self.supervisor.memory.samples % 10 == 0:
                self.tell("state", array(self.supervisor.telemetry(), self.supervisor.labels()))
            if len(self.journal) >= 100:
                self.flush()
        if command is not None and late:
            self.supervisor.command(command, *self.times(answered - 10_000))
        self.spool = valve.step(self.plant, self.spool, self.supervisor.voltage)

    def answer(self, time, give):
        """A voltage, which ``give`` makes, at ``time``."""
        self.clock = time - 5_000
        voltage = give()
        self.put("valve_voltage", time, voltage)
        self.voltages.append(voltage)

    def tell(self, kind, data):
        """A message of the controller on one of its own topics."""
        name, type_ = f"{self.namespace}/controller/{kind}", STRING if kind == "memory" else ARRAY
        self._messages.append(Message(name, type_, self.clock + 20_000, 0, data, self.clock + 90_000))

    def diagnose(self):
        """What the controller says of itself."""
        self.supervisor.memory.changed = False
        mode, name = self.supervisor.mode, f"{self.namespace}/controller"
        data = diagnostic(name, int(mode), self.supervisor.reason, mode=mode.name.lower(), samples=1)
        self.send("/diagnostics", STATUS, data)

    def send(self, topic, kind, data):
        """A message of the controller right after its last answer."""
        self._messages.append(Message(topic, kind, self.clock + 30_000, 0, data, self.clock + 95_000))

    def flush(self):
        """The journal's waiting rows, and an account where one is due."""
        rows = self.journal.take()
        if rows:
            self.tell("journal", array(rows))
            due = self.supervisor.memory.samples - self.remembered >= self.memory_every
            if due or self.journal.owes_account:
                self.remembered = self.supervisor.memory.samples
                self.journal.owes_account = False
                account = snapshot(self.supervisor, self.journal.run, self.journal.count)
                self.tell("memory", string(account))

    @property
    def messages(self):
        """All messages so far."""
        self.flush()
        return self._messages

    def move(self, count, **options):
        for _ in range(count):
            t = (self.time - BEGIN) * 1e-9
            self.sample(2.0 * np.sin(2.0 * np.pi * t), **options)


def in_file_order(path, messages, storage="mcap", **options):
    """The messages as a bag, in the order in which they are given."""
    with BagWriter(path, storage, **options) as writer:
        known = set()
        for m in messages:
            if m.topic not in known:
                known.add(m.topic)
                text, _ = STORE.generate_msgdef(m.type, ros_version=2)
                writer.add_topic(m.topic, m.type, text, STORE.hash_rihs01(m.type))
            writer.write(m.topic, m.log_time, m.time, m.sequence, m.data)
    return path


def write(path, messages, storage="mcap", keep=lambda message: True, **options):
    """The messages as a bag, in the order of their log times."""
    ordered = sorted(filter(keep, messages), key=lambda m: m.log_time)
    return in_file_order(path, ordered, storage, **options)
