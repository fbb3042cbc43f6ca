# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The machine as it is exported: voltages and memory are those of the node's supervisor, bit for bit."""

import math
import types

import changed
import numpy as np
import pytest

from valve_control.control.laws.registry import LAWS
from valve_control.control.supervision.command_course import Motion
from valve_control.control.supervision.memory import Memory
from valve_control.export import samples, unit
from valve_control.export.kinds import Kind

KINDS = sorted({fault.what for fault in samples.FAULTS})
WORDS = dict.fromkeys(
    ["", "lvdt_not_finite", "lvdt_out_of_range", "lvdt_jump", "lvdt_frozen", "lvdt_silent", "lvdt_disagrees"]
    + ["law_not_finite", "limit_cycle", "oscillation", "lvdt_hum"]
)
WORDS = {word: i for i, word in enumerate(WORDS)}


def supervised(**changes):
    return unit.supervised(changed.controller(**changes))


def random_faults(seed, count=12, within=7.5):
    random = np.random.default_rng(seed)
    return [
        samples.Fault(float(random.uniform(0.02, within)), int(10 ** random.uniform(0.0, 2.5)), str(what))
        for what in random.choice(KINDS, count)
    ]


def compare(chosen, count, seed, faults=samples.FAULTS):
    """Step the watch through a run of the supervisor; returns the reasons for which the voltage was off."""
    module, p = chosen.module, chosen.params
    kind = Kind("record", module.State)
    m, off = Memory(), set()
    for event, given, supervisor, voltage in samples.faulty(chosen, count, seed, faults):
        found = 0.0
        if event in ("command", "at"):
            module.command(p, m, *(given if len(given) == 3 else (*given, math.nan, 0.0)))
        elif event == "point":
            found = module.trajectory(p, m, Motion(*given[:3]), *given[3:])
        elif event == "unpoint":
            module.trajectory_gone(m)
        elif event == "gone":
            module.command_gone(m)
        elif event == "reset":
            module.reset(p, m)
        elif event == "silence":
            found = module.silence(p, m, *given, False)
        else:
            found = module.sample(p, m, given[0], int(given[1]), 0.0, False)
        assert found == voltage, (event, m.now)
        wanted = unit.numbers(kind, unit.in_c(module, supervisor.memory), WORDS)
        assert unit.numbers(kind, unit.in_c(module, m), WORDS) == wanted, (event, m.now)
        off.add(m.trust.blocked)
    return off


def test_it_is_the_supervisor_bit_for_bit_through_all_faults():
    off = compare(supervised(controller="oarc"), 9600, 1)
    assert off == {"", "lvdt_not_finite", "lvdt_silent", "lvdt_jump", "lvdt_out_of_range", "lvdt_frozen",
                   "lvdt_disagrees", "limit_cycle"}  # fmt: skip


OTHERS = [
    {"controller": "dcarc", "reshaping__lead": 0.005, "reshaping__lead_accel": 1.0},
    {"controller": "pid", "pid__form": "plain", "lvdt__hold_samples": 0, "command_timeout": 0.0},
    {"controller": "arc", "lvdt__disturbance": 0.0, "lvdt__frozen_samples": 0, "lvdt__recovery_samples": 1},
    {"controller": "oarc", "command__lag": 0.002, "reshaping__lead": 0.005},
    {"controller": "compensator", "lockstep": True, "transfer_time": 0.5, "u_max": 3.0},
]


@pytest.mark.parametrize("changes", OTHERS, ids=[one["controller"] for one in OTHERS])
def test_with_other_parameters_and_random_faults(changes):
    compare(supervised(**changes), 1500, 3, random_faults(5, within=1.4))


def test_a_law_that_leaves_the_finite_numbers_is_switched_off(monkeypatch):
    pid = LAWS["pid"]

    def step(p, s, command, measurement, offset):
        voltage, s, terms = pid.module.step(p, s, command, measurement, offset)
        return (math.nan if 2.0 < command < 2.1 else voltage), s, terms

    parts = {name: getattr(pid.module, name) for name in ("Params", "State", "Terms", "initial", "hold")}
    module = types.SimpleNamespace(**parts, step=step, __name__=pid.module.__name__)
    monkeypatch.setitem(LAWS, "pid", pid._replace(module=module))
    chosen = supervised(controller="pid", pid__form="plain")
    assert "law_not_finite" in compare(chosen, 2500, 2)
