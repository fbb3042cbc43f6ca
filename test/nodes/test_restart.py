# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Processes killed with SIGKILL in mid-run and started again, each before and after each other one."""

import itertools
import signal
from contextlib import ExitStack

import numpy as np
import pytest
import sizes
from bench import spin_until

from research.campaigns.processes import Listener, process

PARTIES = ("controller", "valve_simulator", "command_source")
QUICK = PARTIES[::-1]  # order of killing
# In this one and its reverse each is killed before and after each other one.
CAMPAIGN = [order for order in itertools.permutations(PARTIES) if order != QUICK] if sizes.FULL else [PARTIES]
ARGUMENTS = {
    "controller": ["-p", "lvdt.hold_samples:=50"],
    "valve_simulator": ["-p", "lvdt.noise:=0.002"],
    "command_source": [
        "-p", "scenario:=sine", "-p", "frequency:=1.0", "-p", "amplitude:=2.0", "-p", "start:=0.0",
        "-p", "delay:=0.0", "-p", "duration:=200.0",
    ],
}  # fmt: skip


@pytest.mark.alone
@pytest.mark.parametrize(
    "order",
    [QUICK, *(pytest.param(order, marks=pytest.mark.campaign) for order in CAMPAIGN)],
    ids="-".join,
)
def test_loop_closes_again_after_each_kill(ros, tmp_path, order):
    listener = Listener("ear")
    children = {}
    try:
        with ExitStack() as stack:

            def start(name):
                log = tmp_path / f"{name}_{len(list(tmp_path.iterdir()))}.log"
                children[name] = stack.enter_context(process(name, ARGUMENTS[name], log))

            def follows():
                """Command, reading and voltage flow, and the reading is where the command was."""
                listener.fetch()
                values = {topic: np.array(numbers[-400:]) for topic, numbers in listener.values.items()}
                fresh = all(len(numbers) - seen[topic] > 400 for topic, numbers in listener.values.items())
                if not fresh:
                    return False
                command, reading = values["spool_command"], values["spool_position"]
                return np.ptp(command) > 0.5 and np.max(np.abs(reading[-300:] - command[-300:])) < 0.5

            seen = dict.fromkeys(listener.values, 0)
            for name in PARTIES:
                start(name)
            spin_until(ros, follows, "the closed loop")
            for name in order:
                children[name].send_signal(signal.SIGKILL)
                children[name].wait()
                others = [other for other in PARTIES if other != name]
                assert all(children[other].poll() is None for other in others)
                seen = {topic: len(numbers) for topic, numbers in listener.values.items()}
                start(name)
                spin_until(ros, follows, f"the loop after the death of {name}")
            voltages = np.array(listener.values["valve_voltage"])
            assert np.all(np.isfinite(voltages)) and np.max(np.abs(voltages)) <= 10.0
    finally:
        listener.destroy_node()
    for log in tmp_path.glob("*.log"):
        assert "Traceback" not in log.read_text(), log
