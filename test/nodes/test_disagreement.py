# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The real nodes with an LVDT that lies, in lockstep: the controller says so and holds the valve off."""

import numpy as np

from valve_control.nodes.harness.lockstep import CONFIG, run_lockstep


def test_an_lvdt_of_wrong_sign_is_named_and_held_off(ros, tmp_path):
    run = run_lockstep(
        "flipped",
        CONFIG,
        {
            "controller": {"controller": "arc"},
            "valve_simulator": {"fault.lvdt": "flipped"},
            "command_source": {"scenario": "sine", "frequency": 1.5, "amplitude": 2.0, "duration": 3.0},
        },
        tmp_path,
    )
    said = (tmp_path / "lockstep_flipped_controller.log").read_text()
    assert "safe: LVDT readings disagree with the voltage: wrong sign" in said
    voltage = np.array(run.samples["valve_voltage"])
    assert np.mean(np.abs(voltage) == 10.0) < 0.05 and np.mean(voltage == 0.0) > 0.5
