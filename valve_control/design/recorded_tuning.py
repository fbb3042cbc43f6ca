# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tunes on a recording of normal operation: on its valve, controller and command."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.simulation.robustness import Quantity, Settings
from valve_control.design.commissioning import recorded as learning
from valve_control.design.commissioning.recorded import RecordedValve
from valve_control.design.identification import recorded as tests
from valve_control.design.tuning import box
from valve_control.design.tuning.trial import TuningMotion
from valve_control.parameter import ParameterError, Values, number, updated
from valve_control.recordings import recording
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.recording import Recording, ValveRecording


class RecordedRun(NamedTuple):
    """What a recorded run says of its valve, and what to tune on."""

    fitted: RecordedValve
    settings: Settings  # parameters by node
    box: list[Quantity]  # around the fitted valve
    motion: TuningMotion
    notes: Sequence[str]


def recorded_run(
    name: str,
    loaded: Recording,
    valve: ValveRecording,
    settings: Settings,
    quantities: Sequence[Quantity],
    fixed: Sequence[str],
    chosen: Values,
) -> RecordedRun:
    """What the recording ``name`` of a ``valve`` says, beside the known ``settings``.

    ``quantities`` of the box that it does not determine stay; ``fixed`` ones keep their value. ``chosen``:
    the controller's parameters that somebody has chosen. Raises ParameterError and BagError.
    """
    if "spool_command" not in valve.signals or len(valve.signals["spool_command"].time) == 0:
        raise BagError(f"{valve.name} has no spool_command, so there is nothing to tune on")
    tested = tests.recorded(loaded, valve)
    constant = [form.name for form in learning.FORMS if form.name in fixed]
    fitted = learning.learnt(tested, settings["valve_simulator"], constant)
    controller = updated(
        CONTROLLER,
        _controller(valve, settings["controller"], chosen),
        {"sample_period": tested.period, "u_max": number(fitted.values, "u_max")},
    )
    command = recording.align(valve).command
    wanted = learning.motion(command, tested.period, number(controller, "command_limit"))
    if float(wanted.max() - wanted.min()) == 0.0:
        raise ParameterError(f"{name} has no excitation: its command does not move")
    source = {**settings["command_source"], "sample_period": tested.period}
    own = {"controller": controller, "valve_simulator": fitted.values, "command_source": source}
    box.check_reach(fitted.values, float(wanted[abs(wanted).argmax()]), f"of {name}")
    return RecordedRun(
        fitted=fitted,
        settings={**settings, **own},
        box=learning.box(fitted, quantities),
        motion=TuningMotion(name, wanted),
        notes=[*fitted.notes, *tested.notes],
    )


def _controller(valve: ValveRecording, usual: Values, chosen: Values) -> Values:
    """The controller's parameters as recorded, else the ``usual`` ones; what is ``chosen`` wins."""
    if valve.controller is None:
        return usual
    last = dict(valve.controller.initial)
    for change in valve.controller.changes:
        last.update(change.values)
    values, _ = valve.controller.table_values(last)
    return updated(CONTROLLER, values, chosen)


def as_dict(run: RecordedRun) -> dict[str, Any]:
    """For JSON: the quantities of the fitted valve, and the rms residual [V] of its readings."""
    return {
        "valve": {
            one.name: {
                "value": one.value,
                "bound": one.bound if one.determined else None,
                "determined": one.determined,
            }
            for one in run.fitted.learnt
        },
        "residual": run.fitted.residual,
    }
