# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Merges parameter files and --set into checked values of each node, for what runs without ROS."""

from collections.abc import Mapping, Sequence
from typing import Any

from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.ros_file import from_yaml, is_of_ros, parsed, sections
from valve_control.control.parameters.table import NODES
from valve_control.control.plant.registry import CHOICES
from valve_control.parameter import ParameterError, Table, Value, Values, lookup, missing

OF_MACHINE = {"sample_period", "u_max", "command_limit"}


def load(path: str, notes: list[str] | None = None, nodes: Mapping[str, Table] = NODES) -> dict[str, Values]:
    """Checked values of a ROS 2 parameter file, by node name. Raises ParameterError.

    A section is named after one of ``nodes`` (`controller`, with or without a namespace before it) or is a
    wildcard (`/**`), whose parameters go to each node that has them. ``notes`` gets a sentence about the
    sections of other nodes; a file that has nothing else is refused.
    """
    result: dict[str, Values] = {name: {} for name in nodes}
    found = sections(path)
    others: list[str] = []
    for section in found:
        targets = {
            node: table for node, table in nodes.items() if "*" in section.node or node == section.node
        }
        if not targets:
            others.append(f"'{section.pattern}'")
            continue
        for name, value in section.values.items():
            if is_of_ros(name):
                continue
            try:
                for node, checked in _by_node(targets, name, value).items():
                    result[node][name] = checked
            except ParameterError as error:
                raise ParameterError(f"{path}: {error}") from error
    if others and len(others) == len(found):
        raise ParameterError(
            f"{path} has parameters for {', '.join(others)} alone; the nodes are {', '.join(nodes)}"
        )
    if others and notes is not None:
        notes.append(
            f"{path}: the parameters of {', '.join(others)} are left out; the nodes are {', '.join(nodes)}"
        )
    return result


def given(
    paths: Sequence[str],
    direct: Mapping[str, Mapping[str, Any]],
    settings: Sequence[str],
    notes: list[str] | None = None,
    nodes: Mapping[str, Table] = NODES,
    law: str = "",
    recorded: bool = False,
) -> dict[str, dict[str, Any]]:
    """Values by node from parameter files, options of their own (``direct``) and --set; later ones win.

    ``nodes``: which there are, with their parameters; ``notes`` gets the notes about the files; ``law``: the
    law that is compared with others, which does not take their gains; ``recorded``: a recording has the other
    values. Raises ParameterError.
    """
    changes: dict[str, dict[str, Any]] = {node: {} for node in nodes}
    loaded = [load(path, notes, nodes) for path in paths]
    for file in loaded if law else ():
        file["controller"] = of_law(file["controller"], law)
    for values_by_node in (*loaded, direct):
        for node, values in values_by_node.items():
            changes[node].update({name: value for name, value in values.items() if value is not None})
    for text in settings:
        name, by_node = parse_setting(text, nodes)
        if lookup(_joined(nodes), name).node_only:
            raise ParameterError(f"--set {text} has no effect here, because running nodes alone read {name}")
        for node, value in by_node.items():
            changes[node][name] = value
    chosen = {name: value for values in changes.values() for name, value in values.items()}
    asked = {text.partition("=")[0].strip() for text in settings}
    for name in () if recorded else chosen:
        prefix, _, last = name.rpartition(".")
        choice = "valve" if prefix in ("", *CHOICES) else f"{prefix}.model"
        wanted = "custom" if last in ("numerator", "denominator") else prefix if prefix in CHOICES else ""
        if wanted and (name in asked or choice not in chosen):
            used = chosen.get(choice, lookup(_joined(nodes), choice).default)
            if used != wanted:
                raise ParameterError(f"{name} has no effect: {choice} is {used}; add {choice}={wanted}")
    return changes


def of_law(values: Values, law: str) -> Values:
    """Values of a file's controller for ``law``: a file of one other law alone has those of the machine."""
    owner = values.get("controller", law)
    prefixes = {name.partition(".")[0] for name in values} - {owner}
    if owner == law or prefixes & LAWS.keys():
        return values
    return {name: value for name, value in values.items() if name in OF_MACHINE}


def refuse_others(settings: Sequence[str], nodes: Mapping[str, Table], why: str) -> None:
    """Raise ParameterError if one of the ``settings`` (--set) is of none of ``nodes``; ``why`` it is not."""
    for text in settings:
        name = text.partition("=")[0].strip()
        if not any(p.name == name for p in _joined(nodes)):
            raise ParameterError(f"{why}, so it takes no --set {name}")


def parse_setting(text: str, nodes: Mapping[str, Table] = NODES) -> tuple[str, dict[str, Value]]:
    """``name=value`` of --set as (name, value by node); whole numbers may stand for doubles."""
    name, equals, word = text.partition("=")
    if not equals:
        raise ParameterError(f"--set takes name=value, not '{text}'")
    name = name.strip()
    default = lookup(_joined(nodes), name).default
    if isinstance(default, str):
        return name, _by_node(nodes, name, word.strip())
    try:
        value = parsed(word)
    except ValueError as error:
        raise ParameterError(f"'{word}' of --set {name} is not a value") from error
    if isinstance(default, float) and type(value) is int:
        value = float(value)
    if isinstance(default, list) and isinstance(value, list):
        value = [float(v) if type(v) is int else v for v in value]
    return name, _by_node(nodes, name, value)


def _joined(nodes: Mapping[str, Table]) -> Table:
    return tuple(parameter for table in nodes.values() for parameter in table)


def _by_node(nodes: Mapping[str, Table], name: str, value: Any) -> dict[str, Value]:
    """Checked ``value`` of a YAML file for each of ``nodes`` that has a parameter ``name``."""
    owners = {node: p for node, table in nodes.items() for p in table if p.name == name}
    if not owners:
        raise ParameterError(missing(_joined(nodes), [name]))
    return {node: from_yaml(parameter, value) for node, parameter in owners.items()}
