# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``valve-control export``: the folder that it makes, what it and the C in it refuse."""

import ctypes
import json
import math
import os
import shutil
import subprocess

import pytest
from c_library import Library
from driven import EACH_COMPILER

from valve_control.control.linear.linear_loop import flatten
from valve_control.control.parameters.table import CONTROLLER
from valve_control.export import settable, sources, unit
from valve_control.parameter import defaults

compiles = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
GAINS = """/controller:
  ros__parameters:
    controller: oarc
    oarc: {ks1: 90.0, robust_term: quadratic}
"""


def make(folder, *words):
    return subprocess.run(["make", "-C", folder, *words], capture_output=True, text=True, timeout=100)


@compiles
def test_the_contract(run, tmp_path):
    (tmp_path / "gains.yaml").write_text(GAINS)
    options = "--controller oarc --params-file gains.yaml --set reshaping.lead=0.003 --json about.json"
    status, out, err = run("export", *options.split(), "--output", "made")
    assert status == 0 and out.startswith("wrote made/ with oarc.h, oarc.c, check.csv, Makefile")
    assert err == "note: the law alone has no lead of the command (reshaping.lead); --watch has it\n"
    folder = tmp_path / "made"
    text = (folder / "oarc.c").read_text()
    assert ".ks1 = 0x1.6800000000000p+6 /* 90.0 */," in text and "malloc" not in text
    assert "\n- oarc.robust_term: it is no real number\n" in (folder / "README.md").read_text()
    done = make(folder, "check")
    assert done.returncode == 0 and "rows equal to the last bit" in done.stdout, done.stdout + done.stderr
    assert "-Wall -Wextra -Wconversion -Wpedantic -Werror" in done.stdout
    about = json.loads((tmp_path / "about.json").read_text())
    assert "oarc.epsilon1" in about["settable"] and "oarc.robust_term" in about["new_export"]
    # The comparison can fail: one bit of a gain is enough.
    (folder / "oarc.c").write_text(text.replace("0x1.6800000000000p+6", "0x1.6800000000001p+6"))
    done = make(folder, "check")
    assert done.returncode != 0 and "rows differ" in done.stdout


SOLENOID = (
    "--set", "valve=solenoid", "--set", "solenoid.hysteresis=0.2", "--set", "friction.coulomb=0.3",
    "--set", "friction.presliding=0.02", "--set", "solenoid.dead_time=0.0007", "--set", "solenoid.dither=0.1",
    "--set", "lvdt.delay=0.0004", "--set", "solenoid.bits=12", "--set", "solenoid.hum=0.003",
    "--set", "solenoid.null_drift=0.001", "--set", "solenoid.warming=10.0", "--set", "solenoid.u_min=-3.0",
)  # fmt: skip


@compiles
@pytest.mark.parametrize(
    "words", [["--plant", "valve", "--set", "lvdt.delay=0.0013", "--set", "friction.coulomb=1.0"],
              ["--plant", "valve", *SOLENOID],
              ["--controller", "dcarc", "--float"]],
)  # fmt: skip
def test_a_valve_and_a_law_in_float(run, tmp_path, words):
    assert run("export", *words, "--output", "made")[0] == 0
    done = make(tmp_path / "made", "check")
    assert done.returncode == 0, done.stdout + done.stderr
    assert ("within" if "--float" in words else "equal to the last bit") in done.stdout


REFUSED = [
    (["--output", "there"], "there exists; give a name that is not taken yet"),
    (["--output", "no/where"], "no/where cannot be made: there is no folder"),
    (["--output", ""], "--output has an empty name"),
    (["--output", "new", "--set", "oarc.ks1=-1.0"], "oarc.ks1 is -1 1/s; it must lie between"),
    (["--output", "new", "--controller", "arc", "--plant", "valve"], "export --plant takes no --controller"),
    (["--output", "new", "--fmu", "2", "--float"], "export --fmu takes no --float"),
    (["--output", "new.fmu", "--fmu", "2"], "needs a C compiler, and there is no not_there"),
    (["--output", "new", "--float"], "needs a C compiler, and there is no not_there"),
    (["--output", "new", "--watch", "--float"], "export --watch takes no --float"),
    (["--output", "new", "--float", "--set", "oarc.k2=1e12", "--controller", "oarc"], "compiler"),
]


@pytest.mark.parametrize(("words", "reason"), REFUSED, ids=[reason[:30] for _, reason in REFUSED])
def test_what_cannot_be_done_is_one_sentence_and_nothing_is_written(
    run, tmp_path, monkeypatch, words, reason
):
    (tmp_path / "there").mkdir()
    monkeypatch.setenv("CC", "not_there")
    status, out, err = run("export", *words)
    assert status == 2 and out == "" and reason in err and err.count("\n") == 1
    assert os.listdir(tmp_path) == ["there"]


@compiles
def test_the_setters_in_c_take_what_lies_in_the_range():
    chosen = unit.law({**defaults(CONTROLLER), "controller": "oarc"})
    library = Library(chosen)
    before = flatten(chosen.params)
    params = (ctypes.c_double * len(before))(*before)
    for setter in settable.find(chosen).setters:
        p = setter.parameter
        function = getattr(library.functions, sources.setter_name(chosen, setter))
        function.restype = ctypes.c_bool
        entry = [] if setter.entry is None else [setter.entry]
        above, below = math.nextafter(p.high, math.inf), math.nextafter(p.low, -math.inf)
        for wrong in (above, below, math.nan, math.inf, -math.inf):
            assert not function(params, *entry, ctypes.c_double(wrong)) and list(params) == before, p.name
        for value in (p.low, p.high, 0.9 * p.low + 0.1 * p.high):
            assert function(params, *entry, ctypes.c_double(value))
            whole = value
            if entry:
                whole = [value if i == setter.entry else v for i, v in enumerate(chosen.values[p.name])]
            assert list(params) == flatten(chosen.build({**chosen.values, p.name: whole})), p.name
        if entry:
            assert not function(params, 99, ctypes.c_double(p.low))
        params = (ctypes.c_double * len(before))(*before)


@pytest.fixture
def compiled(run, tmp_path):
    def make(options, command):
        name = options[1]
        if not (tmp_path / name).exists():
            status, _, err = run("export", *options, "--output", name)
            assert status == 0, err
        source = tmp_path / name / f"{name}.c"
        return subprocess.run(
            [*command, "-c", source, "-o", tmp_path / "made.o"], capture_output=True, text=True, check=False
        )

    return make


@compiles
@EACH_COMPILER
def test_unsafe_mathematics_and_other_numbers_are_refused(compiled, compiler):
    options = ("--controller", "pid")
    assert compiled(options, [compiler]).returncode == 0
    for flag, word in (
        ("-ffast-math", "NaN"),
        ("-Ofast", "NaN"),
        ("-ffinite-math-only", "NaN"),
        ("-Ddouble=float", "macros"),
        ("-D__DBL_MANT_DIG__=24", "IEEE 754"),
        ("-D__DBL_MAX_EXP__=128", "IEEE 754"),
        ("-D__CHAR_BIT__=16", "8 bit"),
    ):
        done = compiled(options, [compiler, "-O2", flag])
        said = [line for line in done.stderr.splitlines() if "error" in line]
        assert done.returncode != 0 and any(word in line for line in said), (flag, done.stderr)


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
@pytest.mark.parametrize("options", [("--controller", "pid", "--watch"), ("--plant", "valve")])
def test_it_compiles_as_cpp(compiled, options):
    done = compiled(options, ["c++", "-x", "c++"])
    assert done.returncode == 0, done.stderr
