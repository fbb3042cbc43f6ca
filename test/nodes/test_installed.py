# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A clone built with colcon: nodes and commands run from the install space, when the source tree is gone."""

import os
import shutil
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
COLCON = shutil.which("colcon", path=f"{BIN}{os.pathsep}{os.environ['PATH']}")
pytestmark = [
    pytest.mark.skipif(COLCON is None, reason="colcon is not installed"),
    pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no clone: git knows the files of a build"),
]
PROGRAMS = sorted(
    entry.name for entry in distribution("valve_control").entry_points if entry.group == "console_scripts"
)
WHERE = """
import valve_control
from valve_control.control.parameters.ros_file import config_folder
print(valve_control.__file__, config_folder())
"""


class Installed(NamedTuple):
    """An install space."""

    prefix: Path
    environment: dict[str, str]  # after its setup.bash

    def command(self, name, *arguments):
        return [str(word) for word in (self.prefix / "lib" / "valve_control" / name, *arguments)]

    def run(self, folder, *words):
        return subprocess.run(
            self.command(*words),
            cwd=folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=120,
        )


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The files under version control, built; their source tree is removed."""
    space = tmp_path_factory.mktemp("ws")
    source = space / "src" / "valve_control"
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).exists():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, source / name)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["PATH"] = f"{BIN}{os.pathsep}{environment['PATH']}"

    def colcon(*arguments):
        return subprocess.run(
            [COLCON, *arguments], cwd=space, env=environment, capture_output=True, text=True, timeout=300
        )

    found = colcon("list")
    assert "(ros.ament_python)" in found.stdout, found.stdout + found.stderr
    built = colcon("build")
    assert built.returncode == 0, built.stdout + built.stderr
    for folder in ("src", "build"):
        shutil.rmtree(space / folder)
    script = f"source {space}/install/setup.bash && env -0"
    sourced = subprocess.run(
        ["bash", "-c", script], env=environment, capture_output=True, text=True, check=True
    ).stdout
    environment = dict(line.split("=", 1) for line in sourced.split("\0") if "=" in line)
    environment["NUMBA_DISABLE_JIT"] = "1"  # the same numbers, without compiling into a new folder
    return Installed(space / "install" / "valve_control", environment)


def test_modules_and_files_are_those_of_the_install_space(installed, tmp_path):
    prefix = installed.prefix
    assert str(prefix) in installed.environment["AMENT_PREFIX_PATH"].split(os.pathsep)
    assert (prefix / "share/ament_index/resource_index/packages/valve_control").exists()
    said = subprocess.run(
        [sys.executable, "-c", WHERE], cwd=tmp_path, env=installed.environment, capture_output=True, text=True
    )
    module, config = map(Path, said.stdout.split())
    assert module.is_relative_to(prefix) and config == prefix / "share" / "valve_control" / "config"
    wanted = {path.relative_to(ROOT / "config") for path in (ROOT / "config").rglob("*") if path.is_file()}
    assert {path.relative_to(config) for path in config.rglob("*") if path.is_file()} == wanted
    assert sorted(path.name for path in (prefix / "lib" / "valve_control").iterdir()) == PROGRAMS


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_executable_answers(installed, tmp_path, name):
    done = installed.run(tmp_path, name, "--help")
    assert done.returncode == 0 and name in done.stdout and len(done.stdout.splitlines()) > 3, done.stderr
    assert done.stderr == "" and not any(tmp_path.iterdir())
