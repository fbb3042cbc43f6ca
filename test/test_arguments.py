# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The command line of a node, judged before anything runs with it."""

import pytest

from valve_control.control.parameters import files, ros_file
from valve_control.control.parameters.arguments import addressed, check, matches
from valve_control.control.parameters.drivers import DEVICE, VALVE_DRIVER
from valve_control.control.parameters.table import COMMAND, CONTROLLER, MANIFOLD, VALVE
from valve_control.parameter import ParameterError, lookup

ONE = {"/controller": CONTROLLER}
BOOM = {"/boom/controller": CONTROLLER}
TWO = {"/manifold": MANIFOLD, "/boom/controller": CONTROLLER, "/arm/controller": CONTROLLER}


@pytest.mark.parametrize(
    ("pattern", "node", "whether"),
    [
        ("/controller", "/controller", True),
        ("controller", "/controller", True),
        ("/controller", "/boom/controller", False),
        ("/**/controller", "/controller", True),
        ("/**/controller", "/digger/boom/controller", True),
        ("/*/controller", "/controller", False),
        ("/*/controller", "/boom/controller", True),
        ("/**", "/boom/controller", True),
        ("/**/valve_simulator", "/controller", False),
        ("/b.om/controller", "/boom/controller", False),
        ("/(/controller", "/boom/controller", False),  # was a traceback
    ],
)
def test_sections_reach_the_nodes_that_ros_gives_them_to(pattern, node, whether):
    assert matches(pattern, node) is whether


@pytest.mark.parametrize(
    ("nodes", "setting", "words"),
    [
        (ONE, "controler:=oarc", ["'controler'", "did you mean 'controller'?"]),
        (ONE, "controller:controler:=oarc", ["'controler'", "did you mean 'controller'?"]),
        (ONE, "/**:controler:=oarc", ["'controler'"]),
        (ONE, "amplitude:=1.0", ["'amplitude'"]),
        (ONE, "boom:u_max:=5.0", ["no node of this process", "/controller"]),
        (BOOM, "controller:u_max:=5.0", ["no node of this process", "/boom/controller"]),
        (TWO, "valve:=[boom]", ["'valve'", "'valves'"]),
        (TWO, "/boom/controller:valves:=[a]", ["'valves'"]),
    ],
)
def test_unknown_parameters_of_the_command_line_are_refused(nodes, setting, words):
    with pytest.raises(ParameterError) as error:
        check(["--ros-args", "-p", setting], nodes)
    assert all(word in str(error.value) for word in words), error.value


@pytest.mark.parametrize(
    ("nodes", "setting"),
    [
        (ONE, "arc.k1:=100.0"),
        (ONE, "controller:arc.k1:=100.0"),
        (ONE, "use_sim_time:=true"),
        (ONE, "start_type_description_service:=false"),
        (ONE, "qos_overrides./spool_position.subscription.depth:=5"),
        (TWO, "valves:=[boom, arm]"),
        (TWO, "controller:=pid"),
        (TWO, "/arm/controller:controller:=pid"),
    ],
)
def test_parameters_of_the_process_are_taken(nodes, setting):
    assert check(["--ros-args", "-p", setting], nodes) == []


def judged(tmp_path, nodes, text):
    path = tmp_path / "p.yaml"
    path.write_text(text)
    return check(["--ros-args", "--params-file", str(path)], nodes)


@pytest.mark.parametrize("section", ["/controller", "controller", "/**/controller"])
def test_unknown_parameter_in_a_section_for_the_node_is_refused(tmp_path, section):
    with pytest.raises(ParameterError, match=r"p\.yaml.*'arc\.k11'; did you mean"):
        judged(tmp_path, ONE, f"{section}:\n  ros__parameters:\n    arc: {{k11: 1.0}}\n")


def test_unknown_names_for_several_nodes_and_a_file_for_another_valve_are_warnings(tmp_path):
    text = "/**:\n  ros__parameters: {use_sim_time: true, controler: pid, robot: x, u_max: 5.0}\n"
    (warning,) = judged(tmp_path, ONE, text)
    assert "'controler' (did you mean 'controller'" in warning and "'robot'" in warning
    assert "use_sim_time" not in warning
    text = "/boom/controller:\n  ros__parameters: {u_max: 5.0}\n"
    (warning,) = judged(tmp_path, ONE, text)
    assert "nothing for /controller" in warning and judged(tmp_path, BOOM, text) == []
    assert judged(tmp_path, ONE, "/**/valve_simulator:\n  ros__parameters: {gain_scale: 1.0}\n") == []


def test_a_section_for_the_driver_node_is_reported_where_the_controller_has_the_device(tmp_path):
    text = "/**/valve_driver: {ros__parameters: {driver: serial}}\n/boom/controller: {ros__parameters: {}}\n"
    (warning,) = judged(tmp_path, {"/boom/controller": (*CONTROLLER, *DEVICE)}, text)
    assert "'/**/valve_driver'" in warning and "is not used, since /boom/controller has the device" in warning
    assert judged(tmp_path, BOOM, text) == judged(tmp_path, {"/boom/valve_driver": VALVE_DRIVER}, text) == []
    elsewhere = text.replace("/**/", "/arm/")
    assert judged(tmp_path, {"/boom/controller": (*CONTROLLER, *DEVICE)}, elsewhere) == []


def test_a_file_without_a_section_for_the_driver_node_is_reported_to_it(tmp_path):
    text = "/**/controller:\n  ros__parameters: {u_max: 1.0}\n"
    (warning,) = judged(tmp_path, {"/valve_driver": VALVE_DRIVER}, text)
    assert "has nothing for /valve_driver; its sections are '/**/controller'" in warning


def test_the_example_of_a_controller_with_its_device_has_what_the_example_of_the_driver_has(config):
    path = config.parent / "docs" / "examples" / "serial_controller.yaml"
    values = addressed(str(path), "/controller", (*CONTROLLER, *DEVICE))
    driver = addressed(str(config / "valve_driver.yaml"), "/valve_driver", VALVE_DRIVER)
    assert {name: value for name, value in driver.items() if name != "watchdog"} == {
        name: value for name, value in values.items() if name in driver
    }


def test_shared_files_are_taken_without_a_word(tmp_path, config):
    nodes = {**TWO, **ONE, "/valve_simulator": VALVE, "/command_source": COMMAND}
    nodes["/valve_driver"] = VALVE_DRIVER
    for path in config.glob("*.yaml"):
        assert judged(tmp_path, nodes, path.read_text(encoding="utf-8")) == []
    shared = "/boom/controller: {ros__parameters: {u_max: 5.0}}\n/other: {ros__parameters: {speed: 1}}\n"
    assert judged(tmp_path, BOOM, shared) == []


def test_values_for_a_node_are_those_of_its_sections_the_last_one_counting(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(
        "/**: {ros__parameters: {u_max: 4.0, amplitude: 1.0, use_sim_time: true}}\n"
        "/**/controller: {ros__parameters: {u_max: 5.0, arc: {epsilon: 1.44e6}}}\n"
        "/arm/controller: {ros__parameters: {u_max: 6.0}}\n"
    )
    assert addressed(str(path), "/boom/controller", CONTROLLER) == {"u_max": 5.0, "arc.epsilon": 1.44e6}
    assert addressed(str(path), "/arm/controller", CONTROLLER)["u_max"] == 6.0
    with pytest.raises(ParameterError, match="nothing for"):
        addressed(str(path), "/valve_simulator/x", MANIFOLD)


@pytest.mark.parametrize(
    "word", ["2020-13-45", "!!int x", "!!timestamp x", "[" * 3000, "1:30", "1_000", "0b11"]
)
def test_words_of_which_yaml_makes_no_value_or_another_one_than_ros_are_refused(word, tmp_path):
    """Of the first the parser raises ValueError, KeyError or RecursionError; 1:30 is 90 for YAML 1.1."""
    for read in (
        lambda: ros_file.from_text(lookup(CONTROLLER, "arc.k1"), word),
        lambda: files.parse_setting(f"arc.k1={word}"),
    ):
        with pytest.raises(ParameterError, match="arc.k1"):
            read()
    path = tmp_path / "p.yaml"
    path.write_text(f"controller:\n  ros__parameters: {{arc.k1: {word}}}\n")
    with pytest.raises(ParameterError, match=r"is not YAML|arc.k1"):
        files.load(str(path))
    # As the name of a file such a word is one, and is written in quotes.
    path.write_text(ros_file.as_yaml({"controller": {"save_file": word}}))
    assert files.load(str(path))["controller"] == {"save_file": word}


@pytest.mark.parametrize(
    ("word", "number"),
    [("1e-2", 0.01), ("1.5e3", 1500.0), ("0x1f", 31.0), ("010", 8.0), (".5", 0.5), ("+5", 5.0)],
)
def test_numbers_are_those_of_ros(word, number):
    assert files.parse_setting(f"arc.k1={word}")[1] == {"controller": number}
