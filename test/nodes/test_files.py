# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Every parameter file that the package writes is read by real nodes as it was meant."""

import json
import subprocess
import sys

import launched
import pytest
import rclpy
from rclpy.context import Context
from rclpy.parameter import Parameter, parameter_dict_from_yaml_file, parameter_value_to_python

from valve_control.cli import main
from valve_control.control.parameters import build, files, ros_file
from valve_control.control.parameters.table import CONTROLLER
from valve_control.nodes.adapter import plain, with_numbers
from valve_control.parameter import defaults, updated

QUICK = ["--set", "steps=12", "--set", "cycles=4", "--set", "frequency=1.0", "--set", "step_time=0.8"]
NODES = ("controller", "valve_simulator", "command_source")
# Each file in turn by rcl's own parser; the nodes wait for their transitions.
READ = """
import json, sys
import rclpy
from valve_control.nodes.adapter import plain
from valve_control.nodes.controller_node import Controller
from valve_control.nodes.valve_simulator import ValveSimulator
from valve_control.nodes.command_source import CommandSource
for path in sys.argv[1:]:
    rclpy.init(args=["--ros-args", "--params-file", path, "-p", "autostart:=false"])
    nodes = {n.get_name(): n for n in (Controller(), ValveSimulator(), CommandSource())}
    print(json.dumps({
        name: {p: plain(node.get_parameter(p).value) for p in node._parameters if p != "autostart"}
        for name, node in nodes.items()
    }))
    for node in nodes.values():
        node.destroy_node()
    rclpy.shutdown()
"""


def read_by_nodes(*paths):
    done = subprocess.run(
        [sys.executable, "-c", READ, *map(str, paths)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_files_of_all_commands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "array.csv").write_text("".join(f"{0.001 * i}\n" for i in range(300)))
    commands = {
        "identify": ["identify", *QUICK],
        "identify_slow": ["identify", *QUICK, "--sample-period", "0.002"],
        "study": ["study", "--replay", "3"],
        "study_array": [
            "study", "--replay", "3", "--command", "array.csv", "--sample-period", "1e-3",
            "--set", "arc.epsilon=1e-05",
        ],
    }  # fmt: skip
    paths = []
    for name, arguments in commands.items():
        paths.append(tmp_path / f"{name}.yaml")
        assert main([*arguments, "--output", paths[-1].name]) == 0, name
    several = ("manifold.yaml", "arm.yaml", "valve_driver.yaml")  # files of several valves, and of a real one
    paths += [p for p in sorted(ros_file.config_folder().glob("*.yaml")) if p.name not in several]
    for path, got in zip(paths, read_by_nodes(*paths), strict=True):
        meant = files.load(str(path))
        assert any(meant[node] for node in NODES), path
        for node in NODES:
            meant[node].pop("autostart", None)
            for name, value in meant[node].items():
                found = got[node][name]
                assert found == value and type(found) is type(value), (path.name, node, name, found, value)


HARD = [0.0, -0.0, 2.0, 1e-05, 1e-09, 1e16, 1.5e300, 0.1 + 0.2, 123456789.0]
WORDS = ["", "y", "No", "nan", ".inf", "2", "1e5", "0x1F", "2,3", "a: b", "# no", 'it\'s "so"', "ü\\n", "~"]


@pytest.mark.parametrize("node", ["/controller", "/digger/boom/controller", "/**/controller"])
def test_numbers_stay_numbers_and_words_stay_words(tmp_path, node):
    """As ~/save_parameters writes them, whatever their form."""
    paths = []
    for i, word in enumerate(WORDS):
        values = {**defaults(CONTROLLER), "save_file": word, "realtime.cpus": "0"}
        values["arc.epsilon"] = max(1e-9, HARD[i % len(HARD)] if HARD[i % len(HARD)] < 1e12 else 1e12)
        values["arc.gamma"] = values["oarc.gamma"] = [0.0, 1e-05, 1e12, 2.0]
        paths.append(tmp_path / f"{i}.yaml")
        ros_file.save(paths[-1], node, values)
        text = paths[-1].read_text()
        assert "&id" not in text and "*id" not in text
        assert files.load(str(paths[-1]))["controller"] == values
    if "digger" not in node:
        for got, word in zip(read_by_nodes(*paths), WORDS, strict=True):
            assert got["controller"]["save_file"] == word
            assert got["controller"]["realtime.cpus"] == "0"
            assert got["controller"]["arc.gamma"] == [0.0, 1e-05, 1e12, 2.0]


def by_param_load(path):
    """Parameters as `ros2 param load` sends them, by rclpy's own reader, and as a controller takes them."""
    for name, message in parameter_dict_from_yaml_file(str(path), target_nodes=["/controller"]).items():
        sent = parameter_value_to_python(message.value)
        if isinstance(sent, str):
            sent = with_numbers(CONTROLLER, [Parameter(name, value=sent)])[0].value
        yield name, plain(sent)


def loaded(path):
    """Values of a controller with its defaults after `ros2 param load`. Raises ParameterError."""
    values = defaults(CONTROLLER)
    for name, value in by_param_load(path):
        values = updated(CONTROLLER, values, {name: value})
        build.law_params(values)
    return values


CUSTOM = {
    "model": "custom",
    "numerator": [1206.0, 229256.0, 46882988.0],
    "denominator": [1.0, 163.0, 47859.0, 1969807.0, 56553725.0],
}


@pytest.mark.parametrize("law", ["dcarc", "compensator"])
def test_models_are_written_in_an_order_in_which_param_load_can_load_them(tmp_path, law):
    values = {f"{law}.{name}": value for name, value in CUSTOM.items()}
    path = tmp_path / "model.yaml"
    ros_file.save(path, "/controller", values)
    assert loaded(path) == {**defaults(CONTROLLER), **values}


def of_launch(file, node, **given):
    """Values that rcl makes for a node of this full name of all that a launch file hands it, in its order."""
    path = ros_file.config_folder().parent / "launch" / file
    space, _, name = node.rpartition("/")
    handed = launched.parameters(path, node, **given)
    words = [word for each in handed for word in ("-p" if ":=" in each else "--params-file", each)]
    context = Context()
    rclpy.init(args=[], context=context)
    ours = rclpy.create_node(
        name, namespace=space, context=context, cli_args=["--ros-args", *words], enable_rosout=False,
        start_parameter_services=False, automatically_declare_parameters_from_overrides=True,
    )  # fmt: skip
    values = {name: parameter.value for name, parameter in ours.get_parameters_by_prefix("").items()}
    ours.destroy_node()
    rclpy.shutdown(context=context)
    return values


@pytest.mark.parametrize(
    ("file", "node", "text", "given", "wanted"),
    [
        (
            "cascade.launch.xml", "/command_source", "duration: 7.0, scenario: sine", {},
            {"duration": 7.0, "scenario": "sine", "sample_period": 0.001},
        ),
        (
            "valve.launch.xml", "/controller", "sample_period: 0.002, controller: dcarc", {"rate": "4000"},
            {"sample_period": 0.002},
        ),
        (
            "valve.launch.xml", "/a/valve_simulator", "gain_scale: 0.9", {"namespace": "a", "rate": "500"},
            {"sample_period": 0.002},
        ),
        (
            "axis.launch.xml", "/axis_controller", "message: trajectory, upper_level: axis_arc", {},
            {"message": "trajectory", "upper_level": "axis_arc", "machine": "bench"},
        ),
        (
            "arm.launch.xml", "/boom/axis_controller", "message: trajectory", {"upper_level": "axis_arc"},
            {"message": "trajectory", "upper_level": "axis_arc", "joint": "boom"},
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize("pattern", ["/**{}", "/**"])
def test_a_node_of_a_launch_has_what_the_file_of_the_user_says(
    file, node, text, given, wanted, pattern, tmp_path
):
    """rcl merges all files into one list of sections, in the order in which each pattern came first."""
    mine = tmp_path / "mine.yaml"
    mine.write_text(f"{pattern.format(node)}: {{ros__parameters: {{{text}}}}}")
    got = of_launch(file, node, params_file=str(mine), **given)
    assert {name: got[name] for name in wanted} == wanted
