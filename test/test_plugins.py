# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Laws of other packages: the example of the docs, built and installed, and packages that are broken."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from string import ascii_lowercase

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "docs" / "examples"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder with both examples, built and installed as pip does it."""
    folder = tmp_path_factory.mktemp("site")
    source = shutil.copytree(EXAMPLES, tmp_path_factory.mktemp("source") / "examples")
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps",
         "--no-build-isolation", "--target", folder, source / "lead_law", source / "observer_law"],
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


def python(folder, *words):
    """Result of python in ``folder``, with the packages in it."""
    environment = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT / 'test' / 'recordings'}"}
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, timeout=400, env=environment, cwd=folder
    )


def test_the_example_does_what_the_package_s_own_laws_do(installed):
    done = python(installed, "-m", "pytest", ROOT / "test/plugged_in.py", "-q", "-p", "no:cacheprovider")
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


ONE_FILE = """
import importlib, pathlib
{typed}
print({shown})
file = pathlib.Path(valve_lead_law.__file__)
text, before = file.read_text(), vc.margins(controller=valve_lead_law.LAW)["margins"]
for old, new in {changes}:
    file.write_text(text.replace(old, new))
    law, step = valve_lead_law.LAW, valve_lead_law.step
    importlib.reload(valve_lead_law)
    if "z1" in new:  # in place, as IPython's autoreload does it
        step.__code__ = valve_lead_law.step.__code__
        vars(valve_lead_law).update(LAW=law, step=step)
    try:
        print(vc.margins(controller=valve_lead_law.LAW)["margins"] == before)
        run = {shown}
        print(f"{{run['indices']['e_rms']:.4f}} V")
    except vc.ParameterError as error:
        print(error)
"""


def test_a_law_of_one_file_runs_from_python_as_the_page_shows(tmp_path):
    page = (ROOT / "docs/tutorials/your_law.md").read_text(encoding="utf-8")
    typed, shown, *_ = [line.removeprefix(">>> ") for line in page.splitlines() if line.startswith(">>> ")]
    new, old = re.search(r"write\s`(.*?)` in place of `(.*?)`", page).groups()
    changes = [(old, new), ("+ offset", "+ offset + 0.1 * z1"), ("+ offset", "+ ofset")]
    shutil.copy(EXAMPLES / "lead_law/valve_lead_law.py", tmp_path)
    program = ONE_FILE.format(typed=typed, shown=shown, changes=changes)
    done = python(tmp_path, "-c", program)
    *table, same, faster, other, changed, refused = done.stdout.splitlines()
    assert "\n".join(table) in page and faster in page and refused in " ".join(page.split()), done.stderr
    assert (same, other) == ("True", "False") and changed not in (faster, table[1].split()[3])


KEPT_APART = """
from valve_control.control import compiling
from valve_control.control.parameters.controller import add_law
from valve_control.control.plant.saturation import saturate
import valve_lead_law
before = compiling.compile_function(saturate)
add_law(valve_lead_law.LAW)
after = compiling.compile_function(saturate)
print(before._cache.cache_path != after._cache.cache_path)
"""


def test_what_is_compiled_with_a_law_of_one_file_is_not_kept_with_the_rest(tmp_path):
    """Other programs, which lack that file, could not read it."""
    shutil.copy(EXAMPLES / "lead_law/valve_lead_law.py", tmp_path)
    done = python(tmp_path, "-c", KEPT_APART)
    assert done.stdout == "True\n", done.stderr


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


OTHER_GAIN = '], (Parameter("other.k", 1.0, "", ""),), build, free=(1,)'
BROKEN = [
    ("    return s\n", "    return s\n\ndel __file__\n", "it is in no file; write it into one"),
    ('Law("mine"', 'Law("arc"', "the name is taken by a law of valve_control"),
    ("command, measurement, offset)", "command)", "left out: TypeError: step() takes"),
    ("def hold(", "def held(", "left out: AttributeError: module 'law_"),
    ("    return s\n", "    return s s\n", "left out: SyntaxError: invalid syntax (law_"),
    ("command + offset", "command + float('nan')", "it must be a finite float"),
    ("return State(start.voltage)", "return State(0)", "its initial for State.last gives 0; it must"),
    ("return State(start.voltage)", "return State([0.0])", "its initial gives an array for State.last"),
    ("    u_max: float", "    limit: float", "its build for Params.u_max gives None"),
    ("    return s\n", "    return voltage\n", "its hold gives 0.0; it must be a {law}.State"),
    ("reshapes=", "model=lambda p: None, reshapes=", "its model gives None; it must give three numbers"),
    ("last: float", "theta: float", "there must be a parameter {name}.theta_initial"),
    ("], (), build", OTHER_GAIN, "its parameter other.k must begin with '{name}.'"),
]


@pytest.fixture(scope="module")
def beside_broken_laws(tmp_path_factory):
    """A run of PID in one process with all the broken packages."""
    folder = tmp_path_factory.mktemp("broken")
    for letter, (old, new, _) in zip(ascii_lowercase, BROKEN, strict=False):
        assert old in LAW
        package(folder, LAW.replace(old, new), letter)
    words = "-m valve_control.cli simulate --controller pid --duration 0.1 --json -"
    return python(folder, *words.split())


@pytest.mark.parametrize("number", range(len(BROKEN)), ids=[reason[:30] for _, _, reason in BROKEN])
def test_a_broken_law_is_named_in_one_sentence_and_the_rest_works(beside_broken_laws, number):
    done = beside_broken_laws
    letter, reason = ascii_lowercase[number], BROKEN[number][2]
    assert done.returncode == 0 and json.loads(done.stdout)["controller"] == "pid"
    start = f"valve-control: the law 'mine{letter}' of the package package_{letter} is left out: "
    (line,) = [line for line in done.stderr.splitlines() if line.startswith(start)]
    assert reason.format(law=f"law_{letter}", name=f"mine{letter}") in line and "Traceback" not in done.stderr
    assert done.stderr.count("left out") == len(BROKEN)


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
    done = python(folder, "-c", EACH, json.dumps(commands))
    return done.stdout.split(), done.stderr.splitlines()


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
