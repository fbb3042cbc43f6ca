# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``python launched.py FILE [NAME:=VALUE ...]``: launches a file without the command ros2."""

import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

SHARE = Path(__file__).resolve().parents[1]
VARIABLE = re.compile(r"\$\(var (\w+)\)")
EQUALS = re.compile(r"\$\(equals (\S*) ([^\s)]*)\)")
EITHER = re.compile(r"\$\(or (true|false) (true|false)\)")


def filled(text, values):
    """``text`` with the values of its variables and the folder of the package."""
    text = VARIABLE.sub(lambda variable: str(values[variable.group(1)]), text)
    text = EQUALS.sub(lambda pair: str(pair.group(1) == pair.group(2)).lower(), text)
    text = EITHER.sub(lambda pair: str("true" in pair.groups()).lower(), text)
    return text.replace("$(find-pkg-share valve_control)", str(SHARE))


def variables(path, **given):
    """Variables of a launch file by name for the arguments ``given``."""
    root = ET.parse(path).getroot()
    values = {}
    for arg in root.findall("arg"):
        values[arg.get("name")] = given.get(arg.get("name"), filled(arg.get("default"), values))
    if "rate" in values:
        values["sample_period"] = 1.0 / float(values["rate"])
    return values


def nodes(group, values, space=""):
    """Full name and element of each node that starts in a group, and in those inside it."""
    pushed = group.find("push_ros_namespace")
    name = "" if pushed is None else filled(pushed.get("namespace"), values)
    inside = f"{space}/{name}" if name else space
    for element in group:
        if filled(element.get("if", "true"), values) != "true":
            continue
        if filled(element.get("unless", "false"), values) != "false":
            continue
        if element.tag == "node":
            yield f"{inside}/{element.get('exec')}", element
        elif element.tag == "group":
            yield from nodes(element, values, inside)


def parameters(path, node, **given):
    """What a launch file hands the ``node`` (full name) in its order: paths of files, and NAME:=VALUE."""
    values = variables(path, **given)
    for param in dict(nodes(ET.parse(path).getroot(), values))[node].findall("param"):
        if (file := param.get("from")) is not None:
            yield filled(file, values)
        else:
            yield f"{param.get('name')}:={filled(param.get('value'), values)}"


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
