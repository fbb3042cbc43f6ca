"""Reset, saved parameters, real-time care, several valves in one process."""

import os

import pytest
import yaml
from bench import Motion, call, controller, get_double, set_parameters, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from std_srvs.srv import Trigger

from valve_control.nodes.cascade import process
from valve_control.parameters import build, files
from valve_control.parameters.table import CONTROLLER, defaults, updated


def diagnostics(ros, name):
    """The newest values of ``name`` in /diagnostics, and its message."""
    got = {}

    def take(message):
        for status in message.status:
            if status.name == name:
                got.update({entry.key: entry.value for entry in status.values}, message=status.message)

    subscription = ros.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
    spin_until(ros, lambda: got, f"diagnostics of {name}")
    ros.destroy_subscription(subscription)
    return got


def theta(bench):
    bench.settle()
    names = [d.label for d in bench.states[-1].layout.dim]
    return [bench.states[-1].data[names.index(n)] for n in ("a1", "a0", "b0", "b0dn")]


def test_reset_puts_the_estimates_back_to_their_start_without_a_bump(ros, tmp_path):
    motion = Motion(ros)
    with controller(tmp_path, "-p", "arc.velocity_cutoff:=30.0"):
        motion.bench.connect()
        motion.move(600)
        assert theta(motion.bench) != [20.0, 1200.0, 1200.0, 0.0]
        assert call(ros, Trigger, "/controller/reset", Trigger.Request()).success
        motion.move(1)
        assert theta(motion.bench) == [20.0, 1200.0, 1200.0, 0.0]
        assert abs(motion.voltages[-1] - motion.voltages[-2]) < 0.5


def test_saved_parameters_are_read_back_with_the_present_estimates(ros, tmp_path):
    motion = Motion(ros)
    path = tmp_path / "saved.yaml"
    with controller(tmp_path, "-p", f"save_file:={path}", "-p", "arc.k2:=99.0"):
        motion.bench.connect()
        motion.move(600)
        answer = call(ros, Trigger, "/controller/save_parameters", Trigger.Request())
        assert answer.success and str(path) in answer.message
        motion.move(1)
        estimates = theta(motion.bench)
    saved = files.load(str(path))["controller"]
    build.law_params(updated(CONTROLLER, defaults(CONTROLLER), saved))
    assert saved["arc.k2"] == 99.0 and saved["arc.theta_initial"] == pytest.approx(estimates, rel=1e-12)
    assert set(saved) == {p.name for p in CONTROLLER}
    with process("controller", ["--params-file", str(path)], tmp_path / "again.log"):
        assert get_double(ros, "arc.k2") == 99.0
        request = GetParameters.Request(names=["arc.theta_initial"])
        got = call(ros, GetParameters, "/controller/get_parameters", request).values[0].double_array_value
        assert list(got) == pytest.approx(estimates, rel=1e-12)


def test_parameters_that_cannot_be_saved_are_said_to_be_so(ros, tmp_path):
    with controller(tmp_path, "-p", f"save_file:={tmp_path}/missing/saved.yaml"):
        answer = call(ros, Trigger, "/controller/save_parameters", Trigger.Request())
        assert not answer.success and "cannot be written" in answer.message
    kept = tmp_path / "kept.yaml"
    kept.write_text("as before")
    with pytest.raises(OSError):
        files.save(kept / "below", "/controller", {"u_max": 10.0})
    assert kept.read_text() == "as before"


def test_namespaced_parameters_are_saved_under_their_full_name(tmp_path):
    path = tmp_path / "p.yaml"
    files.save(
        path, "/excavator/boom/controller", {"arc.epsilon": 1e6, "controller": "arc", "lockstep": False}
    )
    tree = yaml.safe_load(path.read_text())
    assert tree["/excavator/boom/controller"]["ros__parameters"]["arc"]["epsilon"] == 1e6
    assert files.load(str(path))["controller"]["arc.epsilon"] == 1e6


def test_scheduler_and_cpus_are_those_really_obtained(ros, tmp_path):
    arguments = [
        "-p",
        "realtime.priority:=20",
        "-p",
        "realtime.cpus:='0'",
        "-p",
        "realtime.lock_memory:=true",
    ]
    with controller(tmp_path, *arguments) as child:
        got = diagnostics(ros, "controller")
        policy = os.sched_getscheduler(child.pid)
        assert got["scheduler"] == {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO 20"}[policy]
        assert os.sched_getaffinity(child.pid) == {0} and got["cpus"] == "0"
        with open(f"/proc/{child.pid}/status", encoding="ascii") as status:
            locked = next(line.split()[1] for line in status if line.startswith("VmLck"))
        assert (int(got["locked_memory_kB"]) > 0) == (int(locked) > 0)
    log = (tmp_path / "c.log").read_text()
    assert (policy == os.SCHED_FIFO) != ("realtime.priority: 20 not obtained" in log)
    assert (int(locked) > 0) != ("realtime.lock_memory: not locked" in log)


def test_cpu_that_is_not_there_is_refused(ros, tmp_path):
    with controller(tmp_path):
        result = set_parameters(ros, realtime__cpus="4096")
        assert not result.successful and "4096" in result.reason
        assert not set_parameters(ros, realtime__cpus="first").successful


def test_diagnostics_have_the_figures(ros, tmp_path):
    motion = Motion(ros)
    with controller(tmp_path):
        motion.bench.connect()
        motion.move(300)
        got = diagnostics(ros, "controller")
    wanted = """mode samples lvdt_lost lvdt_refused command_refused command_limited overruns saturation_share
        command_age_s period_ms jitter_ms_p99 latency_ms_p50 latency_ms_p99 latency_ms_max step_ms_p50
        theta lyapunov lyapunov_bound scheduler cpus locked_memory_kB assumption_violations"""
    assert set(wanted.split()) <= set(got)
    assert got["message"] == "controlling" and int(got["samples"]) >= 300
    assert float(got["lyapunov"]) <= float(got["lyapunov_bound"])


def test_manifold_hosts_several_valves_with_their_own_parameters(ros, tmp_path):
    path = tmp_path / "valves.yaml"
    path.write_text(
        """
/**/manifold:
  ros__parameters:
    valves: [boom, arm]
/**/boom/controller:
  ros__parameters: {arc: {k1: 77.0}}
/**/arm/controller:
  ros__parameters: {controller: pid}
"""
    )
    arguments = ["--params-file", str(path), "-r", "__ns:=/digger"]
    with process("manifold", arguments, tmp_path / "log") as child:
        assert get_double(ros, "arc.k1", "digger/boom/controller") == 77.0
        assert get_double(ros, "arc.k1", "digger/arm/controller") == 120.0
        assert set_parameters(ros, "digger/arm/controller", pid__kp=5.0).successful
        assert get_double(ros, "pid.kp", "digger/arm/controller") == 5.0
        assert get_double(ros, "pid.kp", "digger/boom/controller") == 3.837
        spin_until(ros, lambda: ros.count_publishers("/digger/arm/valve_voltage") == 1, "arm")
        assert not set_parameters(ros, "digger/manifold", valves=["boom"]).successful
        child.terminate()
        assert child.wait(10.0) == 0


@pytest.mark.parametrize(
    ("valves", "word"),
    [("[boom, boom]", "twice"), ("['1st']", "1st"), ("['a b']", "a b"), ("[1.0]", "valves")],
)
def test_manifold_with_bad_names_says_so(tmp_path, valves, word):
    with process("manifold", ["-p", f"valves:={valves}"], tmp_path / "log") as child:
        assert child.wait(30.0) == 2
    lines = (tmp_path / "log").read_text().strip().splitlines()
    assert len(lines) == 1 and word in lines[0], lines
