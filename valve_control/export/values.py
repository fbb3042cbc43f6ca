# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""What all parts of a translated function share: names, lines, kinds of values, numbers, conditions."""

import ast
import types
from collections.abc import Iterator
from typing import Any

from valve_control.export import kinds
from valve_control.export.emission import Program, behind, wrapped
from valve_control.export.kinds import BOOLEAN, INTEGER, NOTHING, REAL, WORD, Kind, identifier
from valve_control.export.terms import (
    BOTH,
    CHOICE,
    EITHER,
    EQUALITY,
    FUNCTIONS,
    MISSING,
    UNARY,
    SubsetError,
    Term,
    article,
    shown_path,
)

INDENT = "    "


class Values:
    """A function that is translated, with the values that it has."""

    def __init__(
        self,
        program: Program,
        function: types.FunctionType,
        parsed: ast.stmt,
        said: dict[int, str],
    ) -> None:
        self._program = program
        self._function = function
        if not isinstance(parsed, ast.FunctionDef):
            raise self.refused(parsed, "only plain functions can be exported")
        self._parsed = parsed
        self._said = said
        self._scope: dict[str, Term] = {}
        self._lines: list[str] = []
        self._indent = INDENT
        self._temporaries = 0
        self._declared: dict[str, Kind] = {}
        self._head: list[str] = []  # declarations of what first gets a value within a block
        self._returns: Kind | None = None
        names = [node.id for node in ast.walk(parsed) if isinstance(node, ast.Name)]
        stored = {n.id for n in ast.walk(parsed) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        self._stored = stored
        self._locals = stored | {a.arg for a in parsed.args.args}
        self._taken = set(names) | set(self._locals)

    def refused(self, node: ast.AST, text: str) -> SubsetError:
        """Error that names the line of ``node``."""
        line = self._function.__code__.co_firstlineno + getattr(node, "lineno", 1) - 1
        where = shown_path(self._function.__code__.co_filename)
        return SubsetError(f"{where}:{line}: {text}; this is outside what can be exported to C")

    def _type(self, node: ast.AST, kind: Kind, name: str) -> str:
        try:
            return self._program.declared(kind, name)
        except TypeError as error:
            raise self.refused(node, str(error)) from error

    def _local(self, name: str) -> str:
        """C name of a local variable; none hides a function that is called."""
        plain = identifier(name)
        return f"{plain}_" if plain in FUNCTIONS or plain in ("abs", "fmod", "given", "NAN") else plain

    def _line(self, text: str, said: str = "") -> None:
        self._lines += wrapped(text + behind(said), self._indent)

    def _untaken(self, word: str) -> str:
        """``word`` with a number that no variable has."""
        self._temporaries += 1
        while f"{word}{self._temporaries}" in self._taken:
            self._temporaries += 1
        return f"{word}{self._temporaries}"

    def _temporary(self, term: Term, node: ast.AST) -> Term:
        """``term`` in a variable of its own."""
        name = self._untaken("made")
        self._line(f"const {self._type(node, term.kind, name)} = {term.value};")
        return Term(name, term.kind, has_address=True)

    def _parts(self, whole: Term, node: ast.AST) -> Iterator[Term]:
        if whole.kind.what == "record":
            for name, kind in kinds.fields(whole.kind.record).items():
                yield Term(whole.field(identifier(name)), kind, has_address=True)
        elif whole.kind.what == "tuple":
            for i, kind in enumerate(whole.kind.items):
                yield Term(whole.field(f"item{i}"), kind, has_address=True)
        else:
            raise self.refused(node, "what is no tuple is taken apart")

    def _expression(self, node: ast.expr, wanted: Kind | None = None) -> Term:
        """Place of the translator of expressions."""
        raise NotImplementedError

    # Kinds, conditions and numbers

    def _as(self, term: Term, kind: Kind, node: ast.AST) -> Term:
        """``term`` as a value of ``kind``."""
        if term.kind == kind:
            return term
        if kind.what == "optional":
            name = self._program.type_name(kind)
            inner = kind.items[0]
            if term.kind is NOTHING:
                return Term(f"({name}){self._program.constant(None, kind)}", kind, has_address=True)
            return Term(f"({name}){{true, {self._as(term, inner, node).value}}}", kind, has_address=True)
        if term.kind.what == "optional" and kind.what != "optional":
            inner_term = Term(term.field("value"), term.kind.items[0], has_address=True)
            return self._as(inner_term, kind, node)
        if kind is REAL and term.kind is INTEGER:
            if term.code.isdigit():
                return Term(self._program.number(float(term.code)), REAL)
            return Term(f"({self._program.real}){term.inside(UNARY)}", REAL, UNARY)
        if kind is REAL and term.kind is BOOLEAN:
            one, zero = self._program.number(1.0), self._program.number(0.0)
            return Term(f"{term.inside(EITHER)} ? {one} : {zero}", REAL, CHOICE)
        if kind is INTEGER and term.kind is BOOLEAN:
            return Term(f"(int64_t){term.inside(UNARY)}", INTEGER, UNARY)
        raise self.refused(node, f"a value is {article(term.kind)} here and {article(kind)} elsewhere")

    def _joined(self, a: Kind, b: Kind, node: ast.AST) -> Kind:
        """Kind that holds values of both."""
        if a == b:
            return a
        if NOTHING in (a, b):
            given = b if a is NOTHING else a
            return given if given.what == "optional" else kinds.optional(given)
        if a.is_number and b.is_number:
            return REAL if REAL in (a, b) else INTEGER
        for one, other in ((a, b), (b, a)):
            if one.what == "optional" and one.items[0] == other:
                return one
        raise self.refused(node, f"a value is {article(a)} in one case and {article(b)} in the other")

    def _truth(self, node: ast.expr) -> Term:
        """``node`` as a condition."""
        if isinstance(node, ast.BoolOp):
            word, binds = ("&&", BOTH) if isinstance(node.op, ast.And) else ("||", EITHER)
            parts = [self._truth(value) for value in node.values]
            codes = [
                part.inside(EQUALITY) if part.binds in (BOTH, EITHER) else part.inside(binds)
                for part in parts
            ]
            return Term(f" {word} ".join(codes), BOOLEAN, binds)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return Term(f"!{self._truth(node.operand).inside(UNARY)}", BOOLEAN, UNARY)
        term = self._expression(node)
        if term.kind is BOOLEAN:
            return term
        if term.kind in (INTEGER, WORD):
            return Term(f"{term.inside(EQUALITY - 1)} != 0", BOOLEAN, EQUALITY)
        if term.kind is REAL:
            return Term(f"{term.inside(EQUALITY - 1)} != {self._program.number(0.0)}", BOOLEAN, EQUALITY)
        raise self.refused(node, f"{article(term.kind)} is taken for true or false")

    def _number(self, node: ast.expr) -> Term:
        """``node`` as a number."""
        term = self._expression(node)
        if term.kind.what == "optional":
            term = self._as(term, term.kind.items[0], node)
        if not term.kind.is_number:
            raise self.refused(node, f"{article(term.kind)} in arithmetic")
        return self._as(term, INTEGER, node) if term.kind is BOOLEAN else term

    def _real(self, node: ast.expr) -> Term:
        return self._as(self._number(node), REAL, node)

    def _resolved(self, node: ast.expr) -> Any:
        """What a name of the module stands for, or MISSING for all that is computed."""
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name) and node.id not in self._locals:
            scope = self._function.__globals__
            if node.id in scope:
                return scope[node.id]
            builtins = scope.get("__builtins__", {})
            found = builtins if isinstance(builtins, dict) else vars(builtins)
            if node.id not in found:
                raise self.refused(node, f"there is no {node.id}")
            return found[node.id]
        if isinstance(node, ast.Attribute):
            base = self._resolved(node.value)
            if isinstance(base, types.ModuleType):
                if not hasattr(base, node.attr):
                    raise self.refused(node, f"{base.__name__} has no {node.attr}")
                return getattr(base, node.attr)
        return MISSING
