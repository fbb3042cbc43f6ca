# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The axis over real DDS: axis_simulator, the valve's controller and axis_controller as processes."""

import math
import time
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
import rclpy
from bench import call, set_parameters, spin_until, wait_for_message
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.duration import Duration as Wait
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Float64, Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from research.campaigns.processes import process
from valve_control.axis import axis_supervisor, run
from valve_control.axis.axis_parameters import AXIS_NODES
from valve_control.control.parameters import files, ros_file
from valve_control.control.supervision.memory import Mode
from valve_control.nodes import loop
from valve_control.nodes.adapter import EVERYTHING, SAMPLES, NumberSubscription
from valve_control.nodes.axis_controller import AxisController
from valve_control.parameter import updated


def path_of(machine):
    return str(ros_file.config_folder() / "axis" / f"{machine}.yaml")


def settings(machine, **changes):
    given = files.given([path_of(machine)], {}, [], [], AXIS_NODES)
    values = run.default_settings()
    values = {node: updated(table, values[node], given[node]) for node, table in AXIS_NODES.items()}
    for node, own in changes.items():
        values[node] = updated(AXIS_NODES[node], values[node], own)
    return values


def trajectory(goals, period, joint="axis"):
    """JointTrajectory with one point for each row of ``goals``."""
    points = []
    for k, (x, v, a) in enumerate(goals.tolist()):
        sec, nanosec = divmod(round(k * period * 1e9), 10**9)
        points.append(
            JointTrajectoryPoint(
                positions=[x],
                velocities=[v],
                accelerations=[a],
                time_from_start=Duration(sec=sec, nanosec=nanosec),
            )
        )
    return JointTrajectory(joint_names=[joint], points=points)


@contextmanager
def machine_running(folder, machine, **arguments):
    """The three processes of ``machine``; ``arguments``: words behind -p by node."""
    with ExitStack() as stack:
        children = {}
        for node in ("axis_simulator", "controller", "axis_controller"):
            words = ["--params-file", path_of(machine)]
            words += [word for setting in arguments.get(node, ()) for word in ("-p", setting)]
            children[node] = stack.enter_context(process(node, words, folder / f"{node}.log"))
        yield children


class Axis:
    """Listens to an axis and tells it what to do."""

    def __init__(self, node):
        self.node = node
        self.positions, self.goals, self.pressures, self.said, self.volts = [], [], [], [], []
        node.create_subscription(JointState, "joint_states", self.positions.append, SAMPLES)
        node.create_subscription(JointTrajectoryPoint, "axis_goal", self.goals.append, SAMPLES)
        node.create_subscription(FluidPressure, "pressure_a", self.pressures.append, SAMPLES)
        node.create_subscription(Float64, "valve_voltage", lambda m: self.volts.append(m.data), SAMPLES)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 50)
        self.goal = node.create_publisher(Float64, "goal_position", SAMPLES)
        self.trajectory = node.create_publisher(JointTrajectory, "joint_trajectory", SAMPLES)

    def _hear(self, message):
        self.said += [s.message for s in message.status if s.name == "axis_controller"]

    def told(self, text, limit=20.0):
        spin_until(
            self.node,
            lambda: any(text in said for said in self.said),
            f"'{text}', not {set(self.said)}",
            limit,
        )
        return next(said for said in self.said if text in said)

    def ready(self):
        spin_until(
            self.node,
            lambda: (
                self.goals
                and self.positions
                and self.goal.get_subscription_count()
                and self.trajectory.get_subscription_count()
            ),
            "axis_controller",
            120.0,
        )

    @property
    def position(self):
        return self.positions[-1].position[0]


@pytest.mark.parametrize(
    ("machine", "level", "duration"),
    [
        ("bench", "axis_pid", 0.9),
        pytest.param("bench", "axis_arc", 0.6, marks=pytest.mark.campaign),
        pytest.param("press", "axis_pid", 0.9, marks=pytest.mark.campaign),
        pytest.param("crane_boom", "axis_arc", 2.0, marks=pytest.mark.campaign),
    ],
)
def test_the_cascade_in_lockstep_equals_the_offline_run(ros, tmp_path, machine, level, duration):
    """A trajectory over DDS, sensors with noise, a valve with friction: voltages and commands, to the bit."""
    distance = 0.05 if duration > 0.6 else 0.03
    course = {"duration": duration, "pause": 0.05, "back": False, "distance": distance}
    late = {"position.delay": 0.0015, "pressure.delay": 0.0015}
    values = settings(machine, axis_controller={"upper_level": level, **course}, axis_simulator=late)
    made = run.setup(values)
    twin = run.simulate(made)
    wanted = len(made.goals)
    kept = {name: {} for name in ("valve_voltage", "spool_command")}
    listening = {name: NumberSubscription(ros, name, EVERYTHING) for name in kept}
    publisher = ros.create_publisher(JointTrajectory, "joint_trajectory", SAMPLES)

    def fetch():
        for name, subscription in listening.items():
            for number, info in subscription.take():
                kept[name][info["publication_sequence_number"]] = number
        return max(kept["valve_voltage"], default=0) >= wanted

    words = ["valve_simulator:clock:=lockstep", "valve_simulator:listeners:=2"]
    lockstep = {
        "axis_simulator": [*words, *(f"{name}:={delay}" for name, delay in late.items())],
        "controller": ["lockstep:=true", "lvdt.frozen_samples:=0", "state_decimation:=0"],
        "axis_controller": ["lockstep:=true", f"upper_level:={level}"],
    }
    with machine_running(tmp_path, machine, **lockstep):
        spin_until(ros, lambda: publisher.get_subscription_count() == 1, "axis_controller", 120.0)
        publisher.publish(trajectory(made.goals, made.machine.axis.period))
        assert publisher.wait_for_all_acked(Wait(seconds=5))
        # The second listener of the LVDT lets the simulator begin.
        listening["spool_position"] = NumberSubscription(ros, "spool_position", EVERYTHING)
        kept["spool_position"] = {}
        spin_until(ros, fetch, "all voltages", 200.0)
    offline = {
        "valve_voltage": twin.signals["voltage"],
        "spool_command": twin.signals["spool_command"],
    }
    for name, expected in offline.items():
        numbers = sorted(k for k in kept[name] if k <= wanted)
        assert len(numbers) >= 0.99 * wanted
        got = np.array([kept[name][k] for k in numbers])
        assert np.array_equal(got, expected[np.array(numbers) - 1]), name
    assert np.ptp(twin.signals["position"]) > 0.9 * distance


class Played(Axis):
    """Plays the position sensor too: one reading of a stamp of its own after the other."""

    def __init__(self, node):
        super().__init__(node)
        self.commands, self.spool, self.time = [], [], 0
        self.sensor = node.create_publisher(JointState, "joint_states", SAMPLES)
        node.create_subscription(Float64, "spool_command", lambda m: self.commands.append(m.data), SAMPLES)

    def connect(self, position):
        spin_until(
            self.node,
            lambda: all(p.get_subscription_count() for p in (self.goal, self.trajectory, self.sensor)),
            "axis_controller",
            120.0,
        )
        while not self.goals:  # until an answer shows that both directions carry
            self.send(position)
            rclpy.spin_once(self.node, timeout_sec=0.1)
        end = time.monotonic() + 0.3
        spin_until(self.node, lambda: time.monotonic() > end, "calm")

    def send(self, position):
        self.time += 1_000_000
        stamp = Time(sec=self.time // 10**9, nanosec=self.time % 10**9)
        self.sensor.publish(JointState(header=Header(stamp=stamp), name=["axis"], position=[position]))

    def sample(self, position):
        """Command [V] for a reading, and the goal."""
        count = len(self.commands), len(self.goals)
        self.send(position)
        spin_until(self.node, lambda: len(self.commands) > count[0] and len(self.goals) > count[1], "command")
        return self.commands[-1], self.goals[-1].positions[0]


@contextmanager
def upper_level(folder, *settings):
    words = [word for setting in settings for word in ("-p", setting)]
    with process("axis_controller", ["--params-file", path_of("bench"), *words], folder / "a.log") as child:
        yield child


def test_what_cannot_be_followed_is_refused_in_one_sentence_and_changes_nothing(ros, tmp_path):
    axis = Played(ros)
    with upper_level(tmp_path, "sensor.timeout:=100.0"):
        axis.connect(0.2)
        held = axis.sample(0.2)
        assert held == (0.0, 0.2)

        def refuse(words):
            axis.said.clear()
            end = time.monotonic() + 20.0
            while not any("refused: " in said and words in said for said in axis.said):
                assert time.monotonic() < end, f"'{words}', not {set(axis.said)}"
                assert axis.sample(0.2) == held

        axis.goal.publish(Float64(data=0.6))
        refuse("the goal 0.6 m is outside the stroke from 0 m to 0.5 m")
        rows = np.array([[0.2, 0.0, 0.0], [0.3, 0.0, 0.0]])
        axis.trajectory.publish(trajectory(rows, 0.01))
        refuse("m/s outwards; the axis has")
        axis.trajectory.publish(trajectory(rows, 1.0, joint="boom"))
        refuse("is for 'boom', not for 'axis'")
        assert axis.sample(0.2) == held
        axis.goal.publish(Float64(data=0.203))
        goals = [0.2]
        while goals[-1] != 0.203:
            goals.append(axis.sample(goals[-1])[1])
            assert len(goals) < 3000 and 0.2 <= goals[-1] <= 0.203


def test_wrong_readings_are_bridged_then_the_axis_stops_until_it_is_reset(ros, tmp_path):
    axis = Played(ros)
    with upper_level(tmp_path, "sensor.timeout:=100.0", "stop.controller:=''") as child:
        axis.connect(0.2)
        axis.goal.publish(Float64(data=0.25))
        position, command = 0.2, 0.0
        while command < 0.5:
            command, position = axis.sample(position)
        for wrong in (0.4, math.nan, 0.7):
            assert axis.sample(wrong)[0] == command
        following, position = axis.sample(position)
        assert following >= command
        for wrong in (0.4, math.nan, 0.7):
            axis.sample(wrong)
        assert axis.sample(0.4)[0] == 0.0
        axis.told("stopped, 0 V: position jumps by")
        axis.goal.publish(Float64(data=0.3))
        log = tmp_path / "a.log"
        spin_until(
            ros, lambda: "goal 0.3 m refused: the axis is stopped; ~/reset" in log.read_text(), "refusal"
        )
        assert axis.sample(position)[0] == 0.0
        assert call(ros, Trigger, "/axis_controller/reset", Trigger.Request()).success
        assert axis.sample(0.21) == (0.0, 0.21)
        assert set_parameters(ros, "axis_controller", sensor__timeout=0.2).successful
        axis.sample(0.21)
        axis.told("stopped, 0 V: no position for")
        axis.commands.clear()
        spin_until(ros, lambda: len(axis.commands) >= 3, "0 V again and again")
        assert set(axis.commands) == {0.0}
        assert child.poll() is None


def test_an_axis_whose_process_stood_still_while_readings_waited_stops_and_a_busy_one_does_not(
    ros, monkeypatch
):
    monkeypatch.setattr(loop, "STALL", 10.0)
    words = ["--params-file", path_of("bench"), "-p", "stop.controller:=''", "-p", "sensor.timeout:=100.0"]
    node, axis = AxisController(cli_args=["--ros-args", *words]), Played(ros)

    def answer(position, waited=0.0):
        """Let ``node`` find a reading that has come, ``waited`` [s] after it should have looked."""
        axis.send(position)
        wait_for_message(node, node._joints)
        if waited:
            node._watch_at = time.monotonic() - waited
        node.work()
        return axis_supervisor.mode(node._state)

    try:
        spin_until(ros, axis.sensor.get_subscription_count, "axis_controller")
        for waited in (0.0, 0.0, 0.5 * loop.STALL):
            assert answer(0.2, waited)[0] is Mode.OK
        mode, text = answer(0.2, 2.0 * loop.STALL)
        assert mode is Mode.SAFE and "stalled: the axis controller's process stood still for" in text
        assert node._state.command == 0.0
        node._on_reset(None, Trigger.Response())
        assert answer(0.21)[0] is Mode.OK and node._state.goal.position == 0.21
    finally:
        node.destroy_node()


def test_axis_arc_waits_for_its_first_pressures_after_each_start(ros, tmp_path):
    axis = Played(ros)
    rooms = [ros.create_publisher(FluidPressure, f"pressure_{room}", SAMPLES) for room in "ab"]
    given = ("upper_level:=axis_arc", "sensor.timeout:=0.2", "stop.controller:=''")

    def switch(*transitions):
        for wanted in transitions:
            request = ChangeState.Request(transition=Transition(id=wanted))
            assert call(ros, ChangeState, "/axis_controller/change_state", request).success

    with upper_level(tmp_path, *given):
        switch_off = (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
        switch_on = (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
        end = time.monotonic() + 30.0
        while not axis.commands:
            assert time.monotonic() < end
            for room in rooms:
                room.publish(FluidPressure(fluid_pressure=50e5))
            axis.send(0.2)
            rclpy.spin_once(ros, timeout_sec=0.01)
        switch(*switch_off)
        axis.said.clear()
        end = time.monotonic() + 0.3  # longer than the sensors may be silent
        spin_until(ros, lambda: time.monotonic() > end, "silence")
        switch(*switch_on)
        end = time.monotonic() + 20.0
        while not any("stopped" in said for said in axis.said):
            assert time.monotonic() < end
            axis.send(0.2)
            rclpy.spin_once(ros, timeout_sec=0.01)
        axis.told("stopped, 0 V: there is no pressure_a and pressure_b")


def test_an_axis_whose_sensor_fails_ends_with_0_v_on_the_valve(ros, tmp_path):
    axis = Axis(ros)
    lockstep = {
        "axis_simulator": ["valve_simulator:clock:=lockstep"],
        "controller": ["lockstep:=true", "lvdt.frozen_samples:=0"],
        "axis_controller": ["lockstep:=true", "message:=trajectory"],
    }
    with machine_running(tmp_path, "bench", **lockstep):
        axis.ready()
        begun = axis.position
        axis.goal.publish(Float64(data=begun + 0.03))
        spin_until(ros, lambda: abs(axis.position - begun - 0.03) < 0.002, "the goal", 60.0)
        assert set_parameters(ros, "axis_simulator", fault__position="jump").successful
        said = axis.told("stopped, 0 V: position jumps by ")
        jump = float(said.partition("jumps by ")[2].split()[0])
        assert jump == pytest.approx(0.05, abs=0.002), "a tenth of the stroke, and the rest of the way"
        log = tmp_path / "controller.log"
        spin_until(ros, lambda: "inactive, 0 V" in log.read_text(), "the controller's end")
        spin_until(ros, lambda: axis.volts[-1] == 0.0, "0 V")
        end = time.monotonic() + 0.5
        spin_until(ros, lambda: time.monotonic() > end, "calm")
        assert axis.volts[-1] == 0.0
        assert log.read_text().count("waiting for spool_position") == 1
        for wanted in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
            request = ChangeState.Request(transition=Transition(id=wanted))
            assert call(ros, ChangeState, "/axis_controller/change_state", request).success
        spin_until(ros, lambda: log.read_text().count("waiting for spool_position") == 2, "its new beginning")
