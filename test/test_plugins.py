# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Laws of other packages: the example of the docs, built and installed, and packages that are broken."""

import json
import os
import subprocess
import sys
from pathlib import Path
from string import ascii_lowercase

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "docs" / "examples" / "lead_law"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder with the example, built and installed as pip does it."""
    folder = tmp_path_factory.mktemp("site")
    source = tmp_path_factory.mktemp("source") / "lead_law"
    subprocess.run(["cp", "-r", EXAMPLE, source], check=True)
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps",
         "--no-build-isolation", "--target", folder, source],
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


def run(folder, *arguments, module="valve_control.cli"):
    environment = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT / 'test' / 'recordings'}"}
    return subprocess.run(
        [sys.executable, "-m", module, *map(str, arguments)],
        capture_output=True, text=True, timeout=400, env=environment,
    )  # fmt: skip


def test_the_example_is_short():
    files = [path for path in EXAMPLE.rglob("*") if path.suffix in (".py", ".toml")]
    assert len((EXAMPLE / "valve_lead_law" / "lead.py").read_text().splitlines()) < 100 and len(files) == 3


def test_the_example_does_what_the_package_s_own_laws_do(installed):
    done = run(installed, ROOT / "test" / "plugged_in.py", "-q", "-p", "no:cacheprovider", module="pytest")
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_example_on_the_command_line(installed, tmp_path):
    lead = ("--controller", "lead", "--json")
    told, said = each(
        installed,
        ["parameters", "lead."],
        ["simulate", *lead, str(tmp_path / "run.json"), "--set", "lead.gain=3.0"],
        ["study", *lead, str(tmp_path / "study.json"), "--valves", "16", "--folder", str(tmp_path / "kept")],
    )
    assert "lead.gain = 2.0 V/V" in " ".join(told) and told.count("status=0") == 3, said
    assert json.loads((tmp_path / "run.json").read_text())["indices"]["e_rms"] < 0.2
    assert json.loads((tmp_path / "study.json").read_text())["controller"] == "lead"


def test_the_example_can_be_launched(installed):
    words = 'print(launching.law_option("lead"), launching.law_value("lead"))'
    code = f"from valve_control.control.parameters import launching; {words}"
    environment = {**os.environ, "PYTHONPATH": str(installed)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment)
    assert done.returncode == 0 and done.stdout == "-p controller:=lead\n", done.stderr
    without = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert without.returncode == 1 and "controller is 'lead'; it must be 'arc'" in without.stderr


LAW = """
import sys
from typing import NamedTuple
from valve_control.control.laws.free import Free
from valve_control.control.laws.law import Law
from valve_control.parameter import Parameter, number

class Params(NamedTuple):
    u_max: float
    period: float

class State(NamedTuple):
    last: float

class Terms(NamedTuple):
    reference: float
    z1: float
    unsaturated_voltage: float

def initial(p, start):
    return State(start.voltage)

def step(p, s, command, measurement, offset):
    voltage = command + offset
    return voltage, State(voltage), Terms(command, measurement - command, command)

def hold(p, s, command, measurement, voltage):
    return s

def build(values):
    return Params(number(values, "u_max"), number(values, "sample_period"))

LAW = Law("mine", "broken", sys.modules[__name__], (), build, reshapes=lambda p: False,
          steady_command=lambda p, start: start.voltage)
"""


def package(folder, text, letter="a"):
    """Package ``package_a`` with the law ``minea`` in the module ``law_a``."""
    (folder / f"law_{letter}.py").write_text(text.replace('"mine', f'"mine{letter}'))
    information = folder / f"package_{letter}-1.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: package_{letter}\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(f"[valve_control.laws]\nmine{letter} = law_{letter}:LAW\n")


def gained(free):
    """LAW's arguments from its parameters on: one gain, and what a tuner may choose."""
    return f'], (Parameter("mine.k", 1.0, "", ""),), build, free=({free},)'


NO_GAIN = "], (), build"
BROKEN = [
    ('Law("mine"', 'Law("arc"', "the name is taken by a law of valve_control"),
    ('Law("mine"', 'Law("My law"', "its name is 'My law'; it must be one word in lower case"),
    ("import sys\n", "import sys\nimport not_there\n", "it cannot be imported: ModuleNotFoundError"),
    (
        "import sys\n",
        "import sys\nfrom valve_control.laws.law import Law\n",
        "it imports valve_control.laws, which is valve_control.control.laws now; change its imports",
    ),
    (
        "import sys\n",
        "import sys\nfrom valve_control import bags\n",
        "it imports valve_control.bags, which is valve_control.recordings.bags now; change its imports",
    ),
    (
        "import sys\n",
        "import sys\nimport valve_control.nowhere\n",
        "it cannot be imported: ModuleNotFoundError",
    ),
    ("command, measurement, offset)", "command)", "must take (params, state, command, measurement, offset)"),
    ("def hold(", "def held(", "{law} has no function hold(params, state, command"),
    ("class Terms", "class Others", "{law} has no NamedTuple Terms"),
    ("    u_max: float\n", "", "{law}.Params has no field u_max"),
    ("last: float", "last: list", "{law}.State.last must be a float or a NamedTuple of floats"),
    ("State(voltage), Terms", "Terms", "its step must return (voltage, state, terms)"),
    ("command + offset", "command + float('nan')", "it must be a finite float"),
    ("command + offset", "1.0 / (command - command)", "its first step fails: ZeroDivisionError"),
    ("    return s\n", "    return voltage\n", "its hold gives float; it must be State"),
    ("LAW = Law(", "LAW, _ = None, Law(", "it is None; it must be a valve_control.control.laws.law.Law"),
    ("last: float", "theta: float", "there must be a parameter {name}.theta_initial"),
    (NO_GAIN, gained("1").replace("mine.k", "other.k"), "its parameter other.k must begin with '{name}.'"),
    (NO_GAIN, NO_GAIN + ', dead_time="mine.t"', "its dead_time is '{name}.t'; it must be one of its"),
    (NO_GAIN, gained("1"), "it has 1 to choose; it must be a valve_control.control.laws.free.Free"),
    (NO_GAIN, gained('Free("mine.j", 0.1, 1.0)'), "{name}.j to choose, and {name}.j is none of its numbers"),
    (NO_GAIN, gained('Free("mine.k", 1.0, 0.5)'), "the range of {name}.k goes from 1 to 0.5"),
    (
        NO_GAIN,
        gained('Free("mine.k", 0.1, 1.0, unit=lambda v: v["mine.j"])'),
        "the unit of {name}.k asks for '{name}.j', which is none of its numbers",
    ),
    (NO_GAIN, gained('Free("mine.k", 0.1, 1.0, unit=lambda v: 0.0)'), "the unit of {name}.k is 0 with"),
]


@pytest.fixture(scope="module")
def beside_broken_laws(tmp_path_factory):
    """A run of PID in one process with all the broken packages."""
    folder = tmp_path_factory.mktemp("broken")
    for letter, (old, new, _) in zip(ascii_lowercase, BROKEN, strict=False):
        assert old in LAW
        package(folder, LAW.replace(old, new), letter)
    return run(folder, "simulate", "--controller", "pid", "--duration", "0.1", "--json", "-")


@pytest.mark.parametrize("number", range(len(BROKEN)), ids=[reason[:30] for _, _, reason in BROKEN])
def test_a_broken_law_is_named_in_one_sentence_and_the_rest_works(beside_broken_laws, number):
    done = beside_broken_laws
    letter, reason = ascii_lowercase[number], BROKEN[number][2]
    assert done.returncode == 0 and json.loads(done.stdout)["controller"] == "pid"
    start = f"valve-control: the law 'mine{letter}' of the package package_{letter} is left out: "
    (line,) = [line for line in done.stderr.splitlines() if line.startswith(start)]
    assert reason.format(law=f"law_{letter}", name=f"mine{letter}") in line and "Traceback" not in done.stderr
    assert done.stderr.count("left out") == len(BROKEN)


UNCOMPILED = {  # voltage of a law that runs as Python: what numba has against it
    "eval('command')": "Untyped global name 'eval'",
    "float(isinstance(s, State))": "No implementation of function",
    "inner()": "make.<locals>.inner is a function within a function",
    "recursive(command)": "one of its functions calls itself",
    "float(str(command))": "could not convert string to float",
    "s._replace(last=command).last": "Unknown attribute '_replace' of type State",
}
HELPERS = """
def make():
    kept = []
    def inner():
        return float(len(kept))
    return inner
inner = make()

def recursive(x):
    return recursive(x - 1.0) if x > 1.0 else x

def initial("""
EACH = """
import json, sys
from valve_control.cli import command
for words in json.loads(sys.argv[1]):
    try:
        print(f"status={command.run(words)}")
    except SystemExit as end:
        print(f"status={end.code}")
"""


def each(folder, *commands):
    """Status and sentences of several commands in one process, with the packages in ``folder``."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "-c", EACH, json.dumps(commands)],
        capture_output=True, text=True, timeout=300, env=environment, cwd=folder,
    )  # fmt: skip
    return done.stdout.split(), done.stderr.splitlines()


def test_a_law_that_does_not_compile_is_named_with_its_package_and_the_reason(tmp_path):
    for letter, voltage in zip(ascii_lowercase, UNCOMPILED, strict=False):
        text = LAW.replace("voltage = command + offset", f"voltage = {voltage} + offset")
        package(tmp_path, text.replace("\ndef initial(", HELPERS), letter)
    letters = ascii_lowercase[: len(UNCOMPILED)]
    commands = [["simulate", "--controller", f"mine{letter}", "--duration", "0.1"] for letter in letters]
    statuses, said = each(tmp_path, *commands)
    assert statuses == ["status=2"] * len(UNCOMPILED) and len(said) == len(UNCOMPILED), said
    for line, letter, reason in zip(said, letters, UNCOMPILED.values(), strict=True):
        start = f"valve-control: the law 'mine{letter}' of the package package_{letter} does not compile: "
        assert line.startswith(start + reason), line


def test_a_law_that_fails_in_a_run_is_one_sentence_with_the_time(tmp_path):
    """Errors name the line too. Numbers of 300 digits were printed, with status 0."""
    bad = {"a": "raise ValueError('no such square')", "b": "return math.inf, s, Terms(0.0, 0.0, 0.0)"}
    for letter, statement in bad.items():
        text = LAW.replace(
            "    voltage = command", f"    if command == 0.5:\n        {statement}\n    voltage = command"
        )
        package(tmp_path, text.replace("import sys\n", "import math\nimport sys\n", 1), letter)
    step = ["--scenario", "step", "--set", "amplitude=0.5", "--duration", "1.0"]
    commands = [["simulate", "--controller", f"mine{letter}", *step] for letter in "ab"]
    statuses, said = each(tmp_path, *commands)
    assert statuses == ["status=1"] * 2 and len(said) == 2, said
    assert said == [
        "valve-control: the law 'minea' of the package package_a raised ValueError: no such square "
        "(law_a.py, line 26) after 0.250 s",
        "valve-control: mineb produced NaN or infinity after 0.250 s",
    ]


def test_margins_and_tune_name_a_law_that_does_not_compile(tmp_path):
    text = LAW.replace("command + offset", "command - 0.5 * isinstance(s, State) * measurement + offset")
    text = text.replace("reshapes=", "model=lambda p: (59.0, 1657.0, 1502.0), free=(FREE,), reshapes=")
    text = text.replace("(), build", '(Parameter("mine.gain", 1.0, "", "", 0.0, 9.0),), build')
    free = "from valve_control.control.laws.free import Free\n\n"
    free += "FREE = Free('minea.gain', 0.1, 5.0)\n\ndef initial("
    package(tmp_path, text.replace("\ndef initial(", free))
    tune = ["tune", "--budget", "4", "--valves", "1", "--unseen", "1", "--json", "-"]
    statuses, said = each(tmp_path, *([*c, "--controller", "minea"] for c in (["margins"], tune)))
    assert statuses == ["status=2"] * 2 and len(said) == 2, said
    assert all("the law 'minea' of the package package_a does not compile: " in line for line in said)


def test_a_law_that_was_left_out_is_named_when_it_is_asked_for(tmp_path):
    package(tmp_path, LAW.replace("    u_max: float\n", ""))
    (tmp_path / "asks.yaml").write_text("controller:\n  ros__parameters:\n    controller: minea\n")
    statuses, said = each(
        tmp_path,
        ["simulate", "--controller", "minea"],
        ["simulate", "--set", "controller=minea"],
        ["tune", "--controller", "minea,pid", "--json", "-"],
        ["simulate", "--params-file", "asks.yaml"],
    )
    reason = "the law 'minea' of the package package_a is left out: law_a.Params has no field u_max"
    assert statuses == ["status=2"] * 4 and len(said) == 5, said  # the file: note and refusal
    assert all(reason in line for line in said)
    assert not any("must be 'arc'" in line or "choose from" in line for line in said)
