# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters of `controller` and those of several nodes."""

from types import FunctionType

from valve_control.control import compiling, plugins
from valve_control.control.laws import linearisation, registry, reshaping
from valve_control.control.laws.common import SAMPLE_PERIOD, U_MAX
from valve_control.control.laws.law import Law
from valve_control.control.laws.registry import LAWS, LEFT_OUT
from valve_control.parameter import Parameter, ParameterError, Table, running

AUTOSTART = Parameter(
    "autostart", True, "", "configure and activate at the start; false waits for transitions", node_only=True
)
REALTIME: Table = running(
    Parameter("realtime.lock_memory", False, "", "lock the process in memory (mlockall)"),
    Parameter("realtime.priority", 0, "", "SCHED_FIFO priority of all threads; 0: leave it", 0, 99),
    Parameter("realtime.cpus", "", "", "CPUs the process may use, such as 2 or 2,3; empty: leave them"),
)

CONTROLLER: list[Parameter] = [  # that ``add_law`` changes
    Parameter(
        "controller",
        "arc",
        "",
        "control law; changing it while running is bumpless",
        choices=tuple(LAWS),
        left_out=tuple(LEFT_OUT.items()),
    ),
    SAMPLE_PERIOD,
    U_MAX,
    Parameter("command_limit", 10.0, "V", "commands are limited to ± this", 0.1, 100.0),
    Parameter(
        "command.bridge",
        0.006,
        "s",
        "time for which the motion continues with its derivatives if a command or a point of a "
        "trajectory is late; then it returns to the last one",
        0.0,
        0.1,
    ),
    Parameter(
        "command.lag",
        0.0,
        "s",
        "time by which the law follows the motion of the commands later; a motion that is less far ahead "
        "of the newest command is better known; 0.0: the motion at the time of the reading",
        0.0,
        0.05,
    ),
    Parameter(
        "transfer_time", 0.05, "s", "time constant with which the step between two laws decays", 0.001, 10.0
    ),
    Parameter("state_decimation", 10, "", "every n-th sample appears on ~/state; 0: none", 0, 100000),
    Parameter(
        "memory_period",
        1.0,
        "s",
        "time between two snapshots of the state of the controller on ~/memory, from which the replay of "
        "a recording can start in its middle; 0.0: no snapshots and no ~/journal",
        0.0,
        3600.0,
    ),
    Parameter(
        "command_timeout",
        0.5,
        "s",
        "silence of the command that returns the spool to neutral; 0.0: none",
        0.0,
        1e6,
    ),
    Parameter("neutral_rate", 20.0, "V/s", "largest rate on the return to neutral", 0.01, 1e5),
    Parameter("neutral_accel", 400.0, "V/s²", "largest acceleration on the return to neutral", 0.1, 1e7),
    Parameter("saturation_limit", 1.0, "s", "longest saturation that is not reported", 0.001, 1e6),
    Parameter(
        "oscillation_limit",
        1.0,
        "V",
        "least amplitude of a sustained oscillation of the voltage that is reported, unless the command "
        "explains it; 0.0: neither this report nor the stop of cycles at the limit of the voltage",
        0.0,
        1000.0,
    ),
    Parameter("lvdt.hold_samples", 20, "", "missing or unusable readings in a row before 0 V", 0, 10000),
    Parameter("lvdt.recovery_samples", 20, "", "sound readings in a row that end the 0 V", 1, 100000),
    Parameter("lvdt.limit", 11.0, "V", "readings beyond ± this are out of range", 0.1, 1000.0),
    Parameter("lvdt.max_rate", 500.0, "V/s", "highest speed of the spool; faster readings jump", 0.1, 1e7),
    Parameter("lvdt.tolerance", 0.1, "V", "jump that noise alone can make", 0.0, 100.0),
    Parameter(
        "lvdt.frozen_samples", 20, "", "equal readings in a row that may be frozen; 0: no check", 0, 100000
    ),
    Parameter(
        "lvdt.frozen_voltage",
        0.5,
        "V",
        "change of the voltage during equal readings from which a noisy LVDT counts as frozen; a quiet "
        "LVDT is judged by lvdt.disturbance and by its previous speed",
        0.001,
        100.0,
    ),
    Parameter(
        "lvdt.period_limit",
        0.15,
        "-",
        "largest relative deviation of the period of the readings from sample_period; beyond it the "
        "voltage is 0 V; from 2 % on it is reported",
        0.02,
        1000.0,
    ),
    Parameter(
        "lvdt.disturbance",
        5.0,
        "V",
        "largest sum of friction and offset; readings that oppose a larger voltage, or move against the "
        "voltage, have the wrong sign or slope, and readings of a quiet converter that stand still "
        "against it are frozen; 0.0: readings are not compared with the voltage, and the check of "
        "standing readings uses 5 V",
        0.0,
        100.0,
    ),
    Parameter(
        "lvdt.excitation", 0.1, "V", "least deviation of voltage and reading that are compared", 0.001, 100.0
    ),
    Parameter("lvdt.slow", 1.0, "V/s", "least speed of readings that are compared with voltages", 0.01, 1e4),
    Parameter(
        "lvdt.hold_off",
        0.3,
        "s",
        "time at 0 V after a jump of the readings or their disagreement with the voltage; it doubles "
        "with each further one, until motion has shown that they agree",
        0.001,
        1e6,
    ),
    Parameter("lvdt.hold_off_limit", 60.0, "s", "largest value of this time", 0.001, 1e6),
    Parameter("lockstep", False, "", "wait at each reading for the command of the same number"),
    Parameter(
        "save_file",
        "",
        "",
        "file of ~/save_parameters, from the folder of the start; empty: that of /boom/controller is "
        "boom_controller.yaml",
        node_only=True,
    ),
    Parameter("load_file", "", "", "file of ~/load_parameters, likewise; empty: save_file", node_only=True),
    AUTOSTART,
    *REALTIME,
    *reshaping.PARAMETERS,
    *linearisation.PARAMETERS,
    *(parameter for law in LAWS.values() for parameter in law.parameters),
]
_added: dict[str, tuple[Law, dict[str, object]]] = {}  # as they came, with the content of their modules


def add_law(law: Law) -> None:
    """Add ``law`` to the laws of this process, or put it in place of another package's law of that name.

    Raises ParameterError if it does not work.
    """
    content = getattr(law.module, "__dict__", {}).items()  # which IPython's autoreload changes in place
    now = {n: getattr(v, "__code__", v) for n, v in content if isinstance(v, (FunctionType, int, float))}
    if _added.get(law.name) == (law, now):
        return
    others = {n: known for n, known in LAWS.items() if n != law.name or known.package == plugins.PACKAGE}
    before = LAWS.get(law.name, law).parameters
    try:
        LAWS[law.name] = registry.usable(law, law.module.__name__, others)
    except Exception as error:  # its first step may raise any
        reason = str(error) if isinstance(error, plugins.PluginError) else compiling.in_words(error)
        raise ParameterError(f"the law '{law.name}' does not work: {reason}") from error
    CONTROLLER[:] = [parameter for parameter in CONTROLLER if parameter not in before] + [*law.parameters]
    CONTROLLER[0] = CONTROLLER[0]._replace(choices=tuple(LAWS))
    _added[law.name] = law, now
