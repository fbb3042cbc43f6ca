"""Real nodes as processes, real DDS."""

import math
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParametersAtomically
from std_msgs.msg import Float64, Float64MultiArray

from valve_control.nodes.demo import process
from valve_control.parameters import build
from valve_control.parameters.table import VALVE, defaults
from valve_control.plant import valve

LIMIT = 20.0  # s


@pytest.fixture
def ros():
    rclpy.init()
    node = rclpy.create_node("test")
    yield node
    node.destroy_node()
    rclpy.shutdown()


def spin_until(node, condition, what, limit=LIMIT):
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end, f"{what} not within {limit} s"
        rclpy.spin_once(node, timeout_sec=0.05)


def call(node, service, name, request):
    client = node.create_client(service, name)
    spin_until(node, client.service_is_ready, name)
    future = client.call_async(request)
    spin_until(node, future.done, name)
    node.destroy_client(client)
    return future.result()


def value(v):
    if isinstance(v, str):
        return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=v)
    if isinstance(v, list):
        return ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=v)
    return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=v)


def set_parameters(node, **values):
    request = SetParametersAtomically.Request(
        parameters=[Parameter(name=k.replace("__", "."), value=value(v)) for k, v in values.items()]
    )
    return call(node, SetParametersAtomically, "/controller/set_parameters_atomically", request).result


def get_double(node, name):
    got = call(node, GetParameters, "/controller/get_parameters", GetParameters.Request(names=[name]))
    return got.values[0].double_value


class Bench:
    """Plays LVDT and upper level for a controller, one sample at a time."""

    def __init__(self, node):
        self.node = node
        self.voltages = []
        self.states = []
        self.lvdt = node.create_publisher(Float64, "spool_position", 10)
        self.command = node.create_publisher(Float64, "spool_command", 1)
        node.create_subscription(Float64, "valve_voltage", lambda m: self.voltages.append(m.data), 10)
        node.create_subscription(Float64MultiArray, "/controller/state", self.states.append, 10)

    def connect(self):
        spin_until(
            self.node,
            lambda: (
                self.lvdt.get_subscription_count() == 1
                and self.command.get_subscription_count() == 1
                and self.node.count_publishers("valve_voltage") == 1
            ),
            "controller",
        )
        while not self.voltages:  # until its first answer shows that both directions carry
            self.lvdt.publish(Float64(data=0.0))
            rclpy.spin_once(self.node, timeout_sec=0.1)
        self.settle()

    def settle(self):
        """Until 0.5 s pass without an answer to the knocking above."""
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            count = len(self.voltages)
            rclpy.spin_once(self.node, timeout_sec=0.05)
            if len(self.voltages) != count:
                end = time.monotonic() + 0.5

    def sample(self, reading):
        count = len(self.voltages)
        self.lvdt.publish(Float64(data=reading))
        spin_until(self.node, lambda: len(self.voltages) > count, "voltage")
        return self.voltages[-1]


@contextmanager
def controller(tmp_path, *arguments):
    with process("controller", ["-p", "state_decimation:=1", *arguments], tmp_path / "c.log") as child:
        yield child


def test_one_reading_one_step_one_voltage(ros, tmp_path):
    bench = Bench(ros)
    with controller(tmp_path):
        bench.connect()
        before = len(bench.voltages)
        for k in range(100):
            bench.sample(0.001 * k)
        bench.settle()
        assert len(bench.voltages) == before + 100
        labels = [d.label for d in bench.states[-1].layout.dim]
        assert len(labels) == len(bench.states[-1].data)
        assert {"command", "measurement", "voltage", "z1", "lyapunov", "b0"} <= set(labels)


def test_values_that_are_not_finite_are_refused(ros, tmp_path):
    bench = Bench(ros)
    with controller(tmp_path):
        bench.connect()
        bench.command.publish(Float64(data=1.0))
        for _ in range(50):
            bench.sample(0.0)
        for bad in (math.nan, math.inf, -math.inf):
            bench.command.publish(Float64(data=bad))
            for reading in (0.0, bad, 0.0):
                assert abs(bench.sample(reading)) <= 10.0  # also fails for NaN
        for _ in range(5):
            bench.sample(math.nan)
        assert bench.sample(math.nan) == 0.0
        assert bench.sample(0.5) is not None
        for _ in range(20):
            voltage = bench.sample(0.5)
        assert math.isfinite(voltage) and voltage != 0.0


def test_parameters_are_taken_as_a_whole_or_not_at_all(ros, tmp_path):
    bench = Bench(ros)
    with controller(tmp_path):
        bench.connect()
        refused = [
            ({"arc__k1": -1.0, "arc__k2": 90.0}, "arc.k1"),
            ({"arc__k2": 90.0, "arc__theta_min": [5.0, 500.0, 3000.0, 0.0]}, "theta_min[2]"),
            ({"arc__k2": 90.0, "controller": "lqr"}, "lqr"),
            ({"arc__k2": 90.0, "arc__k1": math.nan}, "arc.k1"),
            ({"arc__k2": 90.0, "reshaping__natural_frequency": 5000.0}, "below"),
            ({"arc__k2": 90.0, "arc__gamma": [1.0, 2.0]}, "arc.gamma"),
        ]
        for values, word in refused:
            result = set_parameters(ros, **values)
            assert not result.successful and word in result.reason, result.reason
            assert get_double(ros, "arc.k2") == 120.0
        assert set_parameters(ros, arc__k1=100.0, arc__k2=90.0).successful
        assert get_double(ros, "arc.k2") == 90.0
        bench.command.publish(Float64(data=1.0))
        for _ in range(30):
            bench.sample(0.0)
        described = call(
            ros,
            DescribeParameters,
            "/controller/describe_parameters",
            DescribeParameters.Request(names=["arc.k1"]),
        ).descriptors[0]
        assert "1/s" in described.description and described.floating_point_range[0].to_value == 1e5


def test_new_gains_change_the_very_next_voltage(ros, tmp_path):
    bench = Bench(ros)
    with controller(tmp_path, "-p", "controller:=open_loop", "-p", "open_loop.static_gain:=0.5"):
        bench.connect()
        bench.command.publish(Float64(data=1.0))
        spin_until(ros, lambda: bench.sample(0.0) == 2.0, "the command")
        assert set_parameters(ros, open_loop__static_gain=0.25).successful
        assert bench.sample(0.0) == 4.0


def test_change_of_controller_is_bumpless(ros, tmp_path):
    """Valve (3) on a 1 Hz sine of 2 V, sample by sample: no law's takeover makes a step."""
    p = build.valve_params(defaults(VALVE))
    s = valve.initial(p)
    bench = Bench(ros)
    voltages = []

    def move(samples):
        nonlocal s
        for _ in range(samples):
            t = len(voltages) * p.period
            bench.command.publish(Float64(data=2.0 * math.sin(2.0 * math.pi * t)))
            voltages.append(bench.sample(valve.read(p, s, 0.0)))
            s = valve.step(p, s, voltages[-1])

    with controller(tmp_path):
        bench.connect()
        move(300)
        for law, more in (
            ("oarc", {}),
            ("pid", {}),
            ("pid", {"pid__form": "plain"}),
            ("pid", {"pid__form": "reference"}),
            ("compensator", {}),
            ("compensator", {"compensator__design": "printed_second_order"}),
            ("arc", {}),
            ("open_loop", {}),
            ("oarc", {}),
            ("arc", {}),
        ):
            begin = len(voltages) - 1
            assert set_parameters(ros, controller=law, **more).successful
            move(250)
            steps = [abs(b - a) for a, b in zip(voltages[begin:], voltages[begin + 1 :], strict=False)]
            # The sine alone moves the voltage by up to 0.03 V a sample; a fresh start by some volts.
            assert max(steps) < 0.5, (law, more, max(steps))


@pytest.mark.parametrize("node", ["controller", "valve_simulator", "command_source"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ends_quietly(ros, tmp_path, node, number):
    log = tmp_path / "log"
    with process(node, [], log) as child:
        spin_until(ros, lambda: node in ros.get_node_names(), node)
        child.send_signal(number)
        assert child.wait(10.0) == 0
    assert "Traceback" not in log.read_text()


@pytest.mark.parametrize(
    ("node", "argument", "word"),
    [
        ("controller", "controller:=lqr", "'lqr'"),
        ("controller", "arc.k1:=-3.0", "arc.k1"),
        ("controller", "arc.k1:=fast", "arc.k1"),
        ("controller", "sample_period:=0.0", "sample_period"),
        ("valve_simulator", "valve:=servo", "'servo'"),
        ("command_source", "scenario:=zigzag", "'zigzag'"),
    ],
)
def test_bad_start_is_one_sentence(node, argument, word):
    done = subprocess.run(
        [sys.executable, "-m", f"valve_control.nodes.{node}", "--ros-args", "-p", argument],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1 and word in lines[0], done.stderr


def test_demo_over_dds_equals_offline(tmp_path):
    """`make demo` for one controller, as a user runs it; all four are what `make demo` itself shows."""
    import json

    done = subprocess.run(
        [sys.executable, "-m", "valve_control.nodes.demo", "--out", str(tmp_path), "--only", "oarc"],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "ROS_DOMAIN_ID": str(101)},
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (entry,) = json.loads((tmp_path / "demo.json").read_text())
    assert entry["samples"] > 5900
    assert entry["worst_deviation_from_offline"] < 0.15, done.stdout
    assert (tmp_path / "demo.png").exists()


def test_interrupted_demo_leaves_no_process(ros, tmp_path):
    child = subprocess.Popen(
        [sys.executable, "-m", "valve_control.nodes.demo", "--out", str(tmp_path)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        spin_until(ros, lambda: "valve_simulator" in ros.get_node_names(), "the demo's nodes")
        mine = children(child.pid)
        assert len(mine) >= 2
        child.send_signal(signal.SIGINT)
        assert child.wait(20.0) == 130
        assert not [pid for pid in mine if os.path.exists(f"/proc/{pid}")]
    finally:
        child.kill()
        child.wait()


def children(parent):
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/stat") as stream:
                    fields = stream.read().rsplit(")", 1)[1].split()
            except OSError:
                continue
            if int(fields[1]) == parent:
                found.append(int(entry))
    return found


def test_diagnostics_tell_what_is_missing(ros, tmp_path):
    messages = []
    ros.create_subscription(DiagnosticArray, "/diagnostics", messages.append, 10)
    with controller(tmp_path):
        spin_until(ros, lambda: bool(messages), "diagnostics")
    assert messages[0].status[0].message == "no LVDT reading yet"
    assert messages[0].status[0].level == b"\x01"
