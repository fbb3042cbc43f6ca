"""The parameters of all nodes in one table; descriptors, YAML, command line and README come from it."""

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

Value = bool | int | float | str | list[float] | list[str]
Values = dict[str, Value]


class ParameterError(ValueError):
    """A parameter that cannot be taken; the message is one sentence for the user."""


class Parameter(NamedTuple):
    """One parameter. Its type is that of its default."""

    name: str
    default: Value
    unit: str
    text: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    length: int = 0  # of an array, 0: any

    @property
    def type_name(self) -> str:
        """Type in words."""
        if isinstance(self.default, bool):
            return "bool"
        if isinstance(self.default, list):
            return f"list of {self._entry[1]}"
        return {int: "integer", float: "double", str: "string"}[type(self.default)]

    @property
    def _entry(self) -> tuple[type, str]:
        """Type of an array's entries, and its name."""
        assert isinstance(self.default, list)
        return (str, "strings") if isinstance(self.default[0], str) else (float, "doubles")

    def check(self, value: object) -> Value:
        """``value`` itself if it can be taken. Raises ParameterError otherwise."""
        if isinstance(self.default, (bool, str)):
            if type(value) is not type(self.default):
                raise ParameterError(self._wrong_type(value))
            assert isinstance(value, (bool, str))
            if self.choices and value not in self.choices:
                raise ParameterError(f"{self.name} is '{value}'; it must be {one_of(self.choices)}")
            return value
        if isinstance(self.default, list):
            if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
                raise ParameterError(self._wrong_type(value))
            entries = list(value)
            if any(type(v) is not self._entry[0] for v in entries):
                raise ParameterError(self._wrong_type(entries))
            if self.length and len(entries) != self.length:
                raise ParameterError(f"{self.name} has {len(entries)} entries; it must have {self.length}")
            if self._entry[0] is float:
                for i, number in enumerate(entries):
                    self._check_range(number, f"{self.name}[{i}]")
            return entries
        if type(value) is not type(self.default):
            raise ParameterError(self._wrong_type(value))
        assert isinstance(value, (int, float))
        self._check_range(value, self.name)
        return value

    def _wrong_type(self, value: object) -> str:
        doubles = self.type_name.endswith(("double", "doubles"))
        hint = " (write 120.0, not 120)" if doubles else ""
        return f"{self.name} is {value!r}; it must be a {self.type_name}{hint}"

    def _check_range(self, number: float, name: str) -> None:
        if not math.isfinite(number):
            raise ParameterError(f"{name} is {number}; it must be finite")
        if not self.low <= number <= self.high:
            unit = "" if self.unit == "-" else f" {self.unit}"
            raise ParameterError(
                f"{name} is {number:g}{unit}; it must lie between {self.low:g} and {self.high:g}{unit}"
            )


Table = tuple[Parameter, ...]


def one_of(words: Iterable[str]) -> str:
    """``words`` as "a, b or c"."""
    *most, last = [f"'{word}'" for word in words]
    return f"{', '.join(most)} or {last}" if most else last


THETA = "[a1 1/s, a0 1/s², b0 1/s², b0·dn V/s²]"
THETA_INITIAL = [20.0, 1200.0, 1200.0, 0.0]
THETA_MIN = [5.0, 500.0, 900.0, -6000.0]
THETA_MAX = [150.0, 3000.0, 2500.0, 6000.0]
BIG = 1e12
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

SAMPLE_PERIOD = Parameter("sample_period", 0.001, "s", "sample period ΔT of LVDT and controller", 1e-5, 0.1)
U_MAX = Parameter("u_max", 10.0, "V", "limit of the solenoid voltage", 0.1, 100.0)


def _estimates(law: str, gamma: list[float]) -> Table:
    return (
        Parameter(
            f"{law}.gamma",
            gamma,
            "",
            "diagonal of the adaptation rate matrix Γ of (15)",
            0.0,
            BIG,
            length=4,
        ),
        Parameter(
            f"{law}.theta_initial",
            THETA_INITIAL,
            "",
            f"initial estimates θ̂(0): {THETA}; setting it starts the estimates anew",
            -1e9,
            1e9,
            length=4,
        ),
        Parameter(
            f"{law}.theta_min",
            THETA_MIN,
            "",
            f"lower bounds of θ, (5): {THETA}",
            -1e9,
            1e9,
            length=4,
        ),
        Parameter(
            f"{law}.theta_max",
            THETA_MAX,
            "",
            f"upper bounds of θ, (5): {THETA}",
            -1e9,
            1e9,
            length=4,
        ),
        Parameter(
            f"{law}.robust_term",
            "none",
            "",
            "robust term: none, or the smooth quadratic one that satisfies (23), (42), (50)",
            choices=("none", "quadratic"),
        ),
    )


def _custom_model(prefix: str) -> Table:
    return (
        Parameter(
            f"{prefix}numerator",
            [1502.057],
            "",
            "custom model, numerator in s, highest power first",
            -BIG,
            BIG,
        ),
        Parameter(
            f"{prefix}denominator",
            [1.0, 58.771, 1657.206],
            "",
            "custom model, denominator in s, highest power first",
            -BIG,
            BIG,
        ),
    )


CONTROLLER: Table = (
    Parameter(
        "controller",
        "arc",
        "",
        "control law; changing it while running is bumpless",
        choices=("arc", "oarc", "pid", "compensator", "open_loop"),
    ),
    SAMPLE_PERIOD,
    U_MAX,
    Parameter("command_limit", 10.0, "V", "commands are limited to ± this", 0.1, 100.0),
    Parameter(
        "transfer_time",
        0.05,
        "s",
        "time constant with which the step between two laws fades after a change of controller",
        0.001,
        10.0,
    ),
    Parameter("state_decimation", 10, "", "every n-th sample appears on ~/state; 0: none", 0, 100000),
    Parameter(
        "memory_period",
        1.0,
        "s",
        "time between two accounts of all that the controller remembers, on ~/memory, with which a recording "
        "can be replayed from its middle; 0.0: none, and no ~/journal",
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
    Parameter("saturation_limit", 1.0, "s", "saturation that lasts longer is reported", 0.001, 1e6),
    Parameter(
        "lvdt.hold_samples",
        20,
        "",
        "missing or unusable LVDT readings in a row that are bridged; after one more the voltage is 0 V",
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
        "fastest motion of a spool; a reading that moved faster is a jump",
        0.1,
        1e7,
    ),
    Parameter("lvdt.tolerance", 0.1, "V", "jump that noise alone can make", 0.0, 100.0),
    Parameter(
        "lvdt.frozen_samples",
        20,
        "",
        "equal readings in a row, while the voltage moves, that mean a frozen LVDT; 0: not watched",
        0,
        100000,
    ),
    Parameter(
        "lvdt.frozen_voltage",
        0.5,
        "V",
        "motion of the voltage that must show in the reading unless the LVDT is frozen",
        0.001,
        100.0,
    ),
    Parameter(
        "lockstep",
        False,
        "",
        "wait at each reading for the command of the same number (for clock: lockstep with a command source)",
    ),
    Parameter(
        "save_file",
        "controller.yaml",
        "",
        "file of ~/save_parameters, absolute or relative to the folder in which the node was started",
    ),
    AUTOSTART,
    *REALTIME,
    Parameter("reshaping.natural_frequency", 314.0, "rad/s", "natural frequency ω_n of (8)", 1.0, 1e5),
    Parameter("reshaping.damping", 0.8, "-", "damping ratio ξ_n of (8)", 0.1, 10.0),
    Parameter("reshaping.max_rate", 250.0, "V/s", "largest reference rate, (7)", 0.1, 1e5),
    Parameter("reshaping.max_accel", 12000.0, "V/s²", "largest reference acceleration, (6)", 1.0, 1e7),
    Parameter("arc.k1", 120.0, "1/s", "gain k1 of (18)", 1e-3, 1e5),
    Parameter("arc.k2", 120.0, "1/s", "gain k2 of (20)", 1e-3, 1e5),
    *_estimates("arc", [2.0, 110.0, 120.0, 500.0]),
    Parameter("arc.epsilon", 1e6, "V²/s³", "ε2 of (23) for the quadratic robust term", 1e-9, BIG),
    Parameter("arc.disturbance_bound", 1000.0, "V/s²", "bound δ_d of (5)", 0.0, 1e9),
    Parameter("arc.velocity_cutoff", 150.0, "Hz", "cut-off of the velocity estimate's low-pass", 1.0, 1e5),
    Parameter("oarc.k1", 308.0, "1/s", "observer gain k1 of (28)", 1e-3, 1e6),
    Parameter("oarc.k2", 48400.0, "1/s²", "observer gain k2 of (28)", 1e-3, BIG),
    Parameter("oarc.ks1", 120.0, "1/s", "gain ks1 of (39)", 1e-3, 1e5),
    Parameter("oarc.ks2", 120.0, "1/s", "gain ks2 of (48)", 1e-3, 1e5),
    Parameter(
        "oarc.z2_weight",
        1.44e6,
        "1/s²",
        "weight ρ of z2² in V2; 1.0 is the paper, θ3(0)² puts z2 on the scale of V/s",
        1e-3,
        BIG,
    ),
    *_estimates("oarc", [2.0, 110.0, 120.0, 4000.0]),
    Parameter("oarc.epsilon1", 1e3, "V²/s", "ε11 of (42) for the quadratic robust term", 1e-9, BIG),
    Parameter("oarc.epsilon2", 1e3, "V²/s", "ε21 of (50) for the quadratic robust term", 1e-9, BIG),
    Parameter("oarc.disturbance_bound", 5.0, "V/s", "bound on |ε_u,2| of (34)", 0.0, 1e9),
    Parameter(
        "pid.form",
        "paper",
        "",
        "paper: (56) as printed; reference: model terms from the reference, as (55) supposes; "
        "plain: static feedforward, filtered derivative, no reshaping",
        choices=("paper", "reference", "plain"),
    ),
    Parameter("pid.kp", 3.837, "V/V", "proportional gain", 0.0, 1e6),
    Parameter("pid.ki", 70.901, "1/s", "integral gain", 0.0, 1e9),
    Parameter("pid.kd", 0.093, "s", "derivative gain", 0.0, 1e3),
    Parameter(
        "pid.break_frequency",
        0.0,
        "Hz",
        "above 0, kp, ki and kd are computed from (55) with all poles here (7.0 is the paper)",
        0.0,
        1e4,
    ),
    Parameter(
        "pid.theta", [20.0, 1200.0, 1200.0], "", "model terms θ1(0), θ2(0), θ3(0) of (56)", 0.0, 1e9, length=3
    ),
    Parameter(
        "pid.static_feedforward", 1.18, "V/V", "feedforward of the command in the plain form", 0.0, 1e3
    ),
    Parameter("pid.derivative_cutoff", 374.0, "Hz", "cut-off of the derivative's low-pass", 1.0, 1e5),
    Parameter(
        "compensator.design",
        "printed_fourth_order",
        "",
        "printed_second_order: (12), printed_fourth_order: (13), or designed from compensator.model",
        choices=("printed_second_order", "printed_fourth_order", "designed"),
    ),
    Parameter(
        "compensator.model",
        "fourth_order",
        "",
        "valve model that a designed compensator cancels: (2), (3) or custom",
        choices=("second_order", "fourth_order", "custom"),
    ),
    Parameter(
        "compensator.bandwidth", 25.0, "Hz", "wanted -3 dB bandwidth of a designed compensator", 0.1, 1e4
    ),
    Parameter(
        "compensator.order",
        0,
        "",
        "poles of the Bessel filter that a designed compensator leaves; 0: one more than it must have",
        0,
        6,
    ),
    Parameter(
        "compensator.cancel_zeros",
        True,
        "",
        "whether a designed compensator cancels the stable zeros of the model too; (13) does not",
    ),
    *_custom_model("compensator."),
    Parameter(
        "open_loop.static_gain",
        46882988.0 / 56553725.0,
        "V/V",
        "static gain of the valve that the open loop divides by; that of (3)",
        1e-6,
        1e6,
    ),
)

VALVE: Table = (
    SAMPLE_PERIOD,
    U_MAX,
    Parameter(
        "valve",
        "fourth_order",
        "",
        "linear model of the valve: second_order (2), fourth_order (3) or custom",
        choices=("second_order", "fourth_order", "custom"),
    ),
    *_custom_model(""),
    Parameter("gain_scale", 1.0, "-", "multiplies the gain of the model", 0.01, 100.0),
    Parameter("seed", 1, "", "seed of the LVDT noise", 0, 2**31 - 1),
    Parameter(
        "patience",
        0.01,
        "s",
        "how long the next sample is held back for a voltage that is late; then the last one holds",
        0.0,
        1.0,
    ),
    Parameter("friction.coulomb", 0.0, "V", "Coulomb friction as input voltage", 0.0, 100.0),
    Parameter("friction.static_ratio", 1.0, "-", "static over Coulomb friction", 1.0, 10.0),
    Parameter(
        "friction.stribeck_velocity", 0.1, "V/s", "velocity at which the static part decays", 1e-6, 1e3
    ),
    Parameter(
        "friction.velocity_scale",
        0.02,
        "V/s",
        "half-width of friction's linear zone, without presliding",
        1e-6,
        1e3,
    ),
    Parameter(
        "friction.presliding",
        0.0,
        "V",
        "motion over which friction builds up like a spring (Dahl, LuGre); 0: none",
        0.0,
        10.0,
    ),
    Parameter("flow_force", 0.0, "V/V", "flow force as input voltage against the position", -10.0, 10.0),
    Parameter("disturbance.offset", 0.0, "V", "constant input disturbance d_n", -10.0, 10.0),
    Parameter("drift.gain", 0.0, "1/s", "relative growth of the gain per second", -0.01, 10.0),
    Parameter("drift.stiffness", 0.0, "V/V/s", "growth of the flow force per second", -10.0, 10.0),
    Parameter("listeners", 1, "", "lockstep: subscriptions to wait for before the first reading", 1, 100),
    Parameter("lvdt.noise", 0.0, "V", "standard deviation of the reading", 0.0, 10.0),
    Parameter("lvdt.resolution", 0.0, "V", "quantisation step; 0: none", 0.0, 10.0),
    Parameter("lvdt.bias", 0.0, "V", "constant error of the reading", -10.0, 10.0),
    Parameter("lvdt.delay", 0.0, "s", "dead time of the reading", 0.0, 1.0),
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
        "injected fault of the LVDT; a lost reading is sent as a frame that DDS cannot read",
        choices=(
            "none",
            "lost",
            "silent",
            "frozen",
            "out_of_range",
            "not_finite",
            "jump",
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
)

COMMAND: Table = (
    SAMPLE_PERIOD,
    Parameter(
        "scenario",
        "point_to_point",
        "",
        "command shape, or array for the numbers in command_file",
        choices=("point_to_point", "sine", "step", "sweep", "stepped_sine", "constant", "array"),
    ),
    Parameter("command_file", "", "", "CSV or NPY file with one command per sample period (array)"),
    Parameter(
        "trigger",
        "timer",
        "",
        "what paces the commands: a timer of the node's own, spool_position (one command per reading), or "
        "lockstep (the first at once, each further one per reading, none lost)",
        choices=("timer", "spool_position", "lockstep"),
    ),
    Parameter("listeners", 1, "", "subscriptions to wait for before the command begins", 0, 100),
    Parameter("delay", 0.5, "s", "pause between their arrival and the beginning", 0.0, 1e6),
    Parameter("duration", 6.0, "s", "length; afterwards the last command is held", 0.001, 1e6),
    Parameter("amplitude", 2.92, "V", "height, stroke or amplitude", -10.0, 10.0),
    Parameter("offset", 0.0, "V", "added to the command", -10.0, 10.0),
    Parameter("start", 0.25, "s", "standstill before the motion", 0.0, 1e6),
    Parameter(
        "frequency", 6.0, "Hz", "of the sine; start of the sweep; first of the stepped sine", 1e-4, 1e4
    ),
    Parameter("end_frequency", 60.0, "Hz", "end of the sweep; last of the stepped sine", 1e-4, 1e4),
    Parameter("sweep_time", 5.0, "s", "duration of the sweep", 1e-3, 1e6),
    Parameter("steps", 30, "", "frequencies of the stepped sine, evenly spaced in logarithm", 1, 1000),
    Parameter("cycles", 5, "", "least cycles of each frequency of the stepped sine", 1, 10000),
    Parameter("step_time", 1.0, "s", "least time of each frequency of the stepped sine", 0.0, 1e4),
    Parameter("max_velocity", 8.0, "V/s", "of the point-to-point motion", 1e-3, 1e4),
    Parameter("max_accel", 64.0, "V/s²", "of the point-to-point motion", 1e-3, 1e6),
    Parameter("cycle", 5.81, "s", "point to point: there and back again", 1e-2, 1e6),
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
        "what is hosted for each valve",
        choices=("controller", "valve_simulator"),
    ),
)

RECORDER: Table = (
    Parameter("bag", "", "", "folder to write, which must not exist; empty: valve_bag_<date>_<time> here"),
    Parameter("storage", "mcap", "", "storage of the bag", choices=("mcap", "sqlite3")),
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
        "regular expressions, one of which must match the whole name of a topic; empty: commands, readings, "
        "voltages, states and memories of all valves, /diagnostics and /clock; /parameter_events always",
    ),
    Parameter("max_size", 0.0, "MB", "size after which the bag's next file begins; 0.0: never", 0.0, 1e6),
    Parameter("max_duration", 0.0, "s", "time after which the bag's next file begins; 0.0: never", 0.0, 1e6),
    Parameter("flush_period", 0.25, "s", "at most this much is lost if the recorder is killed", 0.02, 1.0),
    Parameter("min_free", 64.0, "MB", "room on the disk at which the recording is ended", 0.0, 1e6),
    Parameter("report_period", 5.0, "s", "time between two lines about the progress", 0.1, 1e6),
)

NODES: dict[str, Table] = {
    "controller": CONTROLLER,
    "valve_simulator": VALVE,
    "command_source": COMMAND,
    "manifold": MANIFOLD,
    "recorder": RECORDER,
}


def defaults(table: Table) -> Values:
    """All parameters of ``table`` at their defaults."""
    return {p.name: p.default for p in table}


def lookup(table: Table, name: str) -> Parameter:
    """Parameter ``name``. Raises ParameterError with the nearest names if there is none."""
    for parameter in table:
        if parameter.name == name:
            return parameter
    near = difflib.get_close_matches(name, [p.name for p in table], n=2)
    hint = f"; did you mean {one_of(near)}?" if near else ""
    raise ParameterError(f"there is no parameter '{name}'{hint}")


def updated(table: Table, values: Mapping[str, Value], changes: Mapping[str, Any]) -> Values:
    """``values`` with ``changes`` checked one by one; nothing is changed in place."""
    result = dict(values)
    for name, value in changes.items():
        result[name] = lookup(table, name).check(value)
    return result
