# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the node `axis_controller`: for each position reading of an axis one command of its spool."""

import math
import sys
import time
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.duration import Duration
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from valve_control.axis import axis_supervisor, path
from valve_control.axis.axis_parameters import AXIS_CONTROLLER
from valve_control.axis.course import Goal, MotionLimits
from valve_control.axis.machine import Reading
from valve_control.axis.path import nanoseconds
from valve_control.control.supervision.memory import Mode
from valve_control.nodes.adapter import (
    NEWEST,
    SAMPLES,
    Diagnostics,
    NumberSubscription,
    ParameterSet,
    PolledSubscription,
    encoded,
    encoded_point,
    number_of,
)
from valve_control.nodes.lifecycle import Managed
from valve_control.nodes.loop import run, stood_still
from valve_control.parameter import ParameterError, Values, number, word

LEVELS = {
    Mode.OK: DiagnosticStatus.OK,
    Mode.DEGRADED: DiagnosticStatus.WARN,
    Mode.SAFE: DiagnosticStatus.ERROR,
}
NANO = 10**9
REMIND = 0.1  # s between two commands of 0 V while no reading comes
LAST_WORD = 0.2  # s to see the last command received
LOOK = 0.01  # s; lockstep: between two looks at what a reading waits for
NEVER = math.inf


class AxisController(Managed):
    """Reads `joint_states`, takes `joint_trajectory` and `goal_position`, publishes the command of the spool.

    The position's readings are its clock. Without a goal it holds the position that it found.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("axis_controller", **options)
        self._values: Values = {}
        self._params: axis_supervisor.Params
        self._state: axis_supervisor.State
        self._waiting: tuple[JointState, int] | None = None  # lockstep: a reading without its listeners
        self._watch_at = self._look_at = NEVER
        self._heard = 0.0  # s  when the last reading came
        self._number = 0  # of the last reading, 0: it is not known
        self._stamp = 0  # ns  of its time stamp, 0: it has none
        self._deactivate_at = NEVER
        self._deactivated = False
        self._listened = False
        self._pressures = dict.fromkeys(("a", "b"), math.nan)
        self._stamps: dict[str, Any] = dict.fromkeys(("a", "b"))
        self._heard_rooms = dict.fromkeys(("a", "b"), NEVER)  # s  when their pressures came
        self._waits_since = NEVER  # s  first reading without pressures that the upper level needs
        self._paired = False  # lockstep: whether both pressures are those of the reading
        self._said: tuple[Mode, str] | None = None
        self._diagnostics = Diagnostics(self, self._diagnose)
        fixed = ("sample_period", "stop.controller", "upper_level")
        ParameterSet(self, AXIS_CONTROLLER, axis_supervisor.design, self._apply, fixed=fixed)
        self._life = self.create_client(ChangeState, f"{word(self._values, 'stop.controller')}/change_state")
        self.create_service(Trigger, "~/stop", self._on_stop)
        self.create_service(Trigger, "~/reset", self._on_reset)
        if self._values["autostart"]:
            self.autostart()

    def _apply(self, values: Values, built: tuple[axis_supervisor.Params, path.Range]) -> None:
        first = not self._values
        self._values = values
        self._params, self._able = built
        self._limits = MotionLimits(
            number(values, "max_velocity"), number(values, "max_acceleration"), number(values, "max_jerk")
        )
        self._lockstep = values["lockstep"] is True
        self._trajectory = values["message"] == "trajectory"
        self._timeout = number(values, "sensor.timeout")
        self._needs_pressures = self._params.level.NEEDS_PRESSURES is True
        if first:
            self._state = axis_supervisor.at_rest(self._params)

    # Life

    def open(self) -> None:
        """Create publishers and subscriptions."""
        self._commands = self.create_publisher(Float64, "spool_command", SAMPLES)
        self._points = self.create_publisher(JointTrajectoryPoint, "spool_trajectory", SAMPLES)
        self._goals = self.create_publisher(JointTrajectoryPoint, "axis_goal", SAMPLES)
        qos = SAMPLES if self._lockstep else NEWEST
        self._joints = PolledSubscription(self, JointState, "joint_states", qos)
        self._wanted = NumberSubscription(self, "goal_position", SAMPLES)
        self._trajectories = PolledSubscription(self, JointTrajectory, "joint_trajectory", SAMPLES)
        room_a = PolledSubscription(self, FluidPressure, "pressure_a", qos)
        self._rooms = {"a": room_a, "b": PolledSubscription(self, FluidPressure, "pressure_b", qos)}

    def begin(self) -> None:
        """Hold the position of the first reading; what waits is stale and dropped, but not in lockstep."""
        if not self._lockstep:
            for topic in (self._joints, self._wanted, self._trajectories, *self._rooms.values()):
                for _ in topic.take():
                    pass
            self._heard_rooms = dict.fromkeys(self._rooms, NEVER)
            self._waits_since = NEVER
        self._state, self._number = axis_supervisor.reset(self._params, self._state), 0
        self._said = None
        self._listened = False
        self._watch_at = self._deactivate_at = NEVER
        self._reactivate()
        self.get_logger().info(
            f"stroke from {self._able.low:g} m to {self._able.high:g} m, {self._able.speed_out:.3g} m/s out "
            f"and {self._able.speed_in:.3g} m/s in at most, waiting for joint_states"
        )

    def end(self) -> None:
        """Command 0 V once and stop."""
        self._state = axis_supervisor.stopped(self._state, "inactive")
        self._publish(self._now())
        self._watch_at = NEVER

    # Work

    def inputs(self) -> Sequence[PolledSubscription]:
        """Subscriptions of the position and of what is wanted."""
        if not self.working:
            return ()
        known = self._state.goal is not None or self._state.stopped
        return (self._joints, self._trajectories, self._wanted) if known else (self._joints,)

    def due(self) -> float:
        """Next time [s] to act without a message: silence, the end of a stop, a look in lockstep."""
        return min(self._watch_at, self._look_at, self._deactivate_at) if self.working else NEVER

    def work(self) -> bool:
        """Take what is wanted, answer the readings that have come, and look after silence."""
        if not self.working:
            return False
        stalled = stood_still(self._watch_at, time.monotonic())  # now: to plan a motion is no standstill
        worked = self._take_goals()
        for reading, info in self._joints.take():
            if self._lockstep:
                self._waiting = reading, number_of(info)
            else:
                if stalled:
                    self._stop_for_stall()
                self._answer(reading, number_of(info))
            worked = True
        if self._waiting is not None:
            worked = self._answer_in_lockstep(*self._waiting) or worked
        now = time.monotonic()
        if now >= self._watch_at:
            self._watch_at = now + REMIND
            if stalled:
                self._stop_for_stall()
            self._state = axis_supervisor.silent(self._state, f"no position for {now - self._heard:.3g} s")
            self._publish(self._now())
            worked = True
        if now >= self._deactivate_at:
            self._deactivate_at = NEVER
            self._set_controller(Transition.TRANSITION_DEACTIVATE)
        return worked

    def report(self) -> None:
        """Publish diagnostics if something has changed."""
        if not self.working:
            return
        now = axis_supervisor.mode(self._state)
        if now == self._said:
            return
        before, self._said = self._said, now
        text = f"{before[0].name.lower() if before else 'off'} → {now[0].name.lower()}: {now[1]}"
        if now[0] is Mode.SAFE:
            self.get_logger().error(text)
            if word(self._values, "stop.controller"):
                self._deactivate_at = time.monotonic() + number(self._values, "stop.delay")
        elif now[0] is Mode.OK:
            self.get_logger().info(text)
        else:
            self.get_logger().warning(text)
        self._diagnose()

    def _stop_for_stall(self) -> None:
        stood = time.monotonic() - self._heard
        text = f"stalled: the axis controller's process stood still for {stood:.3g} s"
        self._state = axis_supervisor.silent(self._state, text)

    def _answer_in_lockstep(self, reading: JointState, number: int) -> bool:
        """Answer when somebody hears the command and both pressures of the reading have come."""
        publisher = self._points if self._trajectory else self._commands
        self._take_pressures(reading.header.stamp)
        self._listened = self._listened or publisher.get_subscription_count() > 0
        if not self._listened or (self._needs_pressures and not self._paired):
            self._look_at = time.monotonic() + LOOK
            return False
        self._waiting, self._look_at = None, NEVER
        self._answer(reading, number)
        return True

    def _answer(self, reading: JointState, number: int) -> None:
        lost = number - self._number - 1 if 0 < self._number < number else None
        self._number = number  # messages of other joints have numbers too
        joint = word(self._values, "joint")
        if joint not in reading.name or len(reading.position) <= list(reading.name).index(joint):
            foreign = ", ".join(f"'{name}'" for name in reading.name) or "no joint"
            self.get_logger().warning(
                f"joint_states has {foreign} with a position, not '{joint}'", throttle_duration_sec=5.0
            )
            return
        now = time.monotonic()
        if not self._lockstep:
            self._take_pressures(None)
        self._heard = now
        stamp = self._stamp = nanoseconds(reading.header.stamp)
        self._watch_at = NEVER if self._lockstep else now + self._timeout
        if self._needs_pressures and not self._lockstep and not self._watch_pressures(now):
            return
        position = reading.position[list(reading.name).index(joint)]
        if self._state.goal is None:
            self._state = axis_supervisor.found(self._params, self._state, position, stamp)
            self._take_goals()  # that came before the first position
        self._state = axis_supervisor.sample(
            self._params,
            self._state,
            Reading(math.nan, position, self._pressures["a"], self._pressures["b"]),
            stamp if stamp or self._lockstep else axis_supervisor.unstamped(self._params, self._state, lost),
            lost,
        )
        self._publish(stamp)

    def _now(self) -> int:
        """Time [ns] on the clock of the readings, 0 if they have none."""
        if self._lockstep or not self._stamp:
            return self._stamp
        return self._stamp + round((time.monotonic() - self._heard) * NANO)

    def _publish(self, stamp: int) -> None:
        """Publish the command of the spool, and the goal; ``stamp`` [ns] of the reading."""
        if self._trajectory:
            motion = axis_supervisor.spool_motion(self._params, self._state)
            self._points.publish(encoded_point(*motion, 0 if self._lockstep else stamp))
        else:
            self._commands.publish(encoded(self._state.command))
        if self._state.goal is not None:
            self._goals.publish(encoded_point(*self._state.goal, stamp))

    def _take_pressures(self, stamp: Any) -> None:
        """Take both pressures; ``stamp``: of the reading to which they must belong, None for the newest."""
        for room, topic in self._rooms.items():
            for message, _ in topic.take():
                self._pressures[room] = message.fluid_pressure
                self._stamps[room] = message.header.stamp
                self._heard_rooms[room] = time.monotonic()
        self._paired = stamp is not None and all(s == stamp for s in self._stamps.values())

    def _watch_pressures(self, now: float) -> bool:
        """Stop if a pressure that the upper level needs is silent; False while the first is awaited."""
        missing = [room for room, heard in self._heard_rooms.items() if heard == NEVER]
        if missing:
            self._waits_since = min(self._waits_since, now)
            if now - self._waits_since <= self._timeout:
                return False
            topics = " and ".join(f"pressure_{room}" for room in missing)
            text = f"there is no {topics}, which axis_arc needs; the upper_level axis_pid needs none"
            self._state = axis_supervisor.stopped(self._state, text)
        for room, heard in self._heard_rooms.items():
            if now - heard > self._timeout:
                text = f"no pressure {room} for {now - heard:.3g} s"
                self._state = axis_supervisor.stopped(self._state, text)
        return True

    # What is wanted

    def _take_goals(self) -> bool:
        """Take what is wanted, once it is known where the axis is."""
        if self._state.goal is None and not self._state.stopped:
            return False
        worked = False
        for message, _ in self._trajectories.take():
            self._use("trajectory", lambda m=message: self._path_through(m))
            worked = True
        for target, _ in self._wanted.take():
            self._use(
                f"goal {target:g} m",
                lambda t=target: (path.towards(t, self._present(), self._limits, self._able), None),
            )
            worked = True
        return worked

    def _use(self, what: str, make: Any) -> None:
        """Follow what ``make`` returns, a path and when [ns] it begins, or refuse it in one sentence."""
        try:
            self._state = axis_supervisor.begin(self._state, *make())
        except ParameterError as error:
            text = f"{what} refused: {error}"
            self._state = axis_supervisor.refused(self._params, self._state, text)
            if self._state.stopped:  # which is what the diagnostics go on telling
                self.get_logger().warning(text)
            return
        self.get_logger().info(f"{what} taken")

    def _present(self, at: int | None = None) -> Goal:
        """Goal at which a path begins that begins at the time ``at`` [ns], or now. Raises ParameterError."""
        goal = axis_supervisor.present(self._state, at)
        if goal is None:
            raise ParameterError("the axis is stopped; ~/reset ends that")
        return goal

    def _path_through(self, message: JointTrajectory) -> tuple[path.Path, int | None]:
        points = path.points_of(word(self._values, "joint"), message.joint_names, message.points)
        at = nanoseconds(message.header.stamp) or None
        made = path.through(points, self._present(at), self._able)
        return axis_supervisor.joining(self._state, made, at, self._able), at

    # Services

    def _on_stop(self, request: Any, response: Any) -> Any:
        self._state = axis_supervisor.stopped(self._state, "~/stop was called")
        if self.working:
            self._publish(self._now())
        response.success, response.message = True, "stopped, 0 V; ~/reset ends that"
        return response

    def _on_reset(self, request: Any, response: Any) -> Any:
        self._state, self._number = axis_supervisor.reset(self._params, self._state), 0
        self._deactivate_at = self._watch_at = NEVER
        self._reactivate()
        response.success, response.message = True, "holds the position of the next reading"
        self.get_logger().info(response.message)
        return response

    def _reactivate(self) -> None:
        """Activate the valve's controller if a stop has deactivated it."""
        if self._deactivated:
            self._set_controller(Transition.TRANSITION_ACTIVATE)

    def _set_controller(self, transition: int) -> None:
        """Deactivate or activate the valve's controller; nobody waits for its answer."""
        self._deactivated = transition == Transition.TRANSITION_DEACTIVATE
        name = word(self._values, "stop.controller")
        if not self._life.service_is_ready():
            self.get_logger().warning(f"there is no {name} whose voltage could be switched")
            return
        request = ChangeState.Request(transition=Transition(id=transition))
        done = "0 V on the valve" if self._deactivated else "active again"

        def told(future: Any) -> None:
            success = future.result() is not None and future.result().success
            self.get_logger().info(f"{name}: {done}" if success else f"{name} has refused the transition")

        self._life.call_async(request).add_done_callback(told)

    # What is said

    def _diagnose(self) -> None:
        mode, text = axis_supervisor.mode(self._state)
        level = LEVELS[mode]
        s = self._state
        values = {
            "mode": mode.name.lower(),
            "samples": s.samples,
            "position_m": f"{s.watch.position:.6f}" if s.watch.position is not None else "",
            "goal_m": f"{s.goal.position:.6f}" if s.goal is not None else "",
            "error_m": f"{s.terms.error:.6f}",
            "command_V": f"{s.command:.4f}",
            **axis_supervisor.estimates(self._params, s),
        }
        self._diagnostics.tell(level, text, values)

    def deliver(self) -> None:
        """Wait until the last command is acknowledged."""
        if self.configured:
            for publisher in (self._commands, self._points):
                publisher.wait_for_all_acked(Duration(seconds=LAST_WORD))


def main() -> int:
    """Entry point of `ros2 run valve_control axis_controller`."""
    return run(lambda: [AxisController()])


if __name__ == "__main__":
    sys.exit(main())
