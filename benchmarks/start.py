# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Start: a controller from its command to active, and ``valve-control --help``."""

import os
import subprocess
import sys
import threading
import time
from typing import Any

from tqdm import tqdm

RUNS = 7
LIMIT = 30.0  # s
WANTED = {"start_controller_s": ("at most", 1.5), "start_help_s": ("at most", 0.3)}
WORDS = "waiting for spool_position"  # a controller's first as an active node
COMMANDS = {
    "controller": ["-m", "valve_control.nodes.controller"],
    "help": ["-m", "valve_control.cli", "--help"],
    "bare rclpy": ["-c", "import rclpy; rclpy.init(); rclpy.create_node('bare')"],
    "bare python": ["-c", ""],
}


def took(name: str) -> float:
    """Seconds until the controller is active, or another command has ended. Raises RuntimeError."""
    began = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, *COMMANDS[name]], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as child:
        assert child.stdout is not None
        watchdog = threading.Timer(LIMIT, child.kill)
        watchdog.start()
        text = ""
        for line in child.stdout:
            text += line
            if WORDS in line:
                break
        if name != "controller":
            child.wait()
        seconds = time.perf_counter() - began
        watchdog.cancel()
        if name == "controller":
            child.terminate()
    if child.returncode != 0 or (name == "controller" and WORDS not in text):
        raise RuntimeError(f"{name} ended with status {child.returncode}: {text.strip()}")
    return seconds


def run() -> dict[str, Any]:
    """Measure; a table, and the figures for JSON. Raises RuntimeError."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    each: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in tqdm(range(RUNS), desc="start", unit="run", ascii=True):
        for name, times in each.items():
            times.append(took(name))
    print(f"\n{'start':14}{'median [s]':>12}{'most [s]':>10}")
    median = {name: sorted(times)[RUNS // 2] for name, times in each.items()}
    for name, times in each.items():
        print(f"{name:14}{median[name]:12.2f}{max(times):10.2f}")
    return {
        "each_s": each,
        "figures": {"start_controller_s": median["controller"], "start_help_s": median["help"]},
    }
