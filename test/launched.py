# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python launched.py FILE [NAME:=VALUE ...]``: launches a file without the command ros2."""

import importlib
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

VARIABLE = re.compile(r"\$\(var (\w+)\)")
EVAL = re.compile(r"\$\(eval '(.*)' '(\S+), (\S+)'\)")


def filled(text, values):
    """``text`` with the values of its variables, as launch puts them in: as they are."""
    return VARIABLE.sub(lambda variable: values[variable.group(1)], text)


def variables(path, **given):
    """Variables of a launch file by name for the arguments ``given``, evaluated as launch does."""
    root = ET.parse(path).getroot()
    values = {arg.get("name"): arg.get("default") for arg in root.findall("arg")} | given
    for let in root.findall("let"):
        expression, module, package = EVAL.fullmatch(let.get("value")).groups()
        importlib.import_module(module)
        names = {package: importlib.import_module(package)}
        values[let.get("name")] = str(eval(filled(expression.replace("\\'", "'"), values), names))
    return values


def nodes(group, values, space=""):
    """Full name and element of each node in a group, and in those inside it."""
    pushed = group.find("push_ros_namespace")
    name = "" if pushed is None else filled(pushed.get("namespace"), values)
    inside = f"{space}/{name}" if name else space
    for node in group.findall("node"):
        yield f"{inside}/{node.get('exec')}", node
    for inner in group.findall("group"):
        yield from nodes(inner, values, inside)


def command(path, *arguments):
    """Words of the command that launches the file ``path``."""
    return [sys.executable, str(Path(__file__)), str(path), *arguments]


def main():
    from launch.actions import IncludeLaunchDescription
    from launch.launch_description_sources import AnyLaunchDescriptionSource

    from launch import LaunchDescription, LaunchService

    path, *given = sys.argv[1:]
    include = IncludeLaunchDescription(
        AnyLaunchDescriptionSource(path), launch_arguments=[tuple(word.split(":=")) for word in given]
    )
    service = LaunchService()
    service.include_launch_description(LaunchDescription([include]))
    return service.run()


if __name__ == "__main__":
    sys.exit(main())
