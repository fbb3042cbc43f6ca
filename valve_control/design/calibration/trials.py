# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tries a calibrated valve where it was not fitted: other noise, other motions, a drifted valve."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from valve_control import parameter
from valve_control.control.analysis.indices import Indices
from valve_control.control.parameters.table import NODES
from valve_control.design.calibration import objective
from valve_control.design.calibration.space import Settings
from valve_control.parameter import updated

DRIFT = 0.2  # relative change of gain, friction and flow force


class Trial(NamedTuple):
    """One case, with the indices of each controller in it."""

    name: str
    found: dict[str, Indices]


def _with(base: Settings, node: str, **values: Any) -> Settings:
    named = {name.replace("__", "."): value for name, value in values.items()}
    return {**base, node: updated(NODES[node], base[node], named)}


def trials(settings: Settings, controllers: Sequence[str]) -> list[Trial]:
    """Simulate the calibrated case, three other noise seeds, two other motions, and drifts by 20 %."""
    valve, command = settings["valve_simulator"], settings["command_source"]
    seed = int(parameter.number(valve, "seed"))
    cases: list[tuple[str, Settings, int]] = [("as calibrated", settings, seed)]
    cases += [(f"noise seed {seed + i}", settings, seed + i) for i in (1, 2, 3)]
    slower = {name: 0.5 * parameter.number(command, name) for name in ("max_velocity", "max_accel")}
    slower["cycle"] = 2.0 * parameter.number(command, "cycle")  # the strokes take longer
    cases.append(("half velocity and acceleration", _with(settings, "command_source", **slower), seed))
    cases.append(
        (
            "sine 2 Hz, 1 V",
            _with(settings, "command_source", scenario="sine", frequency=2.0, amplitude=1.0, offset=0.0),
            seed,
        )
    )
    for name, key in (("gain", "gain_scale"), ("friction", "friction.coulomb"), ("flow force", "flow_force")):
        for sign in (1.0, -1.0):
            drifted = {key: parameter.number(valve, key) * (1.0 + sign * DRIFT)}
            cases.append(
                (f"{name} {100 * sign * DRIFT:+.0f} %", _with(settings, "valve_simulator", **drifted), seed)
            )
    return [
        Trial(name, {c: runs[0] for c, runs in objective.run(case, controllers, [number]).items()})
        for name, case, number in cases
    ]
