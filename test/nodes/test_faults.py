"""The whole fault campaign, as `make faults` runs it."""

import math

import pytest
from bench import HeldUpError, run_tool

from valve_control.nodes.harness.faults import CONTROLLERS, FAULTS

pytestmark = pytest.mark.campaign


def test_each_fault_on_each_controller(tmp_path):
    try:
        entries = run_tool("faults", tmp_path)
    except HeldUpError as error:
        pytest.skip(f"this machine does not keep 1 kHz just now, so the faults show nothing: {error}"[:400])
    expected = {(fault.name, controller) for fault in FAULTS for controller in fault.controllers}
    assert {(e["fault"], e["controller"]) for e in entries} == expected
    assert {e["controller"] for e in entries} == set(CONTROLLERS)
    for entry in entries:
        assert entry["recovered"] and entry["reaction_s"] <= entry["limit_s"], entry
        assert math.isfinite(entry["max_abs_voltage"]) and entry["max_abs_voltage"] <= 10.0
