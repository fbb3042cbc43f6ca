# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Disturbs a running controller as other programs could: clients that leave, a storm of changes, a rival."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_parameters
from std_msgs.msg import Float64

from valve_control.design.priority import yield_cores
from valve_control.nodes.adapter import SAMPLES

MEET = 10.0  # s until a client sees its server
PATIENCE = 5.0  # s for the last answers
STORM_RATE = 100.0  # 1/s; 200 and a look each 1 ms fill two cores, and the simulator loses samples
LOOK = 0.005  # s between two looks for answers


def leave(count: int, target: str) -> None:
    """Start ``count`` clients that ask ``target`` for a parameter and leave before the answer comes."""
    rclpy.init(args=[])
    for i in range(count):
        node = rclpy.create_node(f"leaver_{i}")
        client = node.create_client(GetParameters, f"{target}/get_parameters")
        if not client.wait_for_service(MEET):
            raise RuntimeError(f"{target} does not answer")
        client.call_async(GetParameters.Request(names=["controller"]))
        node.destroy_client(client)
        node.destroy_node()
    rclpy.shutdown()
    print(json.dumps({"left": count}), flush=True)


def storm(seconds: float, target: str, name: str, values: tuple[float, float]) -> None:
    """Set the parameter ``name`` at most STORM_RATE times a second, each time after the last answer."""
    rclpy.init(args=[])
    node = rclpy.create_node("storm")
    client = node.create_client(SetParameters, f"{target}/set_parameters", qos_profile=qos_profile_parameters)
    if not client.wait_for_service(MEET):
        raise RuntimeError(f"{target} does not answer")
    # A server that has not seen this client yet takes its time; that is not what is measured.
    first = client.call_async(_change(name, values[0]))
    rclpy.spin_until_future_complete(node, first, timeout_sec=MEET)
    # Requests and answers without an executor, whose share of a core the cascade would lack.
    took: list[float] = []
    refused: list[str] = []
    asked: dict[int, float] = {}
    due = time.monotonic()
    end = due + seconds
    with client.handle:
        while (now := time.monotonic()) < end or (len(took) < len(asked) and now < end + PATIENCE):
            if due <= now < end and len(took) == len(asked):
                asked[client.handle.send_request(_change(name, values[len(asked) % 2]))] = now
                due = now + 1.0 / STORM_RATE
            while (answer := client.handle.take_response(SetParameters.Response)) is not None:
                header, response = answer
                if response is None:
                    break
                took.append(time.monotonic() - asked[header.request_id.sequence_number])
                refused.extend(result.reason for result in response.results if not result.successful)
            time.sleep(LOOK)
    node.destroy_node()
    rclpy.shutdown()
    p50, p99 = np.quantile(took, [0.5, 0.99]) if took else (None, None)
    told = {"asked": len(asked), "answered": len(took), "refused": refused[:3], "p50_s": p50, "p99_s": p99}
    print(json.dumps(told), flush=True)


def _change(name: str, value: float) -> SetParameters.Request:
    return SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])


class Stranger:
    """One of these disturbances, running in a process of its own."""

    def __init__(self, child: subprocess.Popen[bytes], log: Path) -> None:
        self._child = child
        self._log = log

    def over(self) -> bool:
        """Whether it has finished. Raises RuntimeError if it failed."""
        status = self._child.poll()
        if status is not None and status != 0:
            raise RuntimeError(f"{self._log.stem} ended with status {status}")
        return status is not None

    def told(self) -> dict[str, Any]:
        """What it counted, once it has finished."""
        found: dict[str, Any] = json.loads(self._log.read_text(encoding="utf-8").splitlines()[-1])
        return found


@contextmanager
def stranger(call: str, log: Path) -> Iterator[Stranger]:
    """Call a function of this module in a process, which has ended when the block ends."""
    text = f"from {__name__} import leave, storm; {call}"
    with log.open("wb") as output:
        child = subprocess.Popen(
            [sys.executable, "-c", text],
            stdout=output,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=yield_cores,
        )
        try:
            yield Stranger(child, log)
        finally:
            child.kill()
            child.wait()


@contextmanager
def rival(node: Any, topic: str) -> Iterator[None]:
    """Publish numbers on ``topic`` from a second node, as another controller would its voltages."""
    publisher = node.create_publisher(Float64, topic, SAMPLES)
    try:
        yield
    finally:
        node.destroy_publisher(publisher)
