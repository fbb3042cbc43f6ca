# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Faults and a wrong rate, injected into running nodes and recorded: what the analysis of the bag tells."""

import signal
import time
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest
from bench import set_parameters, spin_until
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64

from valve_control.nodes.harness.processes import process
from valve_control.recordings import analysis_report
from valve_control.recordings.analysis import analyze, as_dict
from valve_control.recordings.recording import load

RECORDED = ("/spool_command", "/spool_position", "/valve_voltage", "/controller/state", "/diagnostics")
MOVING = [
    "-p", "scenario:=sine", "-p", "amplitude:=2.0", "-p", "frequency:=1.5", "-p", "start:=0.0",
    "-p", "duration:=200.0", "-p", "delay:=0.0",
]  # fmt: skip
TRIES, SAID = 5, 3.0  # s
FAULTS = (  # node, parameter, value, mode that follows, what is said of it
    ("valve_simulator", "fault.lvdt", "silent", "safe", "silent"),
    ("command_source", "fault.command", "not_finite", "degraded", "refused"),
    ("valve_simulator", "fault.lvdt", "jump", "safe", "jump"),
    ("valve_simulator", "fault.lvdt", "not_finite", "safe", "not finite"),
)


class Watch:
    """What the controller says, as somebody hears it who is there."""

    def __init__(self, node):
        self.node = node
        self.heard = []  # mode and message of each change
        node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 1000)

    def _hear(self, message):
        for status in message.status:
            mode = next((pair.value for pair in status.values if pair.key == "mode"), None)
            if status.name == "controller" and mode and self.heard[-1:] != [(mode, status.message)]:
                self.heard.append((mode, status.message))

    def says(self, mode, word, since=0):
        return any(m == mode and word in text for m, text in self.heard[since:])

    def inject(self, node, name, value, mode, word):
        """A fault until it is said, then order. Where the valve is off for another reason, it is not said."""
        fault = name.replace(".", "__")
        for _ in range(TRIES):
            since = len(self.heard)
            assert set_parameters(self.node, node, **{fault: value}).successful
            end = time.monotonic() + SAID
            spin_until(
                self.node, lambda s=since, e=end: self.says(mode, word, s) or time.monotonic() > e, word
            )
            said = self.says(mode, word, since)
            since = len(self.heard)
            assert set_parameters(self.node, node, **{fault: "none"}).successful
            spin_until(self.node, lambda s=since: self.says("ok", "controlling", s), "order")
            if said:
                return
        raise AssertionError(f"{mode} {word} not said in {TRIES} tries")


@contextmanager
def recorded_cascade(ros, tmp_path, valve=()):
    """A moving cascade, all of which is recorded."""
    arguments = {
        "recorder": ["-p", f"bag:={tmp_path / 'bag'}"],
        "controller": ["-p", "controller:=pid"],
        "valve_simulator": ["-p", "lvdt.noise:=0.004", *valve],
        "command_source": MOVING,
    }
    log = tmp_path / "recorder.log"
    with ExitStack() as stack:
        running = {}
        for node, own in arguments.items():
            running[node] = stack.enter_context(process(node, own, tmp_path / f"{node}.log"))
        spin_until(ros, lambda: all(f"records {topic} " in log.read_text() for topic in RECORDED), "topics")
        spin_until(ros, lambda: "parameters of /controller\n" in log.read_text(), "parameters")
        yield
        running["recorder"].send_signal(signal.SIGINT)
        spin_until(ros, lambda: running["recorder"].poll() is not None, "end of the recorder")
        assert running["recorder"].returncode == 0, log.read_text()


@pytest.mark.alone
@pytest.mark.campaign
def test_the_modes_of_a_recorded_campaign_are_those_that_were_said(ros, tmp_path):
    watch = Watch(ros)
    with recorded_cascade(ros, tmp_path):
        spin_until(ros, lambda: watch.says("ok", "controlling"), "order")
        for fault in FAULTS:
            watch.inject(*fault)
    loaded = load(tmp_path / "bag")
    result = analyze(loaded)
    valve = as_dict(result)["valves"]["valve"]
    about = valve["modes"]
    # In the order in which they were injected, each with what was said of it.
    intervals = iter(about["intervals"])
    for *_, mode, word in FAULTS:
        assert any(i["mode"] == mode and any(word in text for text in i["reasons"]) for i in intervals), word
    said = {text for mode, message in watch.heard if mode != "ok" for text in message.split("; ")}
    before = {"no LVDT reading yet", "no command yet"}  # said before anybody was there
    assert {text for i in about["intervals"] for text in i["reasons"]} <= said | before
    # In a safe interval 0 V is sent, and control sends none. A mode is said right after the voltage with
    # which it begins; on a busy machine the voltages of readings that waited come between.
    voltage = loaded.valves["valve"].signals["valve_voltage"]
    sent = (voltage.time - result.valves["valve"].signals.stamp[0]) * 1e-9
    safe = np.zeros(len(sent), dtype=bool)
    for i in about["intervals"]:
        if i["mode"] == "safe":
            safe |= (sent > i["start_s"]) & (sent < i["end_s"])
    run = sent > 0.0
    zero = voltage.value == 0.0
    assert np.count_nonzero(safe & run) > 50
    assert np.count_nonzero((safe != zero) & run) < 0.05 * np.count_nonzero(run)
    text = analysis_report.of_bag(result, {}).text
    assert about["safe"]["intervals"] >= 3 and f"safe {about['safe']['intervals']} times" in text
    for _, name, value, *_ in FAULTS:
        assert f"{name} = {value} (at " in text or name == "fault.command"


@pytest.mark.alone
@pytest.mark.campaign
@pytest.mark.parametrize("period", [0.0012, 0.002])
def test_the_rate_of_recorded_readings_is_measured(ros, tmp_path, period):
    with recorded_cascade(ros, tmp_path, ["-p", f"sample_period:={period}"]):
        seen = []
        ros.create_subscription(Float64, "spool_position", seen.append, 1000)
        spin_until(ros, lambda: len(seen) > 2000, "2000 readings")
    result = analyze(load(tmp_path / "bag"))
    about = as_dict(result)["valves"]["valve"]["lvdt_period"]
    assert about["measured_s"] == pytest.approx(period, rel=0.01) and about["sample_period_s"] == 0.001
    found = about["measured_s"] * 1e3
    assert (
        f"LVDT readings come every {found:.4g} ms, sample_period is 1 ms"
        in analysis_report.of_bag(result, {}).text
    )
