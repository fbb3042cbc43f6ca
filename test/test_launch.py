"""Launch files: well formed, and all that they name exists."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from valve_control.parameters.table import NODES, lookup

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / "launch").glob("*.launch.xml"))
VARIABLE = re.compile(r"\$\(var (\w+)\)")


def arguments(root):
    return {arg.get("name"): arg.get("default") for arg in root.findall("arg")}


def test_there_are_launch_files():
    assert {path.name for path in FILES} == {"valve.launch.xml", "cascade.launch.xml"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_launch_file_names_only_what_exists(path):
    root = ET.parse(path).getroot()
    assert root.tag == "launch"
    declared = arguments(root)
    assert {"controller", "valve", "rate", "namespace", "record"} <= set(declared)
    for arg in root.findall("arg"):
        assert arg.get("default") is not None and arg.get("description"), arg.get("name")
    used = set(VARIABLE.findall(path.read_text(encoding="utf-8")))
    assert used <= set(declared) and set(declared) - used == set()
    executables = re.search(r"NODES = \[(.*?)\]", (ROOT / "setup.py").read_text(), re.DOTALL).group(1)
    for node in root.iter("node"):
        assert node.get("pkg") == "valve_control" and f'"{node.get("exec")}"' in executables
        for param in node.findall("param"):
            if param.get("from") is None:
                lookup(NODES[node.get("exec")], param.get("name"))
                continue
            folder, name = param.get("from").split("valve_control)/")[1].rsplit("/", 1)
            choices = [name]
            for variable in VARIABLE.findall(name):
                text = next(a.get("description") for a in root.findall("arg") if a.get("name") == variable)
                listed = re.findall(r"\b(arc|oarc|pid|pid_plain|compensator|open_loop)\b", text)
                choices = [
                    name.replace(f"$(var {variable})", value) for value in {declared[variable], *listed}
                ]
            for choice in choices:
                assert (ROOT / folder / choice).is_file(), choice
    recorders = [node for node in root.iter("node") if node.get("exec") == "recorder"]
    for recorder in recorders:
        assert recorder.get("if") == "$(var record)" and recorder.find("param").get("value") == "$(var bag)"
    assert len(recorders) == (path.name == "valve.launch.xml")
    for include in root.iter("include"):
        target = ROOT / include.get("file").split("valve_control)/")[1]
        known = arguments(ET.parse(target).getroot())
        assert {arg.get("name") for arg in include.findall("arg")} == set(known)
