# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Exported C refuses to be compiled into other numbers, and compiles as C++."""

import shutil
import subprocess

import pytest

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


def test_unsafe_mathematics_are_refused(compiled):
    options = ("--controller", "pid")
    assert compiled(options, ["cc"]).returncode == 0
    for flag, word in (
        ("-ffast-math", "NaN"),
        ("-Ofast", "NaN"),
        ("-ffinite-math-only", "NaN"),
        ("-D__DBL_MANT_DIG__=24", "IEEE 754"),
    ):
        done = compiled(options, ["cc", "-O2", flag])
        assert done.returncode != 0 and "#error" in done.stderr and word in done.stderr, flag


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
@pytest.mark.parametrize("options", [("--controller", "pid", "--watch"), ("--plant", "axis")])
def test_it_compiles_as_cpp(compiled, options):
    done = compiled(options, ["c++", "-x", "c++"])
    assert done.returncode == 0, done.stderr
