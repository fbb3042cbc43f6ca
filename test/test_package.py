# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The package as colcon, ROS and pip see it, and the files that must agree with the table."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from valve_control import __version__
from valve_control.axis import tables
from valve_control.control.parameters import build, drivers, files, table
from valve_control.parameter import defaults, updated

ROOT = Path(__file__).resolve().parents[1]
LAWS = ROOT / "valve_control" / "control" / "laws"


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.yaml")), ids=lambda p: p.name)
def test_config_files_load_and_build(path):
    changes = files.load(str(path), nodes=tables.ROS_NODES)
    assert any(changes.values())
    values = {node: updated(t, defaults(t), changes[node]) for node, t in table.NODES.items()}
    build.law_params(values["controller"])
    build.valve_params(values["valve_simulator"])
    build.shape(values["command_source"])
    t = tables.ROS_NODES["valve_driver"]
    drivers.sides(updated(t, defaults(t), changes["valve_driver"]))


def test_every_parameter_has_text_and_a_finite_range():
    for t in tables.ROS_NODES.values():
        values = updated(t, {}, defaults(t))
        assert len(values) == len(t)
        for parameter in t:
            assert parameter.text
            if isinstance(parameter.default, (float, int)) and not isinstance(parameter.default, bool):
                assert abs(parameter.low) < 1e15 and abs(parameter.high) < 1e15


def test_versions_agree():
    for name in ("package.xml", "setup.py", "CHANGELOG.rst"):
        assert __version__ in (ROOT / name).read_text(), name


HEAVY = ("rclpy", "numba", "matplotlib", "plotly", "pandas", "rosbags")


@pytest.mark.parametrize(
    "module",
    [f"valve_control.control.laws.{p.stem}" for p in LAWS.glob("[a-z]*.py")]
    + ["valve_control.control.supervision.supervisor"],
)
def test_laws_are_imported_without_what_they_do_not_need(module):
    """A program of one's own that steps a law does not load ROS, a compiler or plotting."""
    script = f"import sys, {module}; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


MOST = 12_000  # lines


def test_a_controller_imports_what_it_needs():
    """Neither the axis nor simulations nor bags; lines of this package are counted as they are."""
    script = (
        "import sys, valve_control.nodes.controller\n"
        "for name, module in sorted(sys.modules.items()):\n"
        "    if name.startswith('valve_control'):\n"
        "        print(name, len(open(module.__file__, 'rb').read().splitlines()))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    lines = {name: int(count) for name, count in map(str.split, done.stdout.splitlines())}
    rooms = {".".join(name.split(".")[1:3]) for name in lines}
    others = {f"control.{room}" for room in ("axis", "motion", "simulation", "analysis")}
    assert not rooms & (others | {"recordings", "design", "dashboard", "export", "cli"})
    assert sum(lines.values()) <= MOST


@pytest.mark.campaign
def test_an_installed_wheel_runs_the_demo(tmp_path):
    """`pip install` of the wheel, away from the checkout and without ROS."""
    source, target = tmp_path / "source", tmp_path / "target"
    for name in ("valve_control", "config", "launch", "resource"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("setup.py", "setup.cfg", "package.xml", "README.md"):
        shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    subprocess.run([*pip, "wheel", "--no-deps", "--no-build-isolation", "-w", tmp_path, source], check=True)
    subprocess.run([*pip, "install", "--no-deps", "--target", target, *tmp_path.glob("*.whl")], check=True)
    script = "from valve_control import cli; print(cli.__file__); raise SystemExit(cli.main(['demo']))"
    environment = {**os.environ, "PYTHONPATH": str(target)}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.startswith(str(target)) and "dcarc" in done.stdout
    assert (tmp_path / "demo.png").exists()
