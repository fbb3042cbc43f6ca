# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the runs behind the paper's figures: which controller, which command, on the calibrated valve."""

from typing import Any, NamedTuple

from valve_control.control.commands.scenarios import sine_steps
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import NODES, VALVE
from valve_control.parameter import ParameterError, Values, defaults, number, updated

CONFIG = "d3fxe_experiment.yaml"
FEEDBACK = ("pid", "arc", "oarc")  # rows of Table 1, in its order
BANDWIDTH = 25.0  # Hz, of the paper's compensators
SINE = 6.0  # Hz, Fig. 4
OPEN_AMPLITUDE = 2.0  # V, well above friction, which no feedback overcomes
CLOSED_AMPLITUDE = 0.25  # V, at which the amplifier does not saturate below 30 Hz
FREQUENCIES = (1.0, 60.0)  # Hz, first and last of a response
STEPS, CYCLES, STEP_TIME = 18, 3, 0.7  # frequencies, cycles and seconds of each


class PaperRun(NamedTuple):
    """One run: its name and its settings."""

    name: str  # of its files
    settings: dict[str, dict[str, Any]]  # by node, over CONFIG


def valve_of(config: str) -> Values:
    """The simulator's values of the parameter file ``config``. Raises ParameterError."""
    given = files.load(config)["valve_simulator"]
    if not given:
        raise ParameterError(
            f"{config} has no parameters of valve_simulator; give the file of a calibrated valve"
        )
    return updated(VALVE, defaults(VALVE), given)


def valve_gain(valve: Values) -> float:
    """Static gain [V/V] of the valve with its flow force, without friction. Raises ParameterError."""
    gain = build.valve_model(valve).static_gain
    stiffness = 1.0 + gain * number(valve, "flow_force")
    if stiffness <= 0.0:
        raise ParameterError(
            f"flow_force is {number(valve, 'flow_force'):g} V/V; with this valve's gain of "
            f"{gain:.3g} V/V it must be above {-1.0 / gain:.3g} V/V, or the spool does not stay where it is"
        )
    return gain / stiffness


def stepped_sine(amplitude: float) -> dict[str, Any]:
    """Command of a frequency response."""
    steps = sine_steps(*FREQUENCIES, STEPS, CYCLES, STEP_TIME)
    return {
        "scenario": "stepped_sine", "frequency": FREQUENCIES[0], "end_frequency": FREQUENCIES[1],
        "steps": STEPS, "cycles": CYCLES, "step_time": STEP_TIME, "start": 0.0, "offset": 0.0,
        "duration": steps[-1].end + 0.1, "amplitude": amplitude,
    }  # fmt: skip


def open_loops(gain: float) -> dict[str, tuple[str, dict[str, Any]]]:
    """Label and controller settings of each open-loop law; ``gain`` [V/V]: static, of the valve."""
    designed = {
        "controller": "compensator",
        "compensator.design": "designed",
        "compensator.model": "fourth_order",
        "compensator.bandwidth": BANDWIDTH,
    }
    return {
        "open_loop": ("no compensator", {"controller": "open_loop", "open_loop.static_gain": gain}),
        "compensator_12": (
            "(12) as printed",
            {"controller": "compensator", "compensator.design": "printed_second_order"},
        ),
        "compensator_13": (
            "(13) as printed",
            {"controller": "compensator", "compensator.design": "printed_fourth_order"},
        ),
        "designed": ("ours, zeros cancelled too", designed),
    }


def paper_runs(valve: Values) -> list[PaperRun]:
    """All runs behind the figures; ``valve``: the simulator's values of CONFIG."""
    made = [PaperRun(f"table1_{name}", {"controller": {"controller": name}}) for name in FEEDBACK]
    sine = {
        "scenario": "sine", "frequency": SINE, "amplitude": OPEN_AMPLITUDE, "offset": 0.0, "start": 0.0,
        "duration": 2.0,
    }  # fmt: skip
    for name, (_, law) in open_loops(valve_gain(valve)).items():
        made.append(PaperRun(f"sine_{name}", {"controller": law, "command_source": sine}))
        source = stepped_sine(OPEN_AMPLITUDE)
        made.append(PaperRun(f"response_{name}", {"controller": law, "command_source": source}))
    for name in FEEDBACK:
        source = stepped_sine(CLOSED_AMPLITUDE)
        made.append(
            PaperRun(f"response_{name}", {"controller": {"controller": name}, "command_source": source})
        )
    return made


def values_of(run: PaperRun, config: dict[str, Values]) -> dict[str, Values]:
    """All values by node; ``config``: what CONFIG sets. Raises ParameterError."""
    return {
        node: updated(table, defaults(table), {**config[node], **run.settings.get(node, {})})
        for node, table in NODES.items()
        if node in ("controller", "valve_simulator", "command_source")
    }
