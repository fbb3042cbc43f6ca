# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Every export compiles without a warning as C99 and C++ and passes the sanitizers, with gcc and clang."""

import functools
import io
import shutil
import subprocess
import zipfile
from pathlib import Path

import changed
import pytest
from driven import EACH_COMPILER, SANITIZERS, WARNINGS

from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters.table import VALVE
from valve_control.export import fmu, folder, sources, unit
from valve_control.parameter import defaults, updated

pytestmark = pytest.mark.campaign
DRIVE = Path(__file__).with_name("drive_fmu.c")
FRICTION = {"friction.coulomb": 1.16, "friction.static_ratio": 1.25, "friction.presliding": 0.0033}
SOLENOID = FRICTION | {
    "valve": "solenoid", "solenoid.hysteresis": 0.2, "solenoid.dead_time": 0.0007, "solenoid.bits": 12,
    "solenoid.dither": 0.1, "solenoid.hum": 0.003, "solenoid.null_drift": 0.001, "solenoid.warming": 10.0,
    "solenoid.u_min": -3.0, "lvdt.delay": 0.0004,
}  # fmt: skip
OTHERS = ("valve", "valve with solenoids")
EXPORTS = [*LAWS, *(f"{name} with its watch" for name in LAWS), *OTHERS]
CPP = {"gcc": "g++", "clang": "clang++"}


@functools.cache
def exported(name):
    """The law, watched law or plant of this name."""
    law, _, watch = name.partition(" with its ")
    if law in LAWS:
        return (unit.watched if watch else unit.law)(changed.controller(controller=law))
    values = updated(VALVE, defaults(VALVE), FRICTION if name != OTHERS[1] else SOLENOID)
    return unit.plant(values)


@functools.cache
def files(name):
    return folder.files(exported(name))


def compiled(*words):
    """Run a compiler or make, which must say nothing."""
    done = subprocess.run([str(word) for word in words], capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr


@EACH_COMPILER
@pytest.mark.parametrize("name", EXPORTS)
def test_no_compiler_warns(tmp_path, compiler, name):
    """C and the program that compares, in double and, but for the watch, in float; the header as C++."""
    chosen = exported(name)
    for file, text in files(name).items():
        (tmp_path / file).write_text(text)
    compiled(
        compiler,
        *sources.FLAGS.split(),
        *WARNINGS,
        "-c",
        tmp_path / f"{chosen.name}.c",
        "-o",
        tmp_path / "a.o",
    )
    compiled(compiler, *sources.FLAGS.split(), *WARNINGS, "-c", tmp_path / "check.c", "-o", tmp_path / "b.o")
    if chosen.inner is None:
        (tmp_path / "single").mkdir()
        made = sources.make(chosen, single=True)
        (tmp_path / "single" / f"{chosen.name}.h").write_text(made.header)
        (tmp_path / "single" / f"{chosen.name}.c").write_text(made.source)
        options = [*sources.FLAGS.split(), *WARNINGS, "-c", tmp_path / "single" / f"{chosen.name}.c"]
        compiled(compiler, *options, "-o", tmp_path / "c.o")
    if shutil.which(CPP[compiler]):
        (tmp_path / "user.cpp").write_text(f'#include "{chosen.name}.h"\n')
        compiled(CPP[compiler], "-std=c++11", *WARNINGS, "-fsyntax-only", tmp_path / "user.cpp")


@EACH_COMPILER
@pytest.mark.parametrize("name", EXPORTS)
def test_a_recorded_run_is_free_of_undefined_behaviour(tmp_path, compiler, name):
    """Under the sanitizers for addresses and undefined behaviour the voltages keep their bits."""
    chosen = exported(name)
    for file, text in files(name).items():
        (tmp_path / file).write_text(text)
    flags = f"CFLAGS={sources.FLAGS} {folder.WARNINGS} {' '.join(SANITIZERS)}"
    compiled("make", "-s", "-C", tmp_path, f"check_{chosen.name}", f"CC={compiler}", flags)
    command = [tmp_path / f"check_{chosen.name}", tmp_path / "check.csv", "--difference"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, "0", "")


@EACH_COMPILER
@pytest.mark.parametrize("version", fmu.VERSIONS)
@pytest.mark.parametrize("name", [*LAWS, *OTHERS])
def test_an_fmu_is_free_of_undefined_behaviour(tmp_path, compiler, version, name):
    """Its sources without a warning; each variable gets numbers out of its range, two instances are freed."""
    chosen = exported(name)
    with zipfile.ZipFile(io.BytesIO(fmu.make(chosen, version))) as archive:
        archive.extractall(tmp_path)
    place = tmp_path / "sources"
    program = tmp_path / "drive"
    options = [f'-DWRAPPER="fmi{version}.c"', f"-DVERSION={version}", f"-I{place}", *SANITIZERS]
    inputs = [DRIVE, place / f"{chosen.name}.c"]
    compiled(compiler, *sources.FLAGS.split(), *WARNINGS, *options, "-o", program, *inputs, "-lm")
    done = subprocess.run([program], capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr, done.stderr
    readable, settable, refused = map(int, done.stdout.split())
    assert readable > settable >= 2 and refused > 2 * 6 * (2000 - readable)
