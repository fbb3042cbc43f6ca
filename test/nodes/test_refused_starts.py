# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes that are started wrongly say so in one sentence, and end without having made anything."""

import forked

from valve_control.control.parameters import ros_file

BENCH = str(ros_file.config_folder() / "axis" / "bench.yaml")
PARAMETERS = (  # node, its parameters, words of the sentence
    ("controller", ["controller:=lqr"], "'lqr'"),
    ("controller", ["controller:=2"], "controller is 2; it must be a string"),
    ("controller", ["controler:=oarc"], "'controler'; did you mean 'controller'?"),
    ("controller", ["arc.k1:=-3.0"], "arc.k1"),
    ("controller", ["arc.k1:=fast"], "arc.k1"),
    ("controller", ["sample_period:=0.0"], "sample_period"),
    ("controller", ["realtime.cpus:=two"], "realtime.cpus is 'two'; it must be CPU numbers such as 2 or 2,3"),
    ("controller", ["realtime.cpus:='777'"], "realtime.cpus names CPU 777"),
    ("controller", ["driver:=serial", "serial.port:=/dev/no_such_port"],
     "valve_control: the port /dev/no_such_port cannot be opened"),
    ("controller", ["driver:=simulated", "lockstep:=true"], "a device keeps its own time"),
    ("valve_simulator", ["valve:=servo"], "'servo'"),
    ("command_source", ["scenario:=zigzag"], "'zigzag'"),
    ("valve_driver", ["serial.port:=/dev/no_such_port"],
     "the port /dev/no_such_port cannot be opened: No such file"),
    ("valve_driver", ["position.scale:=mA"], "position.scale: 'mA' is no scale; it must be V"),
    ("valve_driver", ["driver:=canbus"], "driver is 'canbus'; it must be"),
    ("manifold", ["valves:=[boom]", "u_maxi:=5.0"], "'u_maxi'; did you mean 'u_max'"),
    ("manifold", ["valves:=[boom, boom]"], "twice"),
    ("manifold", ["valves:=['1st']"], "1st"),
    ("manifold", ["valves:=['a b']"], "a b"),
    ("manifold", ["valves:=[1.0]"], "valves"),
    ("manifold", ["valves:=[a,b]", "driver:=modbus"], "driver is 'modbus', which waits for its device"),
    ("recorder", ["bag:=here"], "exists already; a bag needs a new folder"),
    ("recorder", ["bag:=new", "topics:=['/a(']"], "topics has '/a(', which is no regular expression"),
    ("recorder", ["bag:=new", "storage:=sqlite3", "compression:=zstd"], "storage sqlite3 has none"),
    ("recorder", ["bag:=new", "storage:=hdf5"], "'hdf5'"),
    ("recorder", ["bag:=new", "flush_period:=2.0"], "flush_period"),
    ("recorder", ["compresion:=zstd"], "'compresion'; did you mean 'compression'?"),
)  # fmt: skip
LINES = (  # node, its command line, words of the sentence
    ("controller", ["--params-file", "boom.yaml"], "unrecognized arguments: --params-file boom.yaml"),
    ("controller", ["driver:=simulated"], "unrecognized arguments: driver:=simulated"),
    ("valve_driver", ["--check", "driver:=simulated"], "driver:=simulated stands before --ros-args"),
    ("controller", ["--ros-args", "--params-file", "."], "Couldn't parse params file"),
    ("valve_simulator", ["--ros-args", "--params-file", "gone.yaml"], "Couldn't parse params file"),
    ("manifold", ["--ros-args", "-p", "valves:=[a,b]", "--params-file", "a.yaml"],
     "/b/controller has no parameter driver"),
    ("axis_simulator", ["--ros-args", "--params-file", BENCH, "-p", "axis_simulator:cylinder.stroke:=-0.5"],
     "cylinder.stroke is -0.5 m; it must lie"),
    ("axis_simulator", ["--ros-args", "--params-file", BENCH, "-p", "valve_simulator:sample_period:=0.002"],
     "they must be equal"),
)  # fmt: skip


def starts():
    """(node, command line), words of the sentence."""
    for node, settings, words in PARAMETERS:
        given = ["--ros-args", *(word for setting in settings for word in ("-p", setting))]
        yield (node, given), words
        if node == "valve_driver":
            yield (node, ["--check", *given]), words
    for node, given, words in LINES:
        yield (node, given), words


def test_each_wrong_start_is_one_sentence(tmp_path):
    folder, log = tmp_path / "folder", tmp_path / "log"
    (folder / "here").mkdir(parents=True)
    (folder / "a.yaml").write_text(ros_file.as_yaml({"/a/controller": {"driver": "simulated"}}))
    for (node, given), words in starts():
        child = forked.Child(node, given, log, folder)
        try:
            ended = child.wait(30.0)
        finally:
            child.kill()
        said = log.read_text()
        *logged, sentence = said.splitlines()
        assert ended == 2 and words in sentence and "Traceback" not in said, (node, given, ended, said)
        logs = node != "valve_driver" and any(word.startswith("driver:=") for word in given)
        assert logs or not logged or "unrecognized" in words, (node, given, said)
    assert sorted(path.name for path in folder.iterdir()) == ["a.yaml", "here"]
    assert not list((folder / "here").iterdir())


def test_help_is_printed_and_what_rcl_refuses_is_said_last(tmp_path):
    log = tmp_path / "log"
    for words, status, said in (
        (["--help"], 0, "valve-control parameters"),
        (["--ros-args", "-r", "bad"], 2, "Couldn't parse remap rule: '-r bad'"),
    ):
        child = forked.Child("controller", words, log, tmp_path)
        assert child.wait(30.0) == status and "Traceback" not in log.read_text()
        assert said in (log.read_text() if status == 0 else log.read_text().splitlines()[-1])
