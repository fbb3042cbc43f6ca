# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Lists the parameters of all nodes; descriptors, YAML, command line and reference are made from it."""

from valve_control.control.laws import linearisation, reshaping
from valve_control.control.laws.common import SAMPLE_PERIOD, U_MAX
from valve_control.control.laws.registry import LAWS, LEFT_OUT
from valve_control.control.plant import common, models, registry, sensor
from valve_control.parameter import Parameter, Table

AUTOSTART = Parameter(
    "autostart", True, "", "configure and activate at the start; false waits for lifecycle transitions"
)
REALTIME: Table = (
    Parameter("realtime.lock_memory", False, "", "lock the process in memory (mlockall)"),
    Parameter(
        "realtime.priority", 0, "", "SCHED_FIFO priority of all threads; 0: leave the scheduler", 0, 99
    ),
    Parameter("realtime.cpus", "", "", "CPUs the process may use, such as 2 or 2,3; empty: leave them"),
)
FAULT_SAMPLES = Parameter(
    "fault.samples", 0, "", "samples that an injected fault lasts; 0: until it is set to none", 0, 10**9
)

CONTROLLER: Table = (
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
        "transfer_time",
        0.05,
        "s",
        "time constant with which the step between two laws decays after a change of controller",
        0.001,
        10.0,
    ),
    Parameter("state_decimation", 10, "", "every n-th sample appears on ~/state; 0: none", 0, 100000),
    Parameter(
        "state_topics",
        [""],
        "",
        "terms of ~/state that are also published as single numbers on ~/terms/NAME, for tools that show "
        "no labels; terms that the present law does not have are not published; empty: none",
    ),
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
        "silence of the command after which the spool returns to neutral; 0.0: never",
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
    Parameter(
        "lvdt.hold_samples",
        20,
        "",
        "largest number of missing or unusable LVDT readings in a row that is bridged; after one more "
        "the voltage is 0 V",
        0,
        10000,
    ),
    Parameter(
        "lvdt.recovery_samples",
        20,
        "",
        "sound LVDT readings in a row after which control returns from 0 V",
        1,
        100000,
    ),
    Parameter("lvdt.limit", 11.0, "V", "readings beyond ± this are out of range", 0.1, 1000.0),
    Parameter(
        "lvdt.max_rate",
        500.0,
        "V/s",
        "highest speed of the spool; a faster change of the reading is a jump",
        0.1,
        1e7,
    ),
    Parameter("lvdt.tolerance", 0.1, "V", "jump that noise alone can make", 0.0, 100.0),
    Parameter(
        "lvdt.frozen_samples",
        20,
        "",
        "number of equal readings in a row after which the LVDT is checked for freezing; 0: no check",
        0,
        100000,
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
        "lvdt.excitation",
        0.1,
        "V",
        "least standard deviation of voltage and reading in motion at which they are compared",
        0.001,
        100.0,
    ),
    Parameter(
        "lvdt.slow",
        1.0,
        "V/s",
        "least speed of the readings at which they are compared with the voltage",
        0.01,
        1e4,
    ),
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
    Parameter(
        "lockstep",
        False,
        "",
        "wait at each reading for the command of the same number (for a valve_simulator with clock: "
        "lockstep and a command source)",
    ),
    Parameter(
        "save_file",
        "controller.yaml",
        "",
        "file of ~/save_parameters, absolute or relative to the folder in which the node was started",
    ),
    Parameter(
        "load_file",
        "",
        "",
        "file of ~/load_parameters, absolute or relative to the same folder; empty: save_file",
    ),
    AUTOSTART,
    *REALTIME,
    *reshaping.PARAMETERS,
    *linearisation.PARAMETERS,
    *(parameter for law in LAWS.values() for parameter in law.parameters),
)

VALVE: Table = (
    SAMPLE_PERIOD,
    U_MAX,
    Parameter(
        "valve",
        "fourth_order",
        "",
        "model of the valve: second_order (2), fourth_order (3) or custom: linear; solenoid: coil, "
        "hysteresis, two sides, spool with friction and stops",
        choices=tuple(registry.CHOICES),
        left_out=tuple(registry.LEFT_OUT.items()),
    ),
    *models.custom_parameters(""),
    common.GAIN_SCALE,
    Parameter("seed", 1, "", "seed of the LVDT noise", 0, 2**31 - 1),
    Parameter(
        "patience",
        0.01,
        "s",
        "longest delay of the next sample while the voltage is late; then the last voltage holds",
        0.0,
        1.0,
    ),
    *common.DISTURBANCES,
    Parameter(
        "listeners", 1, "", "lockstep: number of subscriptions to wait for before the first reading", 1, 100
    ),
    *sensor.PARAMETERS,
    Parameter(
        "clock",
        "wall",
        "",
        "wall: one sample per period of real time; lockstep: the next as soon as the voltage has come",
        choices=("wall", "lockstep"),
    ),
    Parameter(
        "voltage_timeout",
        0.1,
        "s",
        "silence of the voltage after which it counts as 0 V and the spring centres the spool; 0.0: never",
        0.0,
        1e6,
    ),
    Parameter(
        "fault.lvdt",
        "none",
        "",
        "injected fault of the LVDT; lost: the reading is sent as a frame that DDS cannot read; flipped: "
        "wrong sign; half: half of the gain",
        choices=(
            "none",
            "lost",
            "silent",
            "frozen",
            "out_of_range",
            "not_finite",
            "jump",
            "flipped",
            "half",
            "second_publisher",
        ),
    ),
    Parameter("fault.jump", 3.0, "V", "size of the fault jump", -100.0, 100.0),
    Parameter(
        "fault.valve",
        "none",
        "",
        "injected fault of the valve: a stuck spool, or a weak solenoid (a fifth of the gain)",
        choices=("none", "stuck", "weak"),
    ),
    FAULT_SAMPLES,
    AUTOSTART,
    *REALTIME,
    *(parameter for plant in registry.PLANTS.values() for parameter in plant.parameters),
)

COMMAND: Table = (
    SAMPLE_PERIOD,
    Parameter(
        "scenario",
        "point_to_point",
        "",
        "command shape, or array for the numbers in command_file",
        choices=("point_to_point", "sine", "triangle", "step", "sweep", "stepped_sine", "constant", "array"),
    ),
    Parameter("command_file", "", "", "CSV or NPY file with one command per sample period (array)"),
    Parameter(
        "trigger",
        "timer",
        "",
        "trigger of the commands: a timer of the node, spool_position (one command per reading), "
        "valve_voltage (one command per voltage, before the next reading), or lockstep (the first "
        "command at once, then one per reading, none lost)",
        choices=("timer", "spool_position", "valve_voltage", "lockstep"),
    ),
    Parameter(
        "message",
        "command",
        "",
        "command: numbers on spool_command; trajectory: points with derivatives on spool_trajectory",
        choices=("command", "trajectory"),
    ),
    Parameter("every", 1, "", "number of sample periods from one message to the next", 1, 1000),
    Parameter("listeners", 1, "", "number of subscriptions to wait for before the command begins", 0, 100),
    Parameter(
        "delay", 0.5, "s", "pause between the arrival of these subscriptions and the beginning", 0.0, 1e6
    ),
    Parameter("duration", 6.0, "s", "duration of the command; afterwards the last command holds", 0.001, 1e6),
    Parameter("amplitude", 2.92, "V", "height, stroke or amplitude", -10.0, 10.0),
    Parameter("offset", 0.0, "V", "added to the command", -10.0, 10.0),
    Parameter("start", 0.25, "s", "standstill before the motion", 0.0, 1e6),
    Parameter(
        "frequency",
        6.0,
        "Hz",
        "frequency of sine and triangle; start of the sweep; first frequency of the stepped sine",
        1e-4,
        1e4,
    ),
    Parameter("end_frequency", 60.0, "Hz", "end of the sweep; last frequency of the stepped sine", 1e-4, 1e4),
    Parameter("sweep_time", 5.0, "s", "duration of the sweep", 1e-3, 1e6),
    Parameter(
        "steps", 30, "", "number of frequencies of the stepped sine, spaced evenly in logarithm", 1, 1000
    ),
    Parameter(
        "cycles",
        5,
        "",
        "number of cycles of the triangle; least number at each frequency of the stepped sine",
        1,
        10000,
    ),
    Parameter("step_time", 1.0, "s", "least time of each frequency of the stepped sine", 0.0, 1e4),
    Parameter("max_velocity", 8.0, "V/s", "largest velocity of the point-to-point motion", 1e-3, 1e4),
    Parameter("max_accel", 64.0, "V/s²", "largest acceleration of the point-to-point motion", 1e-3, 1e6),
    Parameter("cycle", 5.81, "s", "period of the point-to-point motion, there and back", 1e-2, 1e6),
    Parameter(
        "fault.command",
        "none",
        "",
        "injected fault of the command",
        choices=("none", "silent", "not_finite", "out_of_range", "second_publisher"),
    ),
    FAULT_SAMPLES,
)

MANIFOLD: Table = (
    Parameter(
        "valves",
        ["valve_1", "valve_2"],
        "",
        "names of the valves; each gets a namespace and a node of its own in this process",
    ),
    Parameter(
        "node",
        "controller",
        "",
        "node that is hosted for each valve",
        choices=("controller", "valve_simulator"),
    ),
)

RECORDER: Table = (
    Parameter("bag", "", "", "folder to write, which must not exist; empty: valve_bag_<date>_<time> here"),
    Parameter(
        "storage",
        "auto",
        "",
        "storage of the bag; auto: mcap, or sqlite3 where the Python package mcap is not installed",
        choices=("auto", "mcap", "sqlite3"),
    ),
    Parameter(
        "compression",
        "none",
        "",
        "compression of the bag's chunks; storage sqlite3 has none",
        choices=("none", "zstd", "lz4"),
    ),
    Parameter(
        "topics",
        [""],
        "",
        "regular expressions, one of which must match the whole name of a topic; empty: the topics of "
        "all valves and axes, /diagnostics and /clock; /parameter_events is always recorded",
    ),
    Parameter(
        "flush_period",
        0.25,
        "s",
        "longest part of the recording that is lost if the recorder is killed",
        0.02,
        1.0,
    ),
    Parameter("min_free", 64.0, "MB", "free space on the disk at which the recording ends", 0.0, 1e6),
)

DASHBOARD: Table = (
    Parameter("port", 8080, "", "port of the page on 127.0.0.1; 0: any free port", 0, 65535),
    Parameter(
        "token",
        "",
        "",
        "token in the address of the page (?token=...) that permits changes; empty: a new one at each start",
    ),
    Parameter("folder", "out/dashboard", "", "folder of recordings, reports and results of runs"),
)

ROS = ("use_sim_time", "start_type_description_service")
NODES: dict[str, Table] = {
    "controller": CONTROLLER,
    "valve_simulator": VALVE,
    "command_source": COMMAND,
    "manifold": MANIFOLD,
    "recorder": RECORDER,
    "dashboard": DASHBOARD,
}
OTHERS = ("axis_simulator", "axis_controller", "valve_driver")  # nodes of this package with other tables

# What running nodes alone read, so that it does nothing offline.
NODE_ONLY = frozenset(
    {p.name for p in (AUTOSTART, *REALTIME, *MANIFOLD, *RECORDER, *DASHBOARD)}
    | {p.name for p in (*VALVE, *COMMAND) if p.name.startswith("fault.")}
    | {"save_file", "load_file", "state_topics"}
    | {"patience", "listeners", "clock", "voltage_timeout", "trigger", "every", "delay"}
)


def is_of_ros(name: str) -> bool:
    """Whether ``name`` is a parameter that ROS itself gives to every node."""
    return name in ROS or name.startswith("qos_overrides.")
