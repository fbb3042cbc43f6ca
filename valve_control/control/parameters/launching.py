# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks the arguments of launch files and turns them into ROS arguments; called by the files in launch/.

Launch puts an argument into an expression as it is. These files write r'''ARGUMENT '''[:-1], so that an
argument may have quotation marks and end with a backslash.
"""

import atexit
import difflib
import math
import re
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path

from valve_control import inputs
from valve_control.control.laws.registry import LAWS, REFUSED
from valve_control.control.parameters import files
from valve_control.control.parameters.arguments import matches
from valve_control.control.parameters.axis_parameters import ROS_NODES
from valve_control.control.parameters.drivers import DEVICE, SIMULATED
from valve_control.control.parameters.table import NODES
from valve_control.parameter import ParameterError, Value, lookup, one_of

SWITCHES = ("simulate", "record", "dashboard")
# Arguments that set a parameter of the same name, which a file of the user's may set too.
NAMED = ("controller", "driver", "scenario", "duration", "message", "upper_level", "sample_period")
# Nodes of launch files; the controller may have its device itself.
LAUNCHED = {
    **{name: table for name, table in ROS_NODES.items() if name != "valve_driver"},
    "controller": (*ROS_NODES["controller"], *DEVICE),
}
NAMESPACE = re.compile(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?", re.ASCII)


def checked(file: str, **values: str) -> str:
    """Check the arguments of the launch file ``file`` before it starts anything; returns its name.

    ``values``: arguments by name. Launch evaluates a condition when it comes to the node that has it, and
    what it started before that would run on without it. Raises ParameterError.
    """
    declared = _declared(file)
    given = _command_line(file)
    _refuse_unknown(file, given or [], declared)
    for name in SWITCHES:
        if values[name].strip().lower() not in ("true", "1", "false", "0"):
            raise ParameterError(f"{name} is '{values[name]}'; it must be true or false")
    port = values["port"]
    _number("port", port)
    if not port.removeprefix("-").isdecimal():
        raise ParameterError(f"port is '{port}'; it must be a whole number in digits, such as 8080")
    lookup(ROS_NODES["dashboard"], "port").check(int(port))
    if NAMESPACE.fullmatch(values["namespace"]) is None:
        raise ParameterError(
            f"namespace is '{values['namespace']}'; it must be of letters, digits and _, such as crane/boom"
        )
    if values["record"].strip().lower() in ("true", "1") and inputs.expanded(values["bag"], "bag").exists():
        raise ParameterError(f"bag is '{values['bag']}', which exists already; name a new one with bag:=NAME")
    if driver := values.get("driver", ""):
        lookup(DEVICE, "driver").check(driver)
    wanted = "simulate" in (given or []) and values["simulate"].strip().lower() in ("true", "1")
    if wanted and (device := _device(driver, values["params_file"])):
        raise ParameterError(
            f"simulate is '{values['simulate']}' and the driver is '{device}', beside which no "
            "valve_simulator runs; leave one of them out"
        )
    if given is not None:  # of a file that is included another part may be for nodes of the one around it
        _refuse_useless(file, values["params_file"])
    _refuse_contradictions(file, values, declared)
    return file


def _declared(file: str) -> dict[str, str]:
    """Default of each argument of a launch file of this package."""
    return {argument.get("name", ""): argument.get("default", "") for argument in _root(file).findall("arg")}


def _root(file: str) -> ET.Element:
    return ET.parse(_path(file)).getroot()


def _path(file: str) -> Path:
    return files.config_folder().parent / "launch" / file


def _takers(file: str) -> set[str]:
    """Nodes that a launch file gives the user's file of parameters to."""
    root = _root(file)
    nodes = {node.get("exec", "") for node in root.iter("node")} - {"recorder", "dashboard"}
    for include in root.iter("include"):
        nodes |= _takers(include.get("file", "").rsplit("/", 1)[-1])
    beside = {"manifold": "controller", "axis_simulator": "valve_simulator"}  # in the same process
    return nodes | {other for node, other in beside.items() if node in nodes}


def _refuse_useless(file: str, path: str) -> None:
    """Raise ParameterError for a file of parameters that has nothing for the nodes that ``file`` launches."""
    takers = _takers(file)
    if path and not any(_load(path)[node] for node in takers):
        raise ParameterError(f"{path} has nothing for the nodes of {file}, {', '.join(sorted(takers))}")


def _command_line(file: str) -> list[str] | None:
    """Names of the arguments of the command line that launches ``file``, None if another file includes it."""
    own = _path(file).resolve()
    for at, (package, word) in enumerate(pairwise(sys.argv), 2):
        if (package, word) == ("valve_control", file) or (
            Path(word).name == file and Path(word).resolve() == own
        ):
            return [word.partition(":=")[0] for word in sys.argv[at:] if ":=" in word]
    return None


def _refuse_unknown(file: str, given: Iterable[str], declared: Mapping[str, str]) -> None:
    """Raise ParameterError for an argument that ``file`` does not have; a launch keeps it without a word."""
    for name in given:
        if name not in declared:
            near = difflib.get_close_matches(name, declared, n=2)
            hint = f"did you mean {one_of(near)}?" if near else f"it has {', '.join(declared)}"
            raise ParameterError(f"{file} has no argument '{name}'; {hint}")


def _refuse_contradictions(file: str, values: Mapping[str, str], declared: Mapping[str, str]) -> None:
    """Raise ParameterError if the user's file sets what an argument, other than its default, sets otherwise.

    Of nodes that ``file`` does not launch the sample period alone counts: it is that of all nodes.
    """
    path, takers = values["params_file"], _takers(file)
    for section, name, value in _named(path):
        argument = "rate" if name == "sample_period" else name
        node = section.rsplit("/", 1)[-1]
        if argument not in values or not (node in takers or "*" in node or argument == "rate"):
            continue
        text = values[argument]
        if text != declared[argument] and not _says(argument, text, value):
            raise ParameterError(
                f"{argument} is '{text}', and {path} sets {name} to {value}; leave one of them out"
            )


def _says(argument: str, text: str, value: Value) -> bool:
    """Whether an argument makes a parameter ``value``; periods are written with few digits."""
    if isinstance(value, float):
        number = sample_period(text) if argument == "rate" else _number(argument, text)
        return math.isclose(number, value, rel_tol=1e-5)
    return text == value


def _named(path: str) -> Iterator[tuple[str, str, Value]]:
    """Pattern, name and value of what a file sets that arguments set too. Raises ParameterError."""
    _load(path)
    for section in files.sections(path) if path else []:
        for node, table in LAUNCHED.items():
            for parameter in table if section.node == node or "*" in section.node else ():
                if parameter.name in NAMED and parameter.name in section.values:
                    value = files.from_yaml(parameter, section.values[parameter.name])
                    yield section.pattern, parameter.name, value


def _load(path: str) -> dict[str, dict[str, Value]]:
    """Checked values of the file of parameters by node; none without a file. Raises ParameterError."""
    return files.load(path, nodes={**ROS_NODES, **LAUNCHED}) if path else {}


def parameters_of(params_file: str, otherwise: str, *nodes: str, beside: str = "") -> str:
    """Path of ``params_file`` if it has anything for ``nodes``, else of ``otherwise``, a file in config/.

    Sections of the namespace ``beside`` do not count: a node that finds nothing but these does not start.
    A node that gets a file of its own twice takes no harm; launch files have no parameter that is left out.
    Raises ParameterError.
    """
    return _given(params_file, nodes, beside) or str(files.config_folder() / otherwise)


def file_option(params_file: str) -> str:
    """ROS option that makes the controller take ``params_file``, or one without effect.

    Raises ParameterError.
    """
    return "--params-file" if _given(params_file, ["controller"]) else "-r"


def file_value(params_file: str) -> str:
    """Return the word that belongs to ``file_option``. Raises ParameterError."""
    return _given(params_file, ["controller"]) or "__node:=controller"


def _given(params_file: str, nodes: Iterable[str], beside: str = "") -> str:
    """Path of ``params_file``, "" if it has nothing for ``nodes``, or only in the namespace ``beside``."""
    values = _load(params_file)
    sections = files.sections(params_file) if params_file else []
    for node in nodes:
        own = [section.pattern for section in sections if section.node == node or "*" in section.node]
        if values.get(node) and not all(pattern.endswith(f"/{beside}/{node}") for pattern in own):
            return str(inputs.expanded(params_file, "parameter file").absolute())
    return ""


def _device(driver: str, params_file: str) -> str:
    """Kind of the device that the controller has itself, by argument or file, "": none."""
    return driver or str(_load(params_file).get("controller", {}).get("driver", ""))


def simulator(simulate: str, driver: str, params_file: str) -> str:
    """Whether valve_simulator runs: it does, unless there is a device. Raises ParameterError."""
    return "false" if _device(driver, params_file) else simulate


def device_option(driver: str, params_file: str) -> str:
    """ROS option that makes the controller have its device, or one without effect. Raises ParameterError."""
    return "--params-file" if _device(driver, params_file) else "-r"


def device_value(driver: str, params_file: str, valve: str) -> str:
    """Return the word that belongs to ``device_option``: a new file, in which a simulated valve is ``valve``.

    ``valve``: name of a file in config/; what the user's file has for valve_simulator comes before it. Raises
    ParameterError.
    """
    device = _device(driver, params_file)
    if not device:
        return "__node:=controller"
    values: dict[str, Value] = {"driver": device}
    if device == "simulated":
        known = {parameter.name for parameter in SIMULATED}
        for path in (str(files.config_folder() / f"{valve}.yaml"), params_file):
            given = _load(path).get("valve_simulator", {})
            values |= {f"simulated.{n}": value for n, value in given.items() if f"simulated.{n}" in known}
    text = files.as_yaml({"/**/controller": values})
    with tempfile.NamedTemporaryFile("w", prefix="valve_control_", suffix=".yaml", delete=False) as file:
        file.write(text)
    atexit.register(Path(file.name).unlink, missing_ok=True)  # launch outlives the nodes that read it
    return file.name


def sample_period(rate: str, params_file: str = "") -> float:
    """Sample period [s] of a ``rate`` [Hz], or the one of the file of parameters. Raises ParameterError."""
    periods = {values["sample_period"] for values in _load(params_file).values() if "sample_period" in values}
    if len(periods) > 1:
        listed = one_of(map(str, sorted(periods)))
        raise ParameterError(f"{params_file} sets several sample periods, {listed} s")
    for period in periods:
        assert isinstance(period, float)
        return period
    parameter = lookup(NODES["controller"], "sample_period")
    low, high = 1.0 / parameter.high, 1.0 / parameter.low
    hertz = _number("rate", rate)
    if not low <= hertz <= high:
        raise ParameterError(f"rate is {rate} Hz; it must lie between {low:g} and {high:g} Hz")
    return 1.0 / hertz


def value_of(name: str, text: str, node: str, params_file: str = "") -> Value:
    """Value of a parameter of ``node`` (full name): the one in the file of parameters, else that of ``text``.

    rcl merges a section of that file into the first one of the same pattern. If this is of a file in config/,
    it lies before the arguments, and they would win. Raises ParameterError.
    """
    parameter = lookup(ROS_NODES[node.rsplit("/", 1)[-1]], name)
    full = f"/{node.lstrip('/')}"
    found = [
        value for pattern, other, value in _named(params_file) if other == name and matches(pattern, full)
    ]
    return parameter.check(
        found[-1] if found else _number(name, text) if isinstance(parameter.default, float) else text
    )


def law_option(controller: str) -> str:
    """ROS option that makes ``controller`` the law: for a file of gains, or for the name of a law.

    Raises ParameterError.
    """
    return "-p" if _gains(controller) is None else "--params-file"


def law_value(controller: str) -> str:
    """What belongs to ``law_option``: a path, or ``controller:=NAME``. Raises ParameterError."""
    gains = _gains(controller)
    return f"controller:={controller}" if gains is None else str(gains)


def _gains(controller: str) -> Path | None:
    """File in config/ with the gains of ``controller``; None for a law that runs with its defaults."""
    names = {path.stem: path for path in sorted(files.config_folder().glob("*.yaml")) if _of_law(path)}
    if controller not in names and controller not in LAWS:
        known = one_of(dict.fromkeys([*LAWS, *names]))
        raise ParameterError("; ".join([f"controller is '{controller}'; it must be {known}", *REFUSED]))
    return names.get(controller)


def _of_law(path: Path) -> bool:
    """Whether a parameter file is for controllers alone."""
    return {section.node for section in files.sections(str(path))} == {"controller"}


def _number(name: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ParameterError(f"{name} is '{text}'; it must be a number")
    return number
