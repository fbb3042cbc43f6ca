# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reset, saved parameters, real-time care, several valves in one process."""

import os

import pytest
from bench import Motion, call, controller, get_double, set_parameters, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from std_srvs.srv import Trigger

from research.campaigns.processes import process
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.parameter import defaults, updated


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
    return [bench.state()[name] for name in ("a1", "a0", "b0", "b0dn")]


def test_reset_puts_the_estimates_back_without_a_bump_and_diagnostics_have_the_figures(ros, tmp_path):
    motion = Motion(ros)
    with controller(tmp_path, "-p", "arc.velocity_cutoff:=30.0"):
        motion.bench.connect()
        motion.move(600)
        assert theta(motion.bench) != [20.0, 1200.0, 1200.0, 0.0]
        assert call(ros, Trigger, "/controller/reset", Trigger.Request()).success
        motion.move(1)
        assert theta(motion.bench) == [20.0, 1200.0, 1200.0, 0.0]
        assert abs(motion.voltages[-1] - motion.voltages[-2]) < 0.5
        motion.move(299)
        got = diagnostics(ros, "controller")
    wanted = """mode samples lvdt_lost lvdt_refused command_refused command_limited overruns saturation_share
        period_ms jitter_ms_p99 latency_ms_p50 latency_ms_p99 latency_ms_max step_ms_p50
        theta lyapunov lyapunov_bound scheduler cpus locked_memory_kB assumption_violations"""
    assert set(wanted.split()) <= set(got)
    assert got["message"] == "controlling" and int(got["samples"]) >= 900
    assert float(got["lyapunov"]) <= float(got["lyapunov_bound"])


def test_saved_parameters_are_loaded_and_read_back_with_the_present_estimates(ros, tmp_path):
    motion = Motion(ros)
    path = tmp_path / "saved.yaml"
    with controller(tmp_path, "-p", f"save_file:={path}", "-p", "arc.k2:=99.0"):
        motion.bench.connect()
        motion.move(600)
        answer = call(ros, Trigger, "/controller/save_parameters", Trigger.Request())
        assert answer.success and str(path) in answer.message
        motion.move(1)
        estimates = theta(motion.bench)
        assert set_parameters(ros, arc__k2=50.0, u_max=7.0).successful
        answer = call(ros, Trigger, "/controller/load_parameters", Trigger.Request())
        assert answer.success and "of which 3 changed" in answer.message  # and the estimates
        answer = call(ros, Trigger, "/controller/load_parameters", Trigger.Request())
        assert answer.success and "of which 0 changed" in answer.message
        assert get_double(ros, "arc.k2") == 99.0 and get_double(ros, "u_max") == 10.0
    saved = files.load(str(path))["controller"]
    build.law_params(updated(CONTROLLER, defaults(CONTROLLER), saved))
    assert saved["arc.k2"] == 99.0 and saved["arc.theta_initial"] == pytest.approx(estimates, rel=1e-12)
    assert set(saved) == {p.name for p in CONTROLLER}
    with process("controller", ["--params-file", str(path)], tmp_path / "again.log"):
        assert get_double(ros, "arc.k2") == 99.0
        request = GetParameters.Request(names=["arc.theta_initial"])
        got = call(ros, GetParameters, "/controller/get_parameters", request).values[0].double_array_value
        assert list(got) == pytest.approx(estimates, rel=1e-12)


def test_parameters_are_loaded_as_a_whole_or_not_at_all(ros, tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(
        "/**/controller:\n  ros__parameters: {arc: {k1: 99.0, k2: 98.0}, u_max: 8.0, controller: pid}\n"
    )
    with controller(tmp_path, "-p", f"load_file:={path}"):
        answer = call(ros, Trigger, "/controller/load_parameters", Trigger.Request())
        assert answer.success, answer.message
        assert answer.message == f"4 parameters from {path}, of which 4 changed"
        assert [get_double(ros, name) for name in ("arc.k1", "arc.k2", "u_max")] == [99.0, 98.0, 8.0]
        for wrong, words in [
            ("arc: {k1: 77.0, k2: -5.0}", ["arc.k2 is -5", "between"]),
            ("arc: {k1: 77.0, k22: 5.0}", ["'arc.k22'; did you mean 'arc.k2'"]),
            ("arc: {k1: 77.0, k2: fast}", ["arc.k2", "double"]),
            (
                "sample_period: 0.001, arc: {k1: 77.0}, reshaping: {natural_frequency: 9000.0}",
                ["must be below"],
            ),
        ]:
            path.write_text(f"/controller:\n  ros__parameters: {{{wrong}}}\n")
            answer = call(ros, Trigger, "/controller/load_parameters", Trigger.Request())
            assert not answer.success and "\n" not in answer.message
            for word in ["no parameter changed", str(path), *words]:
                assert word in answer.message, answer.message
            assert get_double(ros, "arc.k1") == 99.0
        for text, word in [("/arm/controller: {ros__parameters: {u_max: 5.0}}", "nothing for /controller"),
                           ("[", "not YAML"), (None, "cannot be read")]:  # fmt: skip
            path.unlink(missing_ok=True)
            if text is not None:
                path.write_text(text)
            answer = call(ros, Trigger, "/controller/load_parameters", Trigger.Request())
            assert not answer.success and word in answer.message and "\n" not in answer.message


def test_scheduler_and_cpus_are_those_really_obtained(ros, tmp_path):
    cpu = min(os.sched_getaffinity(0))
    arguments = [
        "-p",
        "realtime.priority:=20",
        "-p",
        f"realtime.cpus:='{cpu}'",
        "-p",
        "realtime.lock_memory:=true",
    ]
    with controller(tmp_path, *arguments) as child:
        got = diagnostics(ros, "controller")
        policy = os.sched_getscheduler(child.pid)
        assert got["scheduler"] == {os.SCHED_OTHER: "SCHED_OTHER", os.SCHED_FIFO: "SCHED_FIFO 20"}[policy]
        assert os.sched_getaffinity(child.pid) == {cpu} and got["cpus"] == str(cpu)
        with open(f"/proc/{child.pid}/status", encoding="ascii") as status:
            locked = next(line.split()[1] for line in status if line.startswith("VmLck"))
        assert (int(got["locked_memory_kB"]) > 0) == (int(locked) > 0)
    log = (tmp_path / "c.log").read_text()
    assert (policy == os.SCHED_FIFO) != ("realtime.priority: 20 not obtained" in log)
    assert (int(locked) > 0) != ("realtime.lock_memory: not locked" in log)


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
/**:
  ros__parameters: {robot: digger}
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
    assert f"section '/**' of {path}: there is no parameter 'robot'" in (tmp_path / "log").read_text()
