# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A cascade of processes recorded over DDS, then analysed and replayed without it."""

import shutil
import signal
from contextlib import ExitStack

import numpy as np
import pytest
from bench import call, set_parameters, spin_until
from c_library import Library
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from std_msgs.msg import Float64

from research.campaigns.processes import node_arguments, process
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import CONTROLLER
from valve_control.export import unit
from valve_control.parameter import defaults
from valve_control.recordings import shadow_replay
from valve_control.recordings.analysis import analyze, as_dict
from valve_control.recordings.recording import load

LED = {"command.lag": 0.002, "reshaping.lead": 0.005}
RECORDED = (
    "/spool_position",
    "/valve_voltage",
    "/controller/state",
    "/controller/memory",
    "/controller/journal",
)


@pytest.mark.alone
@pytest.mark.parametrize(
    ("storage", "first", "period", "message"),
    [
        ("mcap", True, "3600.0", "command"),
        pytest.param("sqlite3", False, "0.2", "trajectory", marks=pytest.mark.campaign),
    ],
)
def test_shadow_is_the_recording_bit_for_bit(ros, tmp_path, monkeypatch, storage, first, period, message):
    """With live changes of parameters and of the law; the recorder comes before or after the controller.

    The upper level is slow, 100 Hz: trajectories, or commands that are joined by their stamps and led.

    The exported C of the laws gives the recorded voltages too.

    With a period of an hour there is an account of ~/memory only because a recorder came.
    """
    bag, log = tmp_path / "bag", tmp_path / "recorder.log"
    motion = {"listeners": 1, "message": message, "sample_period": 0.01, "scenario": "sine", "amplitude": 1.0}
    topics = (f"/spool_{message}", *RECORDED)
    arguments = {
        "recorder": ["-p", f"bag:={bag}", "-p", f"storage:={storage}"],
        "controller": [*node_arguments("controller", ["arc.yaml"], LED), "-p", f"memory_period:={period}"],
        "valve_simulator": node_arguments("valve_simulator", ["d3fxe.yaml"], {}),
        "command_source": node_arguments("command_source", ["command_source.yaml"], motion),
    }
    order = ["recorder", "controller"] if first else ["controller", "recorder"]

    def moved(count):
        """Until the controller has given this many voltages more."""
        seen = []
        subscription = ros.create_subscription(Float64, "valve_voltage", seen.append, 1000)
        spin_until(ros, lambda: len(seen) >= count, f"{count} voltages")
        ros.destroy_subscription(subscription)

    with ExitStack() as stack:
        running = {
            node: stack.enter_context(process(node, arguments[node], tmp_path / f"{node}.log"))
            for node in (*order, "valve_simulator", "command_source")
        }
        spin_until(ros, lambda: all(f"records {topic} " in log.read_text() for topic in topics), "topics")
        spin_until(
            ros, lambda: "parameters of /controller\n" in log.read_text(), "parameters of the controller"
        )
        moved(400)
        assert set_parameters(ros, arc__k1=90.0).successful
        moved(200)
        assert set_parameters(ros, controller="oarc").successful
        moved(200)
        assert set_parameters(ros, controller="pid", pid__form="plain").successful
        moved(200)
        for transition in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
            request = ChangeState.Request(transition=Transition(id=transition))
            assert call(ros, ChangeState, "/controller/change_state", request).success
        moved(200)
        for node in ("controller", "recorder"):
            running[node].send_signal(signal.SIGINT)
            spin_until(ros, lambda node=node: running[node].poll() is not None, f"end of the {node}")
            assert running[node].returncode == 0, (tmp_path / f"{node}.log").read_text()
    recording = load(bag, journals=True)
    result = shadow_replay.replay(recording.valves["valve"], {})
    # 1200 voltages were waited for once everything was recorded.
    assert result.faithful and len(result.voltage) > 1100
    assert result.differing == 0, (result.differences[:1], result.left_out)
    assert float(np.nanmax(np.abs(result.measurement))) > 0.5
    field = "positions[0]" if message == "trajectory" else "data"
    source = recording.valves["valve"].topics.sources["spool_command"]
    assert str(source) == f"/spool_{message}.{field}"
    assert not any("its account" in text or "missing" in text for text in result.left_out)
    if shutil.which("cc") is not None:
        for name in ("arc", "oarc", "pid"):
            in_c = Library(unit.law({**defaults(CONTROLLER), "controller": name}))
            monkeypatch.setitem(LAWS, name, LAWS[name]._replace(module=in_c))
        again = shadow_replay.replay(recording.valves["valve"], {})
        assert again.faithful and again.differing == 0
        assert np.array_equal(again.voltage, result.voltage)
        monkeypatch.undo()
    # The topic's messages are the journal's, one for one, since the recorder heard both until the last 0 V.
    heard = recording.valves["valve"].recorded["valve_voltage"].value
    both = min(len(heard), len(result.recorded))
    assert both > 1100 and np.array_equal(heard[-both:], result.recorded[-both:])
    about = as_dict(analyze(load(bag)))["valves"]["valve"]
    assert [c["values"] for c in about["changes"] if c["node"] == "/controller"] == [
        {"arc.k1": 90.0}, {"controller": "oarc"}, {"controller": "pid", "pid.form": "plain"}
    ]  # fmt: skip
    assert about["parameters"]["/controller"]["initial"]["arc.velocity_cutoff"] == 100.0
    assert about["parameters"]["/valve_simulator"]["initial"]["friction.coulomb"] > 0.0
