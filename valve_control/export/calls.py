# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Translates calls: of functions, NamedTuples, ``_replace``, built-in functions and those of math."""

import ast
import inspect
import math
import types
import typing
from collections.abc import Sequence
from typing import Any

from valve_control.export import kinds
from valve_control.export.kinds import ARRAY, BOOLEAN, INTEGER, NOTHING, REAL, Kind, identifier
from valve_control.export.terms import (
    ARGUMENTS,
    ATOM,
    BOTH,
    CHOICE,
    EQUALITY,
    FUNCTIONS,
    MISSING,
    SUM,
    UNARY,
    Term,
)
from valve_control.export.values import Values


class Calls(Values):
    """A function with the calls that it makes."""

    def _call(self, node: ast.Call) -> Term:
        if isinstance(node.func, ast.Attribute) and node.func.attr == "_replace":
            return self._replaced(node)
        called = self._resolved(node.func)
        if called is MISSING:
            raise self.refused(node, f"a call of {ast.unparse(node.func)}, which is known only at run time")
        if hasattr(called, "_fields"):
            return self._made(node, called)
        if isinstance(called, types.FunctionType):
            return self._called(node, called)
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise self.refused(node, f"the arguments of {ast.unparse(node.func)}")
        if called is all:
            return self._all_finite(node)
        if called in (abs, min, max, int, float, len, bool):
            return self._builtin(node, called)
        name = getattr(called, "__name__", "")
        if getattr(math, name, None) is called and name in FUNCTIONS:
            return self._mathematics(node, name)
        raise self.refused(node, f"a call of {ast.unparse(node.func)}")

    def _replaced(self, node: ast.Call) -> Term:
        assert isinstance(node.func, ast.Attribute)
        base = self._expression(node.func.value)
        if base.kind.what != "record" or node.args:
            raise self.refused(node, f"a call of {ast.unparse(node.func)}")
        listed = kinds.fields(base.kind.record)
        values = {}
        for keyword in node.keywords:
            if keyword.arg is None or keyword.arg not in listed:
                raise self.refused(node, f"{base.kind.record.__name__} has no field {keyword.arg}")
            kind = listed[keyword.arg]
            values[keyword.arg] = self._as(self._expression(keyword.value, kind), kind, node)
        name = self._untaken("changed")
        self._line(f"{self._program.declared(base.kind, name)} = {base.value};")
        for field, term in values.items():
            self._line(f"{name}.{identifier(field)} = {term.value};")
        return Term(name, base.kind, has_address=True)

    def _given(
        self, node: ast.Call, names: Sequence[str], defaults: dict[str, Any], what: str
    ) -> dict[str, Any]:
        """Arguments of a call by name: expressions, terms, or the values of defaults."""
        found: dict[str, Any] = {}
        for argument in node.args:
            if isinstance(argument, ast.Starred) and self._is_map(argument.value):
                items: list[Any] = self._mapped(argument.value)
            elif isinstance(argument, ast.Starred):
                whole = self._expression(argument.value)
                if not whole.has_address:
                    whole = self._temporary(whole, node)
                items = list(self._parts(whole, node))
            else:
                items = [argument]
            for item in items:
                if len(found) >= len(names):
                    raise self.refused(node, f"{what} takes {len(names)} arguments")
                found[names[len(found)]] = item
        for keyword in node.keywords:
            if keyword.arg is None or keyword.arg not in names or keyword.arg in found:
                raise self.refused(node, f"{what} has no argument {keyword.arg}, or has it twice")
            found[keyword.arg] = keyword.value
        for name in names:
            if name not in found:
                if name not in defaults:
                    raise self.refused(node, f"{what} lacks its argument {name}")
                found[name] = defaults[name]
        return found

    def _argument(self, node: ast.AST, given: Any, wanted: Kind | None) -> Term:
        if isinstance(given, Term):
            return given
        if isinstance(given, ast.expr):
            return self._expression(given, wanted)
        kind = kinds.of_value(given)
        if kind is None or kind.is_struct:
            raise self.refused(node, f"the default {given!r} of an argument")
        return Term(self._program.constant(given, kind), kind) if kind is not NOTHING else Term("0", NOTHING)

    def _made(self, node: ast.Call, record: Any) -> Term:
        kind = Kind("record", record)
        try:
            listed = kinds.fields(record)
            name = self._program.type_name(kind)
        except TypeError as error:
            raise self.refused(node, str(error)) from error
        given = self._given(node, list(listed), dict(record._field_defaults), record.__name__)
        values = [
            self._as(self._argument(node, given[field], wanted), wanted, node).value
            for field, wanted in listed.items()
        ]
        return Term(f"({name}){{{', '.join(values)}}}", kind, has_address=True)

    def _called(self, node: ast.Call, function: types.FunctionType) -> Term:
        signature = inspect.signature(function)
        names = list(signature.parameters)
        defaults = {
            name: p.default
            for name, p in signature.parameters.items()
            if p.default is not inspect.Parameter.empty
        }
        given = self._given(node, names, defaults, function.__name__)
        try:
            hints = typing.get_type_hints(function)
        except NameError:
            hints = {}
        terms = [self._argument(node, given[n], kinds.of_annotation(hints.get(n))) for n in names]
        return self._applied(node, function, terms)

    def _is_map(self, node: ast.expr) -> bool:
        """Whether ``node`` is ``map(function, …)``."""
        return isinstance(node, ast.Call) and self._resolved(node.func) is map and len(node.args) > 1

    def _mapped(self, node: ast.expr) -> list[Any]:
        """Results of ``map(function, records…)``, entry by entry."""
        assert isinstance(node, ast.Call)
        function = self._resolved(node.args[0])
        if not isinstance(function, types.FunctionType):
            raise self.refused(node, f"map with {ast.unparse(node.args[0])}")
        wholes = [self._expression(argument) for argument in node.args[1:]]
        wholes = [whole if whole.has_address else self._temporary(whole, node) for whole in wholes]
        parts = zip(*(self._parts(whole, node) for whole in wholes), strict=False)
        return [self._applied(node, function, terms) for terms in parts]

    def _applied(self, node: ast.AST, function: types.FunctionType, terms: Sequence[Term]) -> Term:
        """A call of ``function``."""
        made = self._program.translate(function, [term.kind for term in terms])
        codes = []
        # What lies in a memory that the function may change is handed over as a copy.
        memories = tuple(f"{t.code}->" for t, k in zip(terms, made.arguments, strict=True) if k.is_memory)
        for term, kind in zip(terms, made.arguments, strict=True):
            term = self._as(term, kind, node)
            if kind.is_memory and not term.pointer:
                raise self.refused(node, f"{function.__name__} gets a memory that is none of the caller's")
            if kind.is_struct:
                literal = "{" in term.code  # whose address only C has, and C++ has not
                shared = bool(memories) and term.code.startswith(memories)
                if literal or shared or not (term.has_address or term.pointer):
                    term = self._temporary(term, node)
                codes.append(term.code if term.pointer else f"&{term.inside(ATOM)}")
            else:
                codes.append(term.value)
        return Term(f"{made.name}({', '.join(codes)})", made.returns)

    def _builtin(self, node: ast.Call, called: Any) -> Term:
        if called is bool:
            return self._truth(node.args[0])
        if called is len:
            array = self._expression(node.args[0])
            if array.kind is not ARRAY:
                raise self.refused(node, "len of what is no array")
            return Term(array.field("rows"), INTEGER)
        if called in (min, max):
            if len(node.args) < 2:
                raise self.refused(node, f"{called.__name__} of one argument")
            terms = [self._number(argument) for argument in node.args]
            kind = terms[0].kind
            for term in terms[1:]:
                kind = self._joined(kind, term.kind, node)
            if kind is INTEGER:
                sign = "<" if called is min else ">"
                first = terms[0]
                for term in terms[1:]:
                    first, term = (t if t.binds == ATOM else self._temporary(t, node) for t in (first, term))
                    code = f"{term.value} {sign} {first.value} ? {term.value} : {first.value}"
                    first = Term(code, INTEGER, CHOICE)
                return first
            codes = [self._as(term, REAL, node).value for term in terms]
            name = self._program.helper("least" if called is min else "most")
            code = codes[0]
            for other in codes[1:]:
                code = f"{name}({code}, {other})"
            return Term(code, REAL)
        if len(node.args) != 1:
            raise self.refused(node, f"{called.__name__} with {len(node.args)} arguments")
        term = self._number(node.args[0])
        if called is abs and term.kind is INTEGER:
            term = term if term.binds == ATOM else self._temporary(term, node)
            return Term(f"{term.value} < 0 ? -{term.value} : {term.value}", INTEGER, CHOICE)
        if called is abs:
            return Term(f"{self._program.helper('fabs')}({term.value})", REAL)
        if called is float:
            return self._as(term, REAL, node)
        return term if term.kind is INTEGER else Term(f"(int64_t){term.inside(UNARY)}", INTEGER, UNARY)

    def _all_finite(self, node: ast.Call) -> Term:
        """``all(map(math.isfinite, record))``."""
        given = node.args[0]
        if (
            self._is_map(given)
            and isinstance(given, ast.Call)
            and self._resolved(given.args[0]) is math.isfinite
        ):
            whole = self._expression(given.args[1])
            if not whole.has_address or "{" in whole.code:  # isfinite is a macro
                whole = self._temporary(whole, node)
            parts = list(self._parts(whole, node))
            if all(part.kind is REAL for part in parts):
                codes = [f"{self._program.helper('isfinite')}({part.value}) != 0" for part in parts]
                return Term(" && ".join(codes), BOOLEAN, BOTH)
        raise self.refused(node, "all of anything but map(math.isfinite, …) of a record of numbers")

    def _mathematics(self, node: ast.Call, name: str) -> Term:
        if len(node.args) != ARGUMENTS.get(name, 1):
            raise self.refused(node, f"math.{name} with {len(node.args)} arguments")
        arguments = ", ".join(self._real(argument).value for argument in node.args)
        code = f"{self._program.helper(name)}({arguments})"
        if name.startswith("is"):
            return Term(f"{code} != 0", BOOLEAN, EQUALITY)
        if name in ("floor", "ceil"):
            return Term(f"{code} + {self._program.number(0.0)}", REAL, SUM)  # an integer of Python has no -0
        return Term(code, REAL)
