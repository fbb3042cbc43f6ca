# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Unrolls loops over a table of the module, whose entries are known before the program runs."""

import ast
import copy
from collections.abc import Mapping
from typing import Any


def unroll(parsed: ast.stmt, scope: Mapping[str, Any]) -> dict[str, Any]:
    """Repeat in ``parsed`` the body of each ``for`` over a tuple of ``scope`` for each entry.

    ``getattr`` and ``setattr`` whose name is a field of the entry become attributes. Returns the entries by
    the names that stand for them.
    """
    loops = _Loops(scope)
    loops.visit(parsed)
    ast.fix_missing_locations(parsed)
    return loops.entries


class _Loops(ast.NodeTransformer):
    def __init__(self, scope: Mapping[str, Any]) -> None:
        self._scope = scope
        self.entries: dict[str, Any] = {}

    def visit_For(self, node: ast.For) -> Any:
        self.generic_visit(node)
        table = self._scope.get(node.iter.id) if isinstance(node.iter, ast.Name) else None
        if not (isinstance(table, tuple) and isinstance(node.target, ast.Name)) or node.orelse:
            return node
        made: list[ast.stmt] = []
        for i, entry in enumerate(table):
            name = f"{node.target.id}_{i}"
            self.entries[name] = entry
            body = _Entry(node.target.id, name, entry)
            made += [body.visit(copy.deepcopy(statement)) for statement in node.body]
        return made or ast.copy_location(ast.Pass(), node)


class _Entry(ast.NodeTransformer):
    """One entry in place of the variable of the loop."""

    def __init__(self, variable: str, name: str, entry: Any) -> None:
        self._variable, self._name, self._entry = variable, name, entry

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id != self._variable:
            return node
        return ast.copy_location(ast.Name(self._name, node.ctx), node)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        field = self._field(node, "getattr", 2)
        self.generic_visit(node)
        if not field:
            return node
        return ast.copy_location(ast.Attribute(node.args[0], field, ast.Load()), node)

    def visit_Expr(self, node: ast.Expr) -> ast.stmt:
        field = self._field(node.value, "setattr", 3)
        self.generic_visit(node)
        if not field:
            return node
        assert isinstance(node.value, ast.Call)
        target = ast.Attribute(node.value.args[0], field, ast.Store())
        return ast.copy_location(ast.Assign([target], node.value.args[2]), node)

    def _field(self, node: ast.expr, function: str, count: int) -> str:
        """The name of which ``node`` calls ``function``, if it is a field of the entry; else ""."""
        match node:
            case ast.Call(func=ast.Name(id=called), args=[_, ast.Attribute(ast.Name(variable), field), *_]):
                if called == function and variable == self._variable and len(node.args) == count:
                    return str(getattr(self._entry, field))
        return ""
