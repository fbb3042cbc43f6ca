# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The dashboard's node and server without a browser: what it serves and to whom, and how it ends."""

import importlib.util
import json
import signal
import socket
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from bench import Motion, beside, controller, spin_until
from browser import get, until
from frame import signals_of
from launched import command as launch
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from research.campaigns.processes import process

SIGNALS = ["command", "position", "error", "voltage", "term.unsaturated_voltage"]


def started(log):
    until(lambda: "open http" in log.read_text(), f"the address in {log}")
    return log.read_text().split("open ")[1].split()[0]


def request(end=None, span=20.0):
    return json.dumps({"valve": "/", "signals": SIGNALS, "span": span, "end": end, "columns": 2000})


@contextmanager
def connected(motion, tmp_path):
    """A controller that the bench has met before anybody else listens."""
    with controller(tmp_path):
        motion.bench.connect()
        yield


def test_every_sample_of_the_loop_is_in_the_frames(ros, tmp_path):
    motion = Motion(ros)
    arguments = ["-p", "port:=0", "-p", "token:=t", "-p", f"folder:={tmp_path}/made"]
    with (
        connected(motion, tmp_path),
        process("dashboard", arguments, tmp_path / "d.log") as child,
    ):
        address = started(tmp_path / "d.log")
        spin_until(
            ros, lambda: motion.bench.lvdt.get_subscription_count() == 2, "the dashboard's subscription"
        )
        wire = f"{address.split('?')[0].replace('http', 'ws')}frames"
        with connect(wire) as page:

            def seen():
                page.send(request())
                return signals_of(page.recv())

            # Until what has just met carries; the term has a publisher only since the page wants it.
            wanted = ("voltage", "term.unsaturated_voltage")
            until(lambda: motion.move(5) or all(seen()[name].size for name in wanted), "first samples")
            motion.bench.settle()
            motion.move(300)
            sent = motion.voltages[-300:]
            until(lambda: seen()["voltage"][1][-1:] == np.float32(sent[-1]), "the last voltage")
            frame = seen()
            assert np.array_equal(frame["voltage"][1][-300:], np.array(sent, dtype=np.float32))
            assert np.array_equal(frame["voltage"][1], frame["voltage"][2])  # samples as they are
            t, error, _ = frame["error"]
            position = frame["position"][1][-len(error) :]
            command = frame["command"][1]
            held = command[np.searchsorted(frame["command"][0], t[-200:], side="right") - 1]
            np.testing.assert_allclose(error[-200:], position[-200:] - held, atol=1e-6)
            assert frame["term.unsaturated_voltage"].shape[1] >= 300
            page.send("this is no request")
            with pytest.raises(ConnectionClosed, match="no request for a frame"):
                page.recv()
        # Pages of other hosts get neither the page nor the data.
        own = address.split("?")[0]
        assert get(own)[0] == 200
        assert get(own, Host="evil.example")[0] == 400
        with pytest.raises(InvalidStatus):
            connect(wire, additional_headers={"Origin": "http://evil.example"})
        began = time.monotonic()
        child.terminate()
        assert child.wait(20.0) == 0, (tmp_path / "d.log").read_text()
        assert time.monotonic() - began < 20.0
    assert "Traceback" not in (tmp_path / "d.log").read_text()


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as found:
        return found.getsockname()[1]


@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="needs ros2 launch")
@pytest.mark.parametrize("name", ["valve", "cascade", "axis", "arm"])
def test_a_launch_file_starts_the_page_on_the_port_that_is_asked_for(name, tmp_path):
    path = Path(__file__).resolve().parents[2] / "launch" / f"{name}.launch.xml"
    port, log = free_port(), tmp_path / "launch.log"
    with log.open("wb") as output:
        child = subprocess.Popen(
            launch(path, "dashboard:=true", f"port:={port}"),
            cwd=tmp_path, stdout=output, stderr=output, stdin=subprocess.DEVNULL, start_new_session=True,
            env=beside(),
        )  # fmt: skip
        try:
            address = started(log)
            assert address.startswith(f"http://127.0.0.1:{port}/?token=")
            assert get(address)[0] == 200
        finally:
            child.send_signal(signal.SIGINT)
            child.wait(30.0)
    said = log.read_text()
    assert "Traceback" not in said, said
    with socket.create_server(("127.0.0.1", port)):  # nobody listens there any more
        pass
