# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""`ros2 param dump`, then `--params-file`: each node has the same parameters, whichever parser reads it."""

import pytest
import yaml
from bench import call
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.parameter import parameter_value_to_python

from research.campaigns.processes import node_arguments, process
from valve_control.axis.tables import ROS_NODES
from valve_control.control.parameters import files
from valve_control.control.parameters.ros_file import is_of_ros
from valve_control.nodes import NODES
from valve_control.nodes.adapter import plain

# Small, large and negative numbers, words that look like something else, lists.
CHANGED = {
    "controller": {
        "arc.epsilon": 1.5e-05, "arc.gamma": [0.0, 1e-05, 1e12, 2.0], "save_file": "gains 2.yaml",
        "controller": "oarc", "lvdt.hold_samples": 7, "realtime.cpus": "0",
    },
    "valve_simulator": {"friction.presliding": 0.0033, "lvdt.delay": 1e-05, "seed": 12},
    "command_source": {"scenario": "sine", "amplitude": 1.0, "frequency": 0.01},
    "axis_controller": {"machine": "bench"},
    "valve_driver": {"autostart": False},
    "dashboard": {"port": 0},
    "manifold": {"valves": ["boom", "arm"]},
}  # fmt: skip
CHOSEN = ("controller", "manifold", "recorder")  # each kind of value, of file and of process
HOSTED = {"manifold": ("/boom/controller", "/arm/controller")}


def parameters(ros, name):
    """Names and values of a running node, by its services."""
    listed = call(ros, ListParameters, f"{name}/list_parameters", ListParameters.Request())
    names = sorted(listed.result.names)
    got = call(ros, GetParameters, f"{name}/get_parameters", GetParameters.Request(names=names))
    return {n: plain(parameter_value_to_python(v)) for n, v in zip(names, got.values, strict=True)}


def dump(path, name, values):
    """Write the file as `ros2 param dump` does: nested at each dot, by PyYAML in its own notation."""
    tree = {}
    for parameter, value in values.items():
        *places, last = parameter.split(".")
        inner = tree
        for place in places:
            inner = inner.setdefault(place, {})
        inner[last] = value
    path.write_text(yaml.dump({name: {"ros__parameters": tree}}, default_flow_style=False))


def table_of(name):
    return {name.rpartition("/")[2]: ROS_NODES[name.rpartition("/")[2]]}


@pytest.mark.parametrize(
    "node",
    [n if n in CHOSEN else pytest.param(n, marks=pytest.mark.campaign) for n in NODES],
)
def test_a_dumped_file_starts_the_node_with_the_same_parameters(ros, tmp_path, node):
    """PyYAML and rcl's parser read the same from it, with the same types."""
    names = (f"/{node}", *HOSTED.get(node, ()))
    first = {**CHANGED.get(node, {}), **({"bag": str(tmp_path / "one")} if node == "recorder" else {})}
    with process(node, node_arguments(node, (), first), tmp_path / "one.log"):
        before = {name: parameters(ros, name) for name in names}
    assert all(before[f"/{node}"][name] == value for name, value in first.items())
    words = []
    for i, (name, values) in enumerate(before.items()):
        path = tmp_path / f"{i}.yaml"
        dump(path, name, values)
        words += ["--params-file", str(path)]
        own = {p: value for p, value in values.items() if not is_of_ros(p)}
        assert same(files.load(str(path), nodes=table_of(name))[name.rpartition("/")[2]], own)
    after_it = {"bag": str(tmp_path / "two")} if node == "recorder" else {}
    words += node_arguments(node, (), after_it)
    with process(node, words, tmp_path / "two.log"):
        after = {name: parameters(ros, name) for name in names}
    before[f"/{node}"].update(after_it)
    for name in names:
        assert same(after[name], before[name])


def same(found, wanted):
    """Whether two nodes have the same parameters, with the same types."""
    assert found == wanted
    return all(type(found[name]) is type(value) for name, value in wanted.items())
