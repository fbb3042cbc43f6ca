# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The fault campaign, law by law, as `make faults` runs it for every law."""

import math

import pytest
import sizes
from bench import run_tool

from research.campaigns import drivers
from research.campaigns.faults import CONTROLLERS, FAULTS

# That a law after the first one meets too, unless all do: what it says of its limits depends on the law.
TWICE = ("lvdt_silent", "lvdt_frozen", "command_silent")


def met(law):
    """Names of the faults that the campaign injects under ``law``."""
    own = {fault.name for fault in FAULTS if law in fault.controllers}
    first = {fault.name for fault in FAULTS if sizes.LAWS[0] in fault.controllers}
    return own if sizes.FULL or law == sizes.LAWS[0] else own - (first - set(TWICE))


def test_the_laws_of_the_campaign_meet_every_fault():
    assert set().union(*map(met, sizes.LAWS)) == {fault.name for fault in FAULTS}


@pytest.mark.alone
@pytest.mark.campaign
@pytest.mark.parametrize("controller", sizes.LAWS)
def test_each_fault(tmp_path, controller):
    """Each law has moments of its own; one that fails is repeated without the others."""
    moments = str(1 + CONTROLLERS.index(controller))
    chosen = [word for name in sorted(met(controller)) for word in ("--fault", name)]
    entries = run_tool("faults", tmp_path, "--only", controller, "--seed", moments, *chosen, timeout=400)
    assert {e["controller"] for e in entries} == {controller}
    assert {e["fault"] for e in entries} == met(controller)
    assert sum(e["repeated"] for e in entries) <= len(entries) / 3, entries
    for entry in entries:
        assert entry["recovered"] and entry["reaction_s"] <= entry["limit_s"], entry
        assert math.isfinite(entry["max_abs_voltage"]) and entry["max_abs_voltage"] <= 10.0


@pytest.mark.alone
@pytest.mark.campaign
@pytest.mark.parametrize("driver", drivers.KINDS)
def test_each_fault_of_a_device(tmp_path, driver):
    entries = run_tool("faults", tmp_path, "--only", driver, timeout=400)
    assert [(e["driver"], e["fault"]) for e in entries] == [
        (fault.driver, fault.name) for fault in drivers.FAULTS if fault.driver == driver
    ]
    assert sum(e["repeated"] for e in entries) <= len(entries) / 3, entries
    for entry in entries:
        assert entry["passed"], entry
