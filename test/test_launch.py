# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Launch files: all that they name exists, and their choices are all that there is."""

import importlib.util
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from launched import VARIABLE, command, filled, nodes, parameters, variables

from valve_control.axis.axis_parameters import known_machine
from valve_control.axis.tables import ROS_NODES
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import ros_file
from valve_control.control.parameters.arguments import addressed
from valve_control.parameter import defaults, lookup

ROOT = Path(__file__).resolve().parents[1]
FILES = {path.name.split(".")[0]: path for path in (ROOT / "launch").glob("*.launch.xml")}
EVERY = {"namespace", "simulate", "record", "bag", "dashboard", "port", "params_file"}
VALVE = EVERY | {"controller", "valve", "rate", "driver", "autostart"}
ARGUMENTS = {  # that the docs name
    "valve": VALVE,
    "cascade": VALVE | {"scenario", "duration"},
    "axis": EVERY | {"machine", "upper_level", "message"},
    "arm": EVERY | {"upper_level", "message"},
}


def choices(file, name):
    return {c.get("value") for a in ET.parse(FILES[file]).iter("arg") if a.get("name") == name for c in a}


@pytest.mark.parametrize("file", ARGUMENTS)
def test_launch_file_names_only_what_exists(file):
    """Whatever is chosen: nodes, their parameters, files and variables."""
    root, path = ET.parse(FILES[file]).getroot(), FILES[file]
    declared = {arg.get("name"): arg for arg in root.findall("arg")}
    assert set(declared) == ARGUMENTS[file]
    assert all(arg.get("default") is not None and arg.get("description") for arg in declared.values())
    assert set(VARIABLE.findall(path.read_text())) <= {*declared, *(e.get("name") for e in root.iter("let"))}
    for name in declared:
        for value in choices(file, name) or {None}:
            given = {"record": "true", "dashboard": "true"} | ({name: value} if value else {})
            values = variables(path, **given)
            found = dict(nodes(root, values))
            assert ("/recorder" in found) == (given["record"] == "true" and file != "cascade")
            for full, node in found.items():
                assert node.get("pkg") == "valve_control"
                for param in node.findall("param"):
                    if param.get("from"):
                        assert Path(filled(param.get("from"), values)).is_file(), (full, value)
                    else:
                        lookup(ROS_NODES[node.get("exec")], param.get("name"))
    for include in root.iter("include"):
        assert {arg.get("name") for arg in include.findall("arg")} == ARGUMENTS["valve"]


def test_choices_are_all_that_there_is():
    kinds = {
        path.stem: {s.node for s in ros_file.sections(str(path))} for path in (ROOT / "config").glob("*.yaml")
    }
    for file in ("valve", "cascade"):
        gains = {name for name, sections in kinds.items() if sections == {"controller"}}
        assert choices(file, "controller") == gains and gains >= set(LAWS)
        assert choices(file, "valve") == {name for name in kinds if name.startswith("d3fxe")}
    scenarios = set(lookup(ROS_NODES["command_source"], "scenario").choices)
    assert choices("cascade", "scenario") == scenarios - {"array"}  # which needs a file of numbers
    machines = {path.stem for path in (ROOT / "config" / "axis").glob("*.yaml")}
    assert choices("axis", "machine") == machines - {"hopsan_position_servo"}  # at 100 kHz, for no node
    for file in ("axis", "arm"):
        for name in ("message", "upper_level"):
            assert choices(file, name) == set(lookup(ROS_NODES["axis_controller"], name).choices)


def test_the_example_of_two_valves_gives_each_a_namespace_and_arguments_that_exist():
    root = ET.parse(ROOT / "docs" / "examples" / "two_valves.launch.xml").getroot()
    given = [{a.get("name"): a.get("value") for a in i.findall("arg")} for i in root.iter("include")]
    assert len({one["namespace"] for one in given}) == len(given) == 2
    for one in given:
        assert set(one) <= VALVE and one["controller"] in choices("valve", "controller")


def test_who_has_the_device_takes_the_place_of_the_simulator():
    root = ET.parse(FILES["valve"]).getroot()
    for given, there in (
        ({}, {"/boom/valve_simulator", "/boom/controller"}),
        ({"simulate": "false"}, {"/boom/controller"}),
        ({"driver": "serial"}, {"/boom/controller"}),
        ({"driver": "valve_driver"}, {"/boom/valve_driver", "/boom/controller"}),
    ):
        values = variables(FILES["valve"], namespace="boom", **given)
        assert set(dict(nodes(root, values))) == there
        handed = parameters(FILES["valve"], "/boom/controller", namespace="boom", **given)
        assert [word for word in handed if word.startswith("driver:=")] == (
            ["driver:=serial"] if given.get("driver") == "serial" else []
        )


def values_of(name, file):
    """Values that a node of the full ``name`` has from the files of a launch, the later ones winning."""
    table = ROS_NODES[name.rsplit("/", 1)[1]]
    values = defaults(table)
    for path in parameters(FILES[file], name):
        values.update(addressed(path, name, table) if ":=" not in path else {})
    return values


def test_both_axes_of_the_arm_take_their_machines_and_the_manifold_has_their_valves():
    for valve in values_of("/manifold", "arm")["valves"]:
        simulated, upper = (values_of(f"/{valve}/{n}", "arm") for n in ("axis_simulator", "axis_controller"))
        assert simulated["joint"] == upper["joint"] == valve
        assert upper["machine"] == f"crane_{valve}"
        assert known_machine(upper["machine"])["cylinder.area_a"] == simulated["cylinder.area_a"]
        # The law of its valve comes from the manifold's file, to the node that a stop deactivates.
        assert upper["stop.controller"] == "controller"
        law = addressed(str(ROOT / "config" / "arm.yaml"), f"/{valve}/controller", ROS_NODES["controller"])
        assert law["controller"] == "pid"


@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="needs ros2 launch")
@pytest.mark.parametrize(
    ("file", "argument"),
    [
        *((file, argument) for file in ARGUMENTS for argument in ("record:=yes", "simulate:=maybe")),
        ("valve", "controller:=OARC"),
        ("cascade", "valve:=none"),
        ("cascade", "rate:=0.0"),
        ("valve", "rate:=abc"),
    ],
)
def test_wrong_argument_ends_the_launch_before_anything_starts(file, argument):
    done = subprocess.run(command(FILES[file], argument), capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and "process started" not in done.stdout + done.stderr
