# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What nodes use of rclpy beyond its public interface is there; each line names what broke if it is not."""

import ast
from pathlib import Path

from valve_control.nodes import rclpy_internals


def private(tree):
    """Modules of rclpy that are imported, and attributes of other objects, whose names begin with _."""
    for node in ast.walk(tree):
        named = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        named += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        yield from (name for name in named if name.startswith("rclpy.") and "._" in name)
        if (
            isinstance(node, ast.Attribute)
            and ast.unparse(node.value) not in OWN
            and node.attr.startswith("_")
            and node.attr not in PUBLIC
            and not node.attr.endswith("__")
        ):
            yield ast.unparse(node)


OWN = ("self", "super()", "cls", "os")
PUBLIC = ("_asdict", "_fields", "_replace")  # of every NamedTuple


def test_one_file_alone_knows_private_names_of_rclpy():
    """So that another version of rclpy is met in that file."""
    folder = Path(rclpy_internals.__file__).parent
    found = {
        path.name: list(private(ast.parse(path.read_text(encoding="utf-8")))) for path in folder.rglob("*.py")
    }
    assert {"rclpy._rclpy_pybind11", "node._parameter_overrides"} <= set(found.pop("rclpy_internals.py"))
    assert {name: names for name, names in found.items() if names} == {}
