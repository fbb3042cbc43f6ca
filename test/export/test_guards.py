# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Exported C refuses to be compiled into other numbers, and compiles as C++."""

import shutil
import subprocess

import pytest
from driven import EACH_COMPILER

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


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
