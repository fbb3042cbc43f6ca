"""Node `controller`: one LVDT sample, one step of the law, one voltage."""

import math
import sys
import time
from collections import deque
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension, MultiArrayLayout

from valve_control.laws import reshaping, velocity
from valve_control.laws.projection import Theta, advance
from valve_control.laws.signals import Start, saturate
from valve_control.nodes.adapter import (
    LATEST,
    SAMPLES,
    ParameterSet,
    PolledSubscription,
    diagnostics,
    run,
)
from valve_control.parameters import build, stability
from valve_control.parameters.table import CONTROLLER, Values
from valve_control.simulation.closed_loop import LAWS

TACHOMETER_CUTOFF = 50.0  # Hz, of the velocity with which a law takes over
# Parameters after whose change a law's state means something else, so that it takes over from itself.
FORMS = {
    "pid": ("pid.form",),
    "compensator": tuple(p.name for p in CONTROLLER if p.name.startswith("compensator.")),
}
HEAD = ("sample", "command", "measurement", "voltage", "offset")


def reshapes(params: Any) -> bool:
    """Whether the law of ``params`` follows a reshaped reference; the plain PID only carries the command."""
    return "reshaping" in params._fields and getattr(params, "plain", 0.0) == 0.0


class Controller(Node):
    """Reads `spool_position` and `spool_command`, publishes `valve_voltage` and `~/state`."""

    def __init__(self) -> None:
        super().__init__("controller")
        self._name = ""
        self._form: tuple[Any, ...] = ()
        self._law: Any = None
        self._params: Any = None
        self._state: Any = None
        self._offset = 0.0  # V, on the voltage; both fade after a change of controller
        self._command_offset = 0.0  # V, on the command
        self._taking_over = False
        self._command: float | None = None
        self._measurement = 0.0
        self._velocity = velocity.State(0.0, 0.0)
        self._voltage = 0.0
        self._start_position = 0.0
        self._unusable = 0
        self._last_sequence: int | None = None
        self._samples = 0
        self._counts = dict.fromkeys(
            ("lvdt_lost", "lvdt_refused", "command_refused", "command_limited", "saturated", "resets"), 0
        )
        self._durations: deque[float] = deque(maxlen=1000)
        self._message = Float64()
        self._state_message = Float64MultiArray()
        self._state_publisher = self.create_publisher(Float64MultiArray, "~/state", SAMPLES)
        self._tuning = ParameterSet(self, CONTROLLER, build.law_params, self._apply)
        self._commands = PolledSubscription(self, Float64, "spool_command", LATEST)
        self._voltages = self.create_publisher(Float64, "valve_voltage", SAMPLES)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", SAMPLES)
        self.create_subscription(Float64, "spool_position", self._on_measurement, SAMPLES)
        self.create_timer(1.0, self._diagnose)
        self._check_stability()
        self.get_logger().info(f"{self._name} at {1.0 / self._period:g} Hz, waiting for spool_position")

    def _apply(self, values: Values, params: Any) -> None:
        name = build.word(values, "controller")
        former = self._params
        self._params = params
        self._period = build.number(values, "sample_period")
        self._u_max = build.number(values, "u_max")
        self._command_limit = build.number(values, "command_limit")
        self._hold_samples = int(build.number(values, "lvdt_hold_samples"))
        self._decimation = int(build.number(values, "state_decimation"))
        self._tachometer = velocity.design(TACHOMETER_CUTOFF, self._period)
        self._fade = math.exp(-self._period / build.number(values, "transfer_time"))
        form = (name, *(values[key] for key in FORMS.get(name, ())))
        if form != self._form:
            self._form = form
            self._name = name
            self._law = LAWS[name]
            labels = (*HEAD, *self._law.Terms._fields)
            self._state_message.layout = MultiArrayLayout(
                dim=[MultiArrayDimension(label=label, size=1, stride=1) for label in labels]
            )
            if self._state is not None:
                self._take_over(reshapes(former) and reshapes(params))
        elif (
            self._state is not None
            and "theta" in self._state._fields
            and params.theta_initial != former.theta_initial
        ):
            self._state = self._state._replace(theta=params.theta_initial)
        self._unchecked = True

    def _take_over(self, same_reference: bool) -> None:
        """Begin with a new law where the old one is: reading, voltage, motion, reference and estimates."""
        former, params = self._state, self._params
        start = Start(
            self._measurement,
            self._voltage,
            self._measurement,
            self._velocity.velocity,
            self._velocity.velocity,
        )
        self._command_offset = 0.0
        if same_reference:
            reference, rate = former.reference
            start = start._replace(reference=reference, reference_rate=rate)
        elif self._command is not None:
            self._command_offset = self._steady_command(start) - self._command
        if "theta" in former._fields and "theta" in self._law.State._fields:
            theta = advance(former.theta, Theta(0.0, 0.0, 0.0, 0.0), 0.0, params.theta_min, params.theta_max)
            params = params._replace(theta_initial=theta)
        self._state = self._law.initial(params, start)
        self._taking_over = True

    def _steady_command(self, start: Start) -> float:
        """Command under which the law would go on as at ``start``; the real one is faded in from there."""
        if "static_gain" in self._params._fields:
            return start.voltage / float(self._params.static_gain)
        if getattr(self._params, "plain", 0.0) > 0.0:
            return start.measurement
        return reshaping.steady_command(self._params.reshaping, start.measurement, start.velocity)

    def _take_command(self) -> float:
        for message, _ in self._commands.take():
            value = message.data
            if not math.isfinite(value):
                self._refuse("command_refused", f"command {value} refused, the last one holds")
                continue
            self._command = saturate(value, self._command_limit)
            if self._command != value:
                self._counts["command_limited"] += 1
        if self._command is None:
            return self._measurement if self._state is None else self._start_position
        return self._command

    def _refuse(self, counter: str, text: str) -> None:
        self._counts[counter] += 1
        self.get_logger().warning(text, throttle_duration_sec=1.0)

    def _usable(self, measurement: float) -> bool:
        if math.isfinite(measurement):
            self._measurement = measurement
            self._unusable = 0
            return True
        self._unusable += 1
        self._refuse("lvdt_refused", f"LVDT reading {measurement} refused")
        return self._state is not None and self._unusable <= self._hold_samples

    def _on_measurement(self, message: Float64, info: dict[str, Any]) -> None:
        began = time.perf_counter()
        self._count_lost(info)
        usable = self._usable(message.data)
        command = self._take_command()
        if usable:
            self._control(command)
        else:
            self._voltage = 0.0
            self._state = None
        self._message.data = self._voltage
        self._voltages.publish(self._message)
        self._samples += 1
        self._durations.append(time.perf_counter() - began)

    def _count_lost(self, info: dict[str, Any]) -> None:
        sequence = info.get("publication_sequence_number")
        if sequence is None:
            return
        if self._last_sequence is not None and sequence > self._last_sequence + 1:
            self._counts["lvdt_lost"] += sequence - self._last_sequence - 1
        self._last_sequence = sequence

    def _control(self, command: float) -> None:
        law, params, y = self._law, self._params, self._measurement
        command += self._command_offset
        if self._state is None:
            self._state = law.initial(params, Start(y, self._voltage, y, 0.0, 0.0))
            self._start_position = y
            self._velocity = velocity.State(y, 0.0)
        self._velocity = velocity.step(self._tachometer, self._velocity, y)
        if self._taking_over:
            _, _, terms = law.step(params, self._state, command, y, 0.0)
            self._offset = self._voltage - terms.unsaturated_voltage
            self._taking_over = False
        voltage, state, terms = law.step(params, self._state, command, y, self._offset)
        if not all(map(math.isfinite, (voltage, *terms))):
            self._refuse("resets", f"{self._name} left the finite numbers, 0 V and a fresh start")
            self._voltage, self._offset, self._command_offset = 0.0, 0.0, 0.0
            self._state = law.initial(params, Start(y, 0.0, y, 0.0, 0.0))
            return
        self._state = state
        self._voltage = voltage
        if abs(voltage) >= self._u_max:
            self._counts["saturated"] += 1
        if self._decimation > 0 and self._samples % self._decimation == 0:
            head = (float(self._samples), command, y, voltage, self._offset)
            self._state_message.data = [*head, *terms]
            self._state_publisher.publish(self._state_message)
        self._offset *= self._fade
        self._command_offset *= self._fade

    def _check_stability(self) -> None:
        """Warn about unstable gains; after they came into use, since it takes longer than a period."""
        if self._unchecked:
            self._unchecked = False
            text = stability.warning(self._name, self._law, self._params)
            if text:
                self.get_logger().warning(text)

    def _diagnose(self) -> None:
        self._check_stability()
        values: dict[str, Any] = {"controller": self._name, "samples": self._samples, **self._counts}
        level, text = DiagnosticStatus.OK, "controlling"
        if self._durations:
            low, high = np.percentile(self._durations, [50, 99]) * 1e6
            values |= {"step_us_p50": f"{low:.1f}", "step_us_p99": f"{high:.1f}"}
        if self._state is not None and "theta" in self._state._fields:
            values["theta"] = ", ".join(f"{v:.6g}" for v in self._state.theta)
        if self._samples == 0:
            level, text = DiagnosticStatus.WARN, "no LVDT reading yet"
        elif self._unusable > 0:
            level, text = DiagnosticStatus.ERROR, "LVDT readings are not finite"
        elif self._command is None:
            level, text = DiagnosticStatus.WARN, "no command yet"
        self._diagnostics.publish(diagnostics(self, level, text, values))


def main() -> int:
    """Entry point of `ros2 run valve_control controller`."""
    return run(Controller)


if __name__ == "__main__":
    sys.exit(main())
