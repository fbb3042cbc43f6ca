# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The package with what rosdep installs alone: every key is known, daily commands run without the rest."""

import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
KNOWN = yaml.safe_load((ROOT / "test" / "data" / "rosdep.yaml").read_text(encoding="utf-8"))
IMPORTED = {"pyyaml": "yaml", "setuptools": "setuptools"}  # where it is not the name of the package

# Runs valve-control where the packages of its first argument are not installed.
ALONE = """
import sys
from importlib.machinery import PathFinder
find = PathFinder.find_spec
def found(name, path=None, target=None):
    return None if name.split(".")[0] in absent else find(name, path, target)
absent = set(sys.argv.pop(1).split(","))
PathFinder.find_spec = found
"""
COMMAND = ALONE + "from valve_control.cli import main\nsys.exit(main())\n"
RECORD = (
    ALONE
    + """
from pathlib import Path
from valve_control.recordings.bags.writer import BagWriter, usual
from rosbags.typesys import Stores, get_typestore
store = get_typestore(Stores.ROS2_JAZZY)
number = store.types["std_msgs/msg/Float64"]
with BagWriter(Path(sys.argv[1]), usual()) as writer:
    names = ("/spool_command", "/spool_position", "/valve_voltage")
    for name in names:
        writer.add_topic(name, "std_msgs/msg/Float64", "float64 data", "")
    for k in range(2000):
        for place, name in enumerate(names):
            at = 10**18 + k * 10**6 + place * 10**4
            data = bytes(store.serialize_cdr(number(0.001 * (k % 7)), "std_msgs/msg/Float64"))
            writer.write(name, at, at, k + 1, data)
print(usual())
"""
)


def keys():
    """Keys of package.xml that the package needs at run time."""
    root = ElementTree.parse(ROOT / "package.xml").getroot()
    return [element.text for element in root if element.tag in ("depend", "exec_depend")]


def absent():
    """Python packages of setup.py that no key of package.xml brings."""
    block = re.search(r"install_requires=\[(.*?)\]", (ROOT / "setup.py").read_text(encoding="utf-8"), re.S)
    wanted = {IMPORTED.get(name.lower(), name) for name in re.findall(r'"([A-Za-z0-9_-]+)', block.group(1))}
    brought = {"setuptools", "yaml"}
    for key in keys():
        entry = KNOWN[key]
        names = entry["pip"] if isinstance(entry, dict) else [entry.removeprefix("python3-")]
        brought |= set(names)
    return sorted(wanted - brought)


def run(script, *arguments):
    return subprocess.run(
        [sys.executable, "-c", script, ",".join(absent()), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_every_key_of_package_xml_is_one_of_rosdep():
    root = ElementTree.parse(ROOT / "package.xml").getroot()
    wanted = [element.text for element in root if element.tag.endswith("depend")]
    assert sorted(set(wanted)) == sorted(wanted), "a key is there twice"
    assert [key for key in wanted if key not in KNOWN] == []


def test_some_packages_have_no_key():
    assert {"mcap", "zstandard", "plotly", "cma"} <= set(absent())


def test_simulate_runs_with_what_rosdep_installs(tmp_path):
    done = run(
        COMMAND, "simulate", "--controller", "oarc", "--set", "duration=0.5", "--figure", tmp_path / "a.png"
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a.png").exists()


def test_bags_are_recorded_and_analysed_with_what_rosdep_installs(tmp_path):
    done = run(RECORD, tmp_path / "bag")
    assert done.returncode == 0 and done.stdout.strip() == "sqlite3", done.stderr
    done = run(COMMAND, "analyze", tmp_path / "bag")
    assert done.returncode == 0 and ": sqlite3, " in done.stdout and "e_rms" in done.stdout, done.stderr


@pytest.mark.parametrize(
    "arguments, package",
    [
        (("tune", "--controller", "pid", "--output", "tuned.yaml"), "cma"),
        (("analyze", ROOT / "test/data/bags/kilted_sqlite3_file_zstd"), "zstandard"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_a_missing_package_is_named_in_one_sentence(arguments, package, tmp_path):
    done = run(COMMAND, *arguments)
    assert done.returncode == 2
    assert (
        done.stderr.strip()
        .splitlines()[-1]
        .endswith(f"needs the Python package {package} (pip install {package})")
    ), done.stderr
