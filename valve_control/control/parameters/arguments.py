# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks the ROS arguments with which a node's process was started, before anything runs with them.

ROS takes every name on a command line and in a parameter file, and uses those that a node declares. A
controller that runs with its default because a name is misspelt is a danger to a machine, and nobody is told.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from valve_control.control.parameters import files
from valve_control.control.parameters.axis_parameters import ROS_NODES
from valve_control.control.parameters.drivers import DEVICE
from valve_control.control.parameters.table import is_of_ros
from valve_control.parameter import ParameterError, Table, Values, defaults, missing

OPTIONS = ("-p", "--param", "--params-file")


class Setting(NamedTuple):
    """One parameter of a command line, ``-p node:name:=value``."""

    text: str  # as it was written
    node: str  # empty: all nodes of the process
    name: str


class Given(NamedTuple):
    """The parameters, files and other words of a command line."""

    stray: list[str]  # that no part of ROS takes
    in_order: list[Setting | str]  # parameters, and paths of parameter files

    @property
    def settings(self) -> list[Setting]:
        """Its parameters."""
        return [one for one in self.in_order if isinstance(one, Setting)]

    @property
    def paths(self) -> list[str]:
        """Paths of its parameter files."""
        return [one for one in self.in_order if isinstance(one, str)]


def given(arguments: Sequence[str]) -> Given:
    """Parse a command line, without the name of the program."""
    found = Given([], [])
    words = iter(arguments)
    inside = False
    for word in words:
        if word == "--ros-args":
            inside = True
        elif not inside:
            found.stray.append(word)
        elif word == "--":
            inside = False
        elif word == "--params-file":
            found.in_order.append(next(words, ""))
        elif word in OPTIONS:
            text = next(words, "")
            node, _, name = text.partition(":=")[0].rpartition(":")
            found.in_order.append(Setting(text, node, name))
    return found


def written(arguments: Sequence[str], node: str, name: str) -> str | None:
    """Text of the last value that a command line gives a parameter of ``node`` (full name), None: none."""
    texts = [
        setting.text.partition(":=")[2]
        for setting in given(arguments).settings
        if setting.name == name and (not setting.node or matches(setting.node, node))
    ]
    return texts[-1] if texts else None


def _own_name(arguments: Sequence[str], name: str) -> str:
    """Full name of the node ``name`` under a command line, of which the first rule counts."""
    parts = {"__ns": "", "__name": name}
    for text in reversed(arguments):
        rule, _, value = text.partition(":=")
        node, _, part = rule.rpartition(":")
        if node in ("", name):
            parts["__name" if part == "__node" else part] = value
    return f"{parts['__ns'].rstrip('/')}/{parts['__name']}"


def _in_force(arguments: Sequence[str], node: str) -> dict[str, tuple[str, Any]]:
    """What a command line and its files give ``node`` (full name): file and value by parameter.

    A value of -p is its text, with the file "". As in rcl a section joins the first one of its pattern, -p
    without a node is of /**, and the later of two patterns wins. Raises ParameterError.
    """
    merged: dict[str, dict[str, tuple[str, Any]]] = {}
    for one in given(arguments).in_order:
        if isinstance(one, Setting):
            pattern = f"/{one.node.lstrip('/')}" if one.node else "/**"
            merged.setdefault(pattern, {})[one.name] = "", one.text.partition(":=")[2]
            continue
        for section in files.sections(one):
            values = {name: (one, value) for name, value in section.values.items()}
            merged.setdefault(section.pattern, {}).update(values)
    found: dict[str, tuple[str, Any]] = {}
    for pattern, values in merged.items():
        found.update(values if matches(pattern, node) else {})
    return found


def looked_up(arguments: Sequence[str], name: str, parameter: str) -> object:
    """What a command line and its files give a ``parameter`` of the node ``name``, None: nothing."""
    return value_given(arguments, _own_name(arguments, name), parameter)


def value_given(arguments: Sequence[str], node: str, parameter: str) -> object:
    """What a command line and its files give a ``parameter`` of ``node`` (full name), None: nothing."""
    try:
        return _in_force(arguments, node).get(parameter, ("", None))[1]
    except ParameterError:
        return None  # told when the node starts


def values_of(arguments: Sequence[str], name: str, table: Table) -> Values:
    """Values of the node ``name`` under a command line, without ROS. Raises ParameterError."""
    node = _own_name(arguments, name)
    check(arguments, {node: table})
    values = defaults(table)
    found = _in_force(arguments, node)
    for parameter in table:
        path, value = found.get(parameter.name, ("", None))
        if parameter.name in found:
            try:
                values[parameter.name] = (files.from_yaml if path else files.from_text)(parameter, value)
            except ParameterError as error:
                raise ParameterError(f"{path}: {error}" if path else f"{error}") from error
    return values


def help_text(node: str, text: str, arguments: Sequence[str]) -> str:
    """Answer of ``node`` to ``arguments`` that ask for help, "": they do not; ``text``: what it does."""
    if not {"-h", "--help"} & set(given(arguments).stray):
        return ""
    lines = [
        f"ros2 run valve_control {node} [--ros-args] [-p NAME:=VALUE] [--params-file FILE] [-r __ns:=/NAME]",
        "",
        text.strip(),
        "",
        "parameters:",
        *(f"  {parameter.described}" for parameter in ROS_NODES[node]),
    ]
    if node == "controller":
        lines += [
            "",
            "with the parameter driver also:",
            *(f"  {parameter.described}" for parameter in DEVICE),
        ]
    return "\n".join(lines)


def refuse_stray(arguments: Sequence[str]) -> None:
    """Raise ParameterError if there is an argument that is not a ROS argument."""
    stray = given(arguments).stray
    if not stray:
        return
    text = " ".join(stray)
    if stray[0] in OPTIONS:
        raise ParameterError(f"'{text}' is without effect; write --ros-args {text}")
    if ":=" in text:
        raise ParameterError(f"'{text}' is without effect; a parameter is given as --ros-args -p name:=value")
    raise ParameterError(f"'{text}' is without effect; a node takes only the words behind --ros-args")


def refuse_unreadable(arguments: Sequence[str]) -> None:
    """Raise ParameterError for a parameter file that cannot be read, before rcl says so in its own words."""
    for path in given(arguments).paths:
        files.sections(path)


def check(arguments: Sequence[str], nodes: Mapping[str, Table]) -> list[str]:
    """Check a command line for the nodes of a process; ``nodes``: parameter tables by full name.

    Raises ParameterError for a parameter that is addressed to one of them and does not exist, and for a file
    that has something for a node of the same name elsewhere only. Returns warnings: of files for other nodes,
    and of unknown names in sections for several nodes, which may be meant for others.
    """
    words = given(arguments)
    for setting in words.settings:
        _check_setting(setting, nodes)
    return [warning for path in words.paths for warning in _check_file(path, nodes)]


def matches(pattern: str, node: str) -> bool:
    """Whether ROS applies a section to ``node`` (full name); ``*`` is one part of a name, ``**`` any."""
    rule = pattern if pattern.startswith("/") else f"/{pattern}"
    regular = re.escape(rule).replace(r"/\*", r"(/\w+)").replace(r"\*", "*")
    return re.fullmatch(regular, node) is not None


def addressed(path: str, node: str, table: Table) -> Values:
    """Checked values that a parameter file has for ``node`` (full name). Raises ParameterError.

    Where several sections have a parameter, the last one counts, as at a node's start.
    """
    sections = files.sections(path)
    known = {parameter.name: parameter for parameter in table}
    values: Values = {}
    for section in sections:
        if not matches(section.pattern, node):
            continue
        unknown = _unknown(table, section.values)
        if unknown and "*" not in section.node:
            raise ParameterError(f"section '{section.pattern}' of {path}: {missing(table, unknown)}")
        for name, value in section.values.items():
            if name in known:
                try:
                    values[name] = files.from_yaml(known[name], value)
                except ParameterError as error:
                    raise ParameterError(f"{path}: {error}") from error
    if not values:
        raise ParameterError(_nothing(path, sections, [node]))
    return values


def _unknown(table: Table, names: Iterable[str]) -> list[str]:
    known = {parameter.name for parameter in table}
    return [name for name in names if name not in known and not is_of_ros(name)]


def _check_setting(setting: Setting, nodes: Mapping[str, Table]) -> None:
    reached = [table for node, table in nodes.items() if not setting.node or matches(setting.node, node)]
    if not reached:
        raise ParameterError(f"-p {setting.text} is for no node of this process; it has {', '.join(nodes)}")
    together = tuple(parameter for table in reached for parameter in table)
    if unknown := _unknown(together, [setting.name]):
        raise ParameterError(f"-p {setting.text}: {missing(together, unknown)}")


def _check_file(path: str, nodes: Mapping[str, Table]) -> list[str]:
    sections = files.sections(path)
    warnings = []
    reached = False
    for section in sections:
        tables = [table for node, table in nodes.items() if matches(section.pattern, node)]
        reached = reached or bool(tables)
        several = "*" in section.node
        if several and tables:
            tables = [tuple(parameter for table in (*ROS_NODES.values(), DEVICE) for parameter in table)]
        for table in tables:
            if unknown := _unknown(table, section.values):
                text = f"section '{section.pattern}' of {path}: {missing(table, unknown)}"
                if not several:
                    raise ParameterError(text)
                warnings.append(text)
    if reached:
        return warnings
    text = _nothing(path, sections, nodes)
    if {section.node for section in sections} & {node.rsplit("/", 1)[-1] for node in nodes}:
        raise ParameterError(f"{text}; a namespace is given with -r __ns:=/name, any is meant by '/**/'")
    return [text]


def _nothing(path: str, sections: Sequence[files.Section], nodes: Iterable[str]) -> str:
    names = ", ".join(f"'{section.pattern}'" for section in sections) or "none"
    return f"parameter file {path} has nothing for {', '.join(nodes)}; its sections are {names}"
