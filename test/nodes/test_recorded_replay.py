"""A cascade of processes recorded over DDS, then analysed and replayed without it."""

import signal
from contextlib import ExitStack

import numpy as np
import pytest
from bench import set_parameters, spin_until
from std_msgs.msg import Float64

from valve_control.nodes.cascade import node_arguments, process
from valve_control.recordings import shadow
from valve_control.recordings.recording import load
from valve_control.recordings.study import as_dict, study

RECORDED = (
    "/spool_command",
    "/spool_position",
    "/valve_voltage",
    "/controller/state",
    "/controller/memory",
    "/controller/journal",
)


@pytest.mark.parametrize(
    ("storage", "first", "period"), [("mcap", True, "3600.0"), ("sqlite3", False, "0.2")]
)
def test_shadow_is_the_recording_bit_for_bit(ros, tmp_path, storage, first, period):
    """With live changes of parameters and of the law; the recorder comes before or after the controller.

    With a period of an hour there is an account of ~/memory only because a recorder came.
    """
    bag, log = tmp_path / "bag", tmp_path / "recorder.log"
    arguments = {
        "recorder": ["-p", f"bag:={bag}", "-p", f"storage:={storage}"],
        "controller": [*node_arguments("controller", ["arc.yaml"], {}), "-p", f"memory_period:={period}"],
        "valve_simulator": node_arguments("valve_simulator", ["d3fxe.yaml"], {}),
        "command_source": node_arguments("command_source", ["command_source.yaml"], {"listeners": 1}),
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
        spin_until(ros, lambda: all(f"records {topic} " in log.read_text() for topic in RECORDED), "topics")
        spin_until(
            ros, lambda: "parameters of /controller\n" in log.read_text(), "parameters of the controller"
        )
        moved(800)
        assert set_parameters(ros, arc__k1=90.0).successful
        moved(400)
        assert set_parameters(ros, controller="oarc").successful
        moved(400)
        assert set_parameters(ros, controller="pid", pid__form="plain").successful
        moved(400)
        running["recorder"].send_signal(signal.SIGINT)
        spin_until(ros, lambda: running["recorder"].poll() is not None, "end of the recorder")
        assert running["recorder"].returncode == 0, log.read_text()
    result = shadow.replay(load(bag, journals=True).valves["valve"], {})
    # 2000 voltages were waited for once everything was recorded; the journal comes in parts of 100 rows.
    assert result.faithful and np.count_nonzero(np.isfinite(result.recorded)) > 1800
    assert result.differing == 0, (result.first_difference, result.left_out)
    assert not any("went on from" in text or "does not hold" in text for text in result.left_out)
    about = as_dict(study(load(bag)))["valves"]["valve"]
    assert [c["values"] for c in about["changes"] if c["node"] == "/controller"] == [
        {"arc.k1": 90.0}, {"controller": "oarc"}, {"controller": "pid", "pid.form": "plain"}
    ]  # fmt: skip
    assert about["parameters"]["/controller"]["initial"]["arc.velocity_cutoff"] == 100.0
    assert about["parameters"]["/valve_simulator"]["initial"]["friction.coulomb"] > 0.0
