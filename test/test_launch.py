# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Launch files: well formed, all that they name exists, and a wrong argument ends the launch."""

import importlib.util
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path

import pytest
from launched import VARIABLE, nodes, variables
from launched import command as launch

from research.campaigns import arm as campaign
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import files, launching
from valve_control.control.parameters.arguments import addressed
from valve_control.control.parameters.axis_parameters import ROS_NODES, known_machine
from valve_control.control.parameters.drivers import DEVICE, SIMULATED
from valve_control.control.parameters.table import NODES, VALVE
from valve_control.parameter import ParameterError, defaults, lookup

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / "launch").glob("*.launch.xml"))
AXIS, ARM = "axis.launch.xml", "arm.launch.xml"  # of machines, not of a valve
VALVES = [path for path in FILES if path.name not in (AXIS, ARM)]
OF_THE_USER = re.compile(r"\$\(var \w+_file\)")  # a file of the user's, or one of the node's own once more


CALL = re.compile(r"valve_control\.control\.parameters\.launching\.(\w+)\(")


def arguments(root):
    return {arg.get("name"): arg.get("default") for arg in root.findall("arg")}


def choices(root, name):
    return {c.get("value") for arg in root.findall("arg") if arg.get("name") == name for c in arg}


def files_for(*nodes):
    """Names of the files in config/ that have sections for exactly these nodes."""
    for path in (ROOT / "config").glob("*.yaml"):
        if {section.node for section in files.sections(str(path))} == set(nodes):
            yield path.stem


def test_there_are_launch_files():
    assert {path.name for path in FILES} == {"valve.launch.xml", "cascade.launch.xml", AXIS, ARM}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_launch_file_names_only_what_exists(path):
    root = ET.parse(path).getroot()
    assert root.tag == "launch"
    declared = arguments(root)
    own = {"controller", "valve", "rate"} if path in VALVES else {"message", "upper_level"}
    own |= {"machine"} if path.name == AXIS else set()
    assert own | {"namespace", "record", "dashboard", "port", "params_file"} <= set(declared)
    for arg in root.findall("arg"):
        assert arg.get("default") is not None and arg.get("description"), arg.get("name")
    text = path.read_text(encoding="utf-8")
    derived = {let.get("name") for let in root.findall("let")}
    assert {*VARIABLE.findall(text), "checked"} == set(declared) | derived
    assert CALL.findall(text) and all(hasattr(launching, name) for name in CALL.findall(text))
    executables = re.search(r"NODES = \[(.*?)\]", (ROOT / "setup.py").read_text(), re.DOTALL).group(1)
    for node in root.iter("node"):
        assert node.get("pkg") == "valve_control" and f'"{node.get("exec")}"' in executables
        for param in node.findall("param"):
            if param.get("from") is None:
                lookup(ROS_NODES[node.get("exec")], param.get("name"))
                continue
            if OF_THE_USER.fullmatch(param.get("from")):
                continue
            folder, name = param.get("from").split("valve_control)/")[1].rsplit("/", 1)
            names = [name]
            for variable in VARIABLE.findall(name):
                assert declared[variable] in choices(root, variable)
                names = [name.replace(f"$(var {variable})", value) for value in choices(root, variable)]
            for name in names:
                assert (ROOT / folder / name).is_file(), name
    recorders = [node for node in root.iter("node") if node.get("exec") == "recorder"]
    for recorder in recorders:
        assert recorder.get("if") == "$(var record)" and recorder.find("param").get("value") == "$(var bag)"
    assert len(recorders) == (path.name != "cascade.launch.xml")
    pages = [node for node in root.iter("node") if node.get("exec") == "dashboard"]
    for page in pages:
        assert page.get("if") == "$(var dashboard)" and page.find("param").get("value") == "$(var port)"
    assert len(pages) == len(recorders) and declared["dashboard"] == "false"
    for include in root.iter("include"):
        target = ROOT / include.get("file").split("valve_control)/")[1]
        known = arguments(ET.parse(target).getroot())
        assert {arg.get("name") for arg in include.findall("arg")} == set(known)


@pytest.mark.parametrize("path", VALVES, ids=lambda path: path.name)
def test_choices_are_all_that_there_is(path):
    root = ET.parse(path).getroot()
    valves = {*files_for("valve_simulator"), *files_for("controller", "valve_simulator", "command_source")}
    assert choices(root, "valve") == valves
    if path.name == "cascade.launch.xml":
        scenarios = set(lookup(NODES["command_source"], "scenario").choices)
        assert choices(root, "scenario") == scenarios - {"array"}  # which needs a file of numbers


def test_the_axis_is_launched_with_each_machine_and_message():
    root = ET.parse(ROOT / "launch" / AXIS).getroot()
    machines = {path.stem for path in (ROOT / "config" / "axis").glob("*.yaml")}
    assert choices(root, "machine") == machines - {"hopsan_position_servo"}  # at 100 kHz, for no node
    for launched in (root, ET.parse(ROOT / "launch" / ARM).getroot()):
        for name in ("message", "upper_level"):
            assert choices(launched, name) == set(lookup(ROS_NODES["axis_controller"], name).choices)


def started(root):
    """Files in config/ of each node that a launch file starts, by the node's full name."""
    for name, node in nodes(root, {"namespace": ""}):
        named = [p.get("from", "") for p in node.findall("param")]
        paths = [name.split("valve_control)/")[1] for name in named if name and not OF_THE_USER.match(name)]
        yield name, [ROOT / path for path in paths]


def test_both_axes_of_the_arm_take_their_machines_and_the_manifold_has_their_valves():
    found = dict(started(ET.parse(ROOT / "launch" / ARM).getroot()))
    valves = arguments_of("/manifold", found.pop("/manifold"))["valves"]
    assert found.pop("/recorder") == [] and found.pop("/dashboard") == []
    both = ("axis_simulator", "axis_controller")
    assert set(found) == {f"/{valve}/{node}" for valve in valves for node in both}
    for valve in valves:
        simulated, upper = (arguments_of(name, found[name]) for name in (f"/{valve}/{n}" for n in both))
        assert simulated["joint"] == upper["joint"] == valve
        assert upper["machine"] == f"crane_{valve}"
        assert known_machine(upper["machine"])["cylinder.area_a"] == simulated["cylinder.area_a"]
        assert arguments_of(f"/{valve}/valve_simulator", found[f"/{valve}/axis_simulator"][:1])
        # The law of its valve comes from the manifold's file, to the node that a stop deactivates.
        assert upper["stop.controller"] == "controller"
        assert arguments_of(f"/{valve}/controller", [ROOT / "config" / "arm.yaml"])["controller"] == "pid"


def test_the_campaign_of_the_arm_starts_its_nodes_with_their_files():
    found = dict(started(ET.parse(ROOT / "launch" / ARM).getroot()))
    begun = {}
    for program, words in campaign.commands().values():
        space = next((word.removeprefix("__ns:=") for word in words if word.startswith("__ns:=")), "")
        begun[f"{space}/{program}"] = [
            Path(path) for option, path in pairwise(words) if option == "--params-file"
        ]
    assert begun == {name: paths for name, paths in found.items() if name not in ("/recorder", "/dashboard")}


def arguments_of(name, paths):
    """Values that a node of the full ``name`` has from ``paths``, the later ones winning."""
    table = ROS_NODES[name.rsplit("/", 1)[1]]
    values = defaults(table)
    for path in paths:
        values.update(addressed(str(path), name, table))
    return values


def duration(text):
    return launching.value_of("duration", text, "/command_source")


@pytest.mark.parametrize(
    ("convert", "text", "words"),
    [
        (launching.sample_period, "0.0", "rate is 0.0 Hz; it must lie between 10 and 100000 Hz"),
        (launching.sample_period, "-1000", "rate is -1000 Hz"),
        (launching.sample_period, "1e9", "rate is 1e9 Hz"),
        (launching.sample_period, "fast", "rate is 'fast'; it must be a number"),
        (launching.sample_period, "nan", "rate is 'nan'"),
        (launching.sample_period, "", "rate is ''"),
        (duration, "-1.0", "duration is -1 s; it must lie between"),
        (duration, "long", "duration is 'long'; it must be a number"),
    ],
)
def test_wrong_numbers_of_a_launch_are_one_sentence(convert, text, words):
    with pytest.raises(ParameterError) as error:
        convert(text)
    assert words in str(error.value)


@pytest.mark.parametrize("name", sorted(files_for("controller")))
def test_a_law_is_launched_by_the_name_of_its_file(name):
    assert launching.law_option(name) == "--params-file"
    assert launching.law_value(name) == str(ROOT / "config" / f"{name}.yaml")


def test_every_law_can_be_launched_and_nothing_else():
    assert {"arc", "oarc", "pid", "compensator", "open_loop"} <= set(LAWS)
    for name in LAWS:
        value = launching.law_value(name)
        if launching.law_option(name) == "-p":
            assert value == f"controller:={name}"
        else:
            assert [s.values["controller"] for s in files.sections(value)] == [name]
    for wrong in ("OARC", "", "d3fxe", "manifold", "../config/arc"):
        with pytest.raises(ParameterError) as error:
            launching.law_value(wrong)
        assert f"controller is '{wrong}'; it must be 'arc', 'oarc'" in str(error.value)
        assert "'open_loop'" in str(error.value) and "'pid_plain'" in str(error.value)


def test_numbers_of_a_launch_become_those_of_the_nodes():
    assert launching.sample_period("2000") == 0.0005 and launching.sample_period("10") == 0.1
    assert duration("60") == 60.0


GIVEN = {
    "namespace": "", "simulate": "true", "record": "false", "bag": "valve_bag", "dashboard": "false",
    "port": "8080", "params_file": "",
}  # fmt: skip
EVERY_FILE = [
    ("record:=yes", "record is 'yes'; it must be true or false"),
    ("dashboard:=on", "dashboard is 'on'; it must be true or false"),
    ("simulate:=maybe", "simulate is 'maybe'; it must be true or false"),
    ("port:=80x", "port is '80x'; it must be a number"),
    ("port:=8080.5", "port is '8080.5'; it must be a whole number"),
    ("port:=8080.0", "port is '8080.0'; it must be a whole number"),
    ("port:=8e3", "port is '8e3'; it must be a whole number"),
    ("port:=-1", "port is -1; it must lie between"),
    ("port:=70000", "port is 70000; it must lie between"),
    ("namespace:=1st", "namespace is '1st'; it must be of letters, digits and _"),
    ("namespace:=boom/", "namespace is 'boom/'"),
    ("recrod:=true", "has no argument 'recrod'; did you mean 'record'?"),
    ("xyzzy:=1", "has no argument 'xyzzy'; it has "),
    ("params_file:=nosuch.yaml", "parameter file nosuch.yaml cannot be read: No such file"),
]


@pytest.mark.parametrize(("argument", "words"), EVERY_FILE)
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_wrong_arguments_of_every_file_are_one_sentence(path, argument, words, monkeypatch):
    name, value = argument.split(":=")
    monkeypatch.setattr("sys.argv", ["ros2", "launch", "valve_control", path.name, argument])
    with pytest.raises(ParameterError) as error:
        launching.checked(path.name, **{**GIVEN, name: value})
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "words", [["machine", "machine.launch.xml"], ["machine", "valve.launch.xml"], ["/crane/valve.launch.xml"]]
)
def test_the_arguments_of_a_file_that_is_included_are_those_of_another(words, monkeypatch):
    monkeypatch.setattr("sys.argv", ["ros2", "launch", *words, "crane:=big"])
    assert launching.checked("valve.launch.xml", **GIVEN) == "valve.launch.xml"


@pytest.mark.parametrize("words", [["valve_control", "valve.launch.xml"], ["launch/valve.launch.xml"]])
def test_a_launch_of_this_package_is_known_by_its_package_or_its_path(words, monkeypatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr("sys.argv", ["ros2", "launch", *words, "crane:=big"])
    with pytest.raises(ParameterError, match=r"valve\.launch\.xml has no argument 'crane'"):
        launching.checked("valve.launch.xml", **GIVEN)


def test_a_recording_that_exists_ends_the_launch_before_anything_runs(tmp_path):
    for record in ("true", "1", "True"):
        with pytest.raises(ParameterError, match="exists already; name a new one with bag:=NAME"):
            launching.checked("axis.launch.xml", **{**GIVEN, "record": record, "bag": str(tmp_path)})
    launching.checked("axis.launch.xml", **{**GIVEN, "bag": str(tmp_path)})


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_arguments_may_have_quotation_marks_and_backslashes(path, tmp_path):
    folder = tmp_path / "o'neil \\"
    folder.mkdir()
    mine = folder / "'x'"
    nodes = {"valve.launch.xml": "controller", "cascade.launch.xml": "command_source"}
    node = nodes.get(path.name, "axis_controller")
    mine.write_text(f"{node}: {{ros__parameters: {{sample_period: 0.002}}}}")
    found = variables(path, params_file=str(mine), bag=str(folder / "new\\"), record="true")
    assert str(mine) in [value for name, value in found.items() if name != "params_file"]
    for name, words in [("namespace", "namespace is"), ("port", "port is"), ("record", "record is")]:
        with pytest.raises(ParameterError, match=words):
            variables(path, **{name: "'"})


@pytest.fixture
def own(tmp_path):
    """Writes a file of parameters, and returns its path."""

    def write(text):
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return str(path)

    return write


def test_a_file_of_the_user_reaches_the_nodes_that_it_is_for(own):
    mine = own("/**/controller: {ros__parameters: {controller: pid, sample_period: 0.002}}")
    assert (launching.file_option(mine), launching.file_value(mine)) == ("--params-file", mine)
    assert launching.parameters_of(mine, "arm.yaml", "manifold", "controller") == mine
    valve = str(ROOT / "config" / "d3fxe.yaml")
    assert launching.parameters_of(mine, "d3fxe.yaml", "valve_simulator") == valve
    assert (launching.file_option(""), launching.file_value("")) == ("-r", "__node:=controller")
    mine = own("valve_simulator: {ros__parameters: {gain_scale: 0.9}}")  # in the process of axis_simulator
    assert variables(ROOT / "launch" / "axis.launch.xml", params_file=mine)["axis_simulator_file"] == mine
    # A node that gets a file with a section for another namespace alone does not start.
    mine = own(
        "/**/boom/axis_controller: {ros__parameters: {kp: 2.0}}\n"
        "/**/arm/valve_simulator: {ros__parameters: {seed: 2}}"
    )
    found = variables(ROOT / "launch" / "arm.launch.xml", params_file=mine, namespace="crane")
    got = {name for name, value in found.items() if name.endswith("_file") and value == mine}
    assert got == {"params_file", "boom_controller_file", "arm_simulator_file"}


def test_controller_and_valve_have_one_period_also_if_the_file_names_it_for_one(own):
    mine = own("/controller: {ros__parameters: {sample_period: 0.002}}")
    assert launching.sample_period("1000.0", mine) == 0.002
    two = own(
        "/controller: {ros__parameters: {sample_period: 0.002}}\n"
        "/valve_simulator: {ros__parameters: {sample_period: 0.001}}"
    )
    with pytest.raises(ParameterError, match=r"several sample periods, '0\.001' or '0\.002' s"):
        launching.sample_period("1000.0", two)


@pytest.mark.parametrize(
    ("setting", "text", "words"),
    [
        (
            {"controller": "oarc"},
            "controller: {ros__parameters: {controller: pid}}",
            "controller is 'oarc', ",
        ),
        ({"rate": "500"}, "controller: {ros__parameters: {sample_period: 0.004}}", "rate is '500', and"),
        ({"duration": "5"}, "command_source: {ros__parameters: {duration: 7.0}}", "duration is '5', and"),
        (
            {"duration": "abc"},
            "command_source: {ros__parameters: {duration: 7.0}}",
            "duration is 'abc'; it must",
        ),
        (
            {"rate": "3001"},
            "controller: {ros__parameters: {sample_period: 0.000333333}}",
            "rate is '3001', and",
        ),
        ({}, "controller: {ros__parameters: {controler: pid}}", "did you mean 'controller'?"),
        ({}, "controller: {ros__parameters: {u_max: 1000.0}}", "u_max is 1000 V; it must lie between"),
        ({}, "axis_simulator: {ros__parameters: {seed: 1}}", "has nothing for the nodes of cascade.launch"),
    ],
)
def test_a_file_of_the_user_that_contradicts_or_is_wrong_is_refused(own, setting, text, words, monkeypatch):
    file = "cascade.launch.xml"
    monkeypatch.setattr("sys.argv", ["launched.py", f"launch/{file}"])
    given = {"controller": "arc", "rate": "1000.0", "scenario": "point_to_point", "duration": "60.0"}
    with pytest.raises(ParameterError) as error:
        launching.checked(file, **{**GIVEN, **given, **setting, "params_file": own(text)})
    assert words in str(error.value)


@pytest.mark.parametrize("name", sorted(path.name for path in (ROOT / "config" / "tuned").glob("*.yaml")))
def test_what_tune_wrote_can_be_launched(name):
    path = ROOT / "config" / "tuned" / name
    given = {**GIVEN, "controller": "arc", "rate": "1000.0", "params_file": str(path)}
    launching.checked("valve.launch.xml", **given)
    assert launching.file_value(str(path)) == str(path)


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ({"duration": "7"}, "command_source: {ros__parameters: {duration: 7.0}}"),
        ({"scenario": "sine"}, "command_source: {ros__parameters: {scenario: sine}}"),
        ({"rate": "3000"}, "controller: {ros__parameters: {sample_period: 0.000333333}}"),
        ({}, "controller: {ros__parameters: {controller: pid}}"),
        ({"duration": "7"}, "axis_controller: {ros__parameters: {duration: 3.0}}"),  # not launched here
    ],
)
def test_an_argument_may_say_what_the_file_of_the_user_says(own, setting, text):
    given = {"controller": "arc", "rate": "1000.0", "scenario": "point_to_point", "duration": "60.0"}
    launching.checked("cascade.launch.xml", **{**GIVEN, **given, **setting, "params_file": own(text)})


def beside(**given):
    """Whether valve_simulator runs, and the values that the controller gets for its device."""
    found = variables(ROOT / "launch" / "valve.launch.xml", **given)
    if found["device_option"] == "-r":
        return found["simulator"], found["device_value"]
    return found["simulator"], addressed(found["device_value"], "/v1/controller", DEVICE)


def test_a_controller_with_its_device_has_no_simulator_beside_it(own):
    assert beside() == ("true", "__node:=controller")
    assert beside(driver="serial") == ("false", {"driver": "serial"})
    mine = own("controller: {ros__parameters: {driver: serial, serial.port: /dev/ttyS1}}")
    assert beside(params_file=mine) == ("false", {"driver": "serial"})
    assert launching.file_value(mine) == mine  # which has the port


def test_a_simulated_device_is_the_valve_of_the_launch(own):
    """What valve_simulator would have, with the same values."""
    simulator, values = beside(driver="simulated", valve="d3fxe_experiment")
    there = addressed(str(ROOT / "config" / "d3fxe_experiment.yaml"), "/v1/valve_simulator", VALVE)
    names = {p.name.removeprefix("simulated.") for p in SIMULATED}
    assert simulator == "false" and values.pop("driver") == "simulated"
    assert values == {f"simulated.{name}": value for name, value in there.items() if name in names}
    assert len(values) > 3
    mine = own("valve_simulator: {ros__parameters: {gain_scale: 0.9}}")
    assert beside(driver="simulated", params_file=mine)[1]["simulated.gain_scale"] == 0.9


@pytest.mark.parametrize(
    ("given", "text", "words"),
    [
        (["driver:=seriel"], "", "driver is 'seriel'; it must be"),
        (["driver:=simulated", "simulate:=true"], "", "the driver is 'simulated', beside which no valve_sim"),
        (
            ["simulate:=true"],
            "driver: serial",
            "the driver is 'serial', beside which no valve_simulator runs",
        ),
        (["driver:=serial"], "driver: modbus", "driver is 'serial', and "),
        (["driver:=serial"], "serial.bauds: 9600", "did you mean 'serial.baud' or"),
    ],
)
@pytest.mark.parametrize("path", VALVES, ids=lambda path: path.name)
def test_a_wrong_driver_is_refused(path, own, given, text, words, monkeypatch):
    monkeypatch.setattr("sys.argv", ["ros2", "launch", "valve_control", path.name, *given])
    mine = {"params_file": own(f"controller: {{ros__parameters: {{{text}}}}}")} if text else {}
    with pytest.raises(ParameterError) as error:
        variables(path, **dict(word.split(":=") for word in given), **mine)
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="needs ros2 launch")
@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("controller:=OARC", ["controller", "OARC", "'oarc'"]),
        ("controller:=nonsense", ["controller", "nonsense", "'oarc'"]),
        ("valve:=none", ["valve", "none", "'d3fxe'"]),
        ("rate:=0.0", ["rate is 0.0 Hz; it must lie between 10 and 100000 Hz"]),
        ("rate:=abc", ["rate is 'abc'; it must be a number"]),
    ],
)
@pytest.mark.parametrize("path", VALVES, ids=lambda path: path.name)
def test_wrong_argument_ends_the_launch(path, argument, words):
    ends(path, argument, words)


@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="needs ros2 launch")
@pytest.mark.parametrize(("argument", "words"), [EVERY_FILE[i] for i in (0, 3, 8)])
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_what_a_launch_evaluates_late_leaves_no_node_behind(path, argument, words):
    """A condition that cannot be evaluated once ended a launch without ending the nodes before it."""
    ends(path, argument, [words])


def ends(path, argument, words):
    """Launch a file with a wrong argument: one sentence of these words, and nothing was started."""
    done = subprocess.run(launch(path, argument), capture_output=True, text=True, timeout=60)
    said = (done.stdout + done.stderr).splitlines()
    assert done.returncode == 1
    assert all(word in said[-1] for word in words), said
    assert not any("process started" in line or "Traceback" in line for line in said), said


def test_the_file_of_the_device_is_gone_after_the_launch():
    """Each launch left one in the folder of temporary files."""
    code = (
        "from valve_control.control.parameters import launching\n"
        "path = launching.device_value('simulated', '', 'd3fxe')\n"
        "print(path, 'driver' in open(path).read())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    path, read = done.stdout.split()
    assert read == "True" and not Path(path).exists()
