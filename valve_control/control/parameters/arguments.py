# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Checks the parameters' names in the ROS arguments with which a node's process was started.

ROS takes every name on a command line and in a parameter file, and uses those that a node declares. A
controller that runs with its default because a name is misspelt is a danger to a machine.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

from valve_control.control.parameters import ros_file
from valve_control.parameter import ParameterError, Table, Values, missing


def check(arguments: Sequence[str], nodes: Mapping[str, Table]) -> list[str]:
    """Check a command line for the nodes of a process; ``nodes``: parameter tables by full name.

    Raises ParameterError for a parameter that is addressed to one of them and does not exist. Returns
    warnings: of unknown names in sections for several nodes, which may be meant for others, of a file
    that has nothing for the node `valve_driver`, or something for a node of the same name elsewhere only,
    and of a section for `valve_driver` if a controller has the device itself.
    """
    warnings = []
    first = arguments.index("--ros-args") if "--ros-args" in arguments else len(arguments)
    for option, word in pairwise(arguments[first:]):
        if option in ("-p", "--param"):
            node, _, name = word.partition(":=")[0].rpartition(":")
            reached = [table for full, table in nodes.items() if not node or matches(node, full)]
            if not reached:
                raise ParameterError(f"-p {word} is for no node of this process; it has {', '.join(nodes)}")
            together = tuple(parameter for table in reached for parameter in table)
            if unknown := _unknown(together, [name]):
                raise ParameterError(f"-p {word}: {missing(together, unknown)}")
        elif option == "--params-file":
            warnings += _check_file(word, nodes)
    return warnings


def _check_file(path: str, nodes: Mapping[str, Table]) -> list[str]:
    sections = ros_file.sections(path)
    warnings = []
    for section in sections:
        for node, table in nodes.items():
            unknown = _unknown(table, section.values) if matches(section.pattern, node) else []
            text = f"section '{section.pattern}' of {path}: {missing(table, unknown)}" if unknown else ""
            if unknown and "*" not in section.node:
                raise ParameterError(text)
            warnings += [text] * bool(unknown)
            driver = f"{node.rpartition('/')[0]}/valve_driver"
            has_device = node != driver and any(parameter.name == "driver" for parameter in table)
            if has_device and section.node == "valve_driver" and matches(section.pattern, driver):
                warnings.append(
                    f"section '{section.pattern}' of {path} is not used, since {node} has the device itself; "
                    f"write its parameters into a section of {node}"
                )
    owed = {"valve_driver", *(section.node for section in sections)}
    reached = any(matches(section.pattern, node) for section in sections for node in nodes)
    if not reached and owed & {node.rpartition("/")[2] for node in nodes}:
        warnings.append(_nothing(path, sections, nodes))
    return warnings


def matches(pattern: str, node: str) -> bool:
    """Whether ROS applies a section to ``node`` (full name); ``*`` is one part of a name, ``**`` any."""
    rule = pattern if pattern.startswith("/") else f"/{pattern}"
    regular = re.escape(rule).replace(r"/\*", r"(/\w+)").replace(r"\*", "*")
    return re.fullmatch(regular, node) is not None


def addressed(path: str, node: str, table: Table) -> Values:
    """Checked values that a parameter file has for ``node`` (full name). Raises ParameterError.

    Where several sections have a parameter, the last one counts, as at a node's start.
    """
    sections = ros_file.sections(path)
    _check_file(path, {node: table})
    known = {parameter.name: parameter for parameter in table}
    values: Values = {}
    for section in sections:
        for name, value in section.values.items():
            if name in known and matches(section.pattern, node):
                try:
                    values[name] = ros_file.from_yaml(known[name], value)
                except ParameterError as error:
                    raise ParameterError(f"{path}: {error}") from error
    if not values:
        raise ParameterError(_nothing(path, sections, [node]))
    return values


def _unknown(table: Table, names: Iterable[str]) -> list[str]:
    known = {parameter.name for parameter in table}
    return [name for name in names if name not in known and not ros_file.is_of_ros(name)]


def _nothing(path: str, sections: Sequence[ros_file.Section], nodes: Iterable[str]) -> str:
    names = ", ".join(f"'{section.pattern}'" for section in sections) or "none"
    return f"parameter file {path} has nothing for {', '.join(nodes)}; its sections are {names}"
