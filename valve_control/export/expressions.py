# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Translates expressions: operators, comparisons, conditions, fields, entries of arrays."""

import ast
from typing import Any

from valve_control.export import kinds
from valve_control.export.calls import Calls
from valve_control.export.kinds import ARRAY, BOOLEAN, INTEGER, NOTHING, REAL, WORD, Kind, identifier
from valve_control.export.terms import (
    ATOM,
    BINARY,
    BOTH,
    CHOICE,
    COMPARED,
    EITHER,
    EQUALITY,
    MISSING,
    PRODUCT,
    RELATION,
    SUM,
    UNARY,
    Term,
    article,
    named,
)


class Expressions(Calls):
    """A function with its expressions."""

    def _expression(self, node: ast.expr, wanted: Kind | None = None) -> Term:
        """``node`` in C; ``wanted``: kind that is asked for, where the expression itself leaves it open."""
        constant = self._resolved(node)
        if constant is not MISSING:
            return self._constant(node, constant)
        match node:
            case ast.Name():
                return self._variable(node)
            case ast.Attribute():
                return self._attribute(node)
            case ast.UnaryOp():
                return self._unary(node)
            case ast.BinOp():
                return self._binary(node)
            case ast.Compare():
                return self._compare(node)
            case ast.BoolOp():
                terms = [self._expression(value).kind for value in node.values]
                if any(kind is not BOOLEAN for kind in terms):
                    raise self.refused(node, "and or or between what is not true or false")
                return self._truth(node)
            case ast.IfExp():
                return self._choice(node, wanted)
            case ast.Call():
                return self._call(node)
            case ast.Tuple():
                return self._tuple(node, wanted)
            case ast.Subscript():
                return self._subscript(node)
        raise self.refused(node, named(node))

    def _constant(self, node: ast.expr, value: Any) -> Term:
        kind = kinds.of_value(value)
        if kind is None:
            raise self.refused(node, f"{ast.unparse(node)} as a value")
        if kind is NOTHING:
            return Term("0", NOTHING)
        if kind.what == "record":
            if isinstance(node, ast.Attribute):
                base = self._resolved(node.value)
                module, name = base.__name__, node.attr
            else:
                module, name = self._function.__module__, getattr(node, "id", "constant")
            return Term(self._program.shared(value, kind, name, module), kind, has_address=True)
        code = self._program.constant(value, kind)
        return Term(code, kind, UNARY if code.startswith("-") else ATOM)

    def _variable(self, node: ast.Name) -> Term:
        if node.id not in self._scope:
            raise self.refused(node, f"{node.id} has no value yet on every way to here")
        return self._scope[node.id]

    def _attribute(self, node: ast.Attribute) -> Term:
        base = self._expression(node.value)
        if base.kind.what == "optional":
            base = self._as(base, base.kind.items[0], node)
        if base.kind.what == "record":
            listed = kinds.fields(base.kind.record)
            if node.attr in listed:
                return Term(
                    base.field(identifier(node.attr)), listed[node.attr], has_address=base.has_address
                )
        raise self.refused(node, f"{ast.unparse(node)}, which is no field of a NamedTuple")

    def _unary(self, node: ast.UnaryOp) -> Term:
        if isinstance(node.op, ast.Not):
            return self._truth(node)
        if not isinstance(node.op, (ast.USub, ast.UAdd)):
            raise self.refused(node, "an operation on bits")
        term = self._number(node.operand)
        if isinstance(node.op, ast.UAdd):
            return term
        code = term.inside(UNARY)
        return Term(f"-({code})" if code.startswith("-") else f"-{code}", term.kind, UNARY)

    def _binary(self, node: ast.BinOp) -> Term:
        left, right = self._number(node.left), self._number(node.right)
        helper = self._program.helper
        if isinstance(node.op, ast.Pow):
            if left.kind is INTEGER and right.kind is INTEGER:
                raise self.refused(node, "a power of two integers")
            arguments = [self._as(term, REAL, node).value for term in (left, right)]
            return Term(f"{helper('pow')}({', '.join(arguments)})", REAL)
        both = left.kind is INTEGER and right.kind is INTEGER
        if isinstance(node.op, (ast.Mod, ast.FloorDiv)):
            whole = isinstance(node.op, ast.FloorDiv)
            if whole and not both:
                raise self.refused(node, "// of numbers that are not integers")
            name = helper("int_quotient" if whole else "int_modulo" if both else "modulo")
            kind = INTEGER if both else REAL
            arguments = [self._as(term, kind, node).value for term in (left, right)]
            return Term(f"{name}({', '.join(arguments)})", kind)
        if type(node.op) not in BINARY:
            raise self.refused(node, f"the operator in {ast.unparse(node)}")
        sign, binds = BINARY[type(node.op)]
        kind = INTEGER if both and not isinstance(node.op, ast.Div) else REAL
        left, right = self._as(left, kind, node), self._as(right, kind, node)
        second = right.inside(binds - 1)
        if second.startswith("-"):
            second = f"({second})"
        return Term(f"{left.inside(binds)} {sign} {second}", kind, binds)

    def _among(self, node: ast.Compare) -> Term:
        """``x in (…)`` with constants."""
        listed = self._resolved(node.comparators[0])
        if not isinstance(listed, tuple):
            raise self.refused(node, "in of anything but a tuple of constants")
        term = self._expression(node.left)
        if term.binds > ATOM or "(" in term.code:
            term = self._temporary(term, node)
        parts = [self._pair(node, ast.Eq(), term, self._constant(node, value)) for value in listed]
        return Term(" || ".join(part.inside(EQUALITY) for part in parts), BOOLEAN, EITHER)

    def _compare(self, node: ast.Compare) -> Term:
        if len(node.ops) == 1 and isinstance(node.ops[0], ast.In):
            return self._among(node)
        terms = [self._expression(part) for part in (node.left, *node.comparators)]
        for i in range(1, len(terms) - 1):
            if terms[i].binds > ATOM or "(" in terms[i].code:
                terms[i] = self._temporary(terms[i], node)
        parts = [self._pair(node, op, terms[i], terms[i + 1]) for i, op in enumerate(node.ops)]
        if len(parts) == 1:
            return parts[0]
        return Term(" && ".join(part.inside(EQUALITY) for part in parts), BOOLEAN, BOTH)

    def _pair(self, node: ast.Compare, op: ast.cmpop, a: Term, b: Term) -> Term:
        """One comparison of two terms."""
        if isinstance(op, (ast.Is, ast.IsNot)):
            if b.kind is not NOTHING or a.kind.what != "optional":
                raise self.refused(node, "is and is not of anything but what may be None")
            given = a.field("given")
            return Term(given, BOOLEAN) if isinstance(op, ast.IsNot) else Term(f"!{given}", BOOLEAN, UNARY)
        if type(op) not in COMPARED:
            raise self.refused(node, f"the comparison {ast.unparse(node)}")
        sign, binds = COMPARED[type(op)]
        optional = [term for term in (a, b) if term.kind.what == "optional"]
        if optional and binds == EQUALITY:
            if len(optional) == 2:
                raise self.refused(node, "a comparison of two values that may both be None")
            inner = optional[0].kind.items[0]
            a, b = (self._as(term, inner, node) for term in (a, b))
            equal = f"{optional[0].field('given')} && {a.inside(RELATION)} == {b.inside(RELATION)}"
            return Term(equal, BOOLEAN, BOTH) if sign == "==" else Term(f"!({equal})", BOOLEAN, UNARY)
        a, b = (self._as(t, t.kind.items[0], node) if t.kind.what == "optional" else t for t in (a, b))
        if WORD in (a.kind, b.kind):
            if a.kind != b.kind or binds != EQUALITY:
                raise self.refused(node, "a comparison of a word with something else")
        else:
            if not (a.kind.is_number and b.kind.is_number):
                raise self.refused(node, f"a comparison of {article(a.kind)} with {article(b.kind)}")
            kind = self._joined(a.kind, b.kind, node)
            a, b = self._as(a, kind, node), self._as(b, kind, node)
        return Term(f"{a.inside(RELATION - 1)} {sign} {b.inside(RELATION - 1)}", BOOLEAN, binds)

    def _choice(self, node: ast.IfExp, wanted: Kind | None) -> Term:
        test = self._truth(node.test)
        first, second = self._expression(node.body, wanted), self._expression(node.orelse, wanted)
        kind = self._joined(first.kind, second.kind, node)
        if wanted is not None and wanted.what == "optional":
            kind = wanted
        first, second = self._as(first, kind, node), self._as(second, kind, node)
        return Term(f"{test.inside(EITHER)} ? {first.inside(EITHER)} : {second.inside(EITHER)}", kind, CHOICE)

    def _tuple(self, node: ast.Tuple, wanted: Kind | None) -> Term:
        asked = wanted.items if wanted is not None and wanted.what == "tuple" else (None,) * len(node.elts)
        if len(asked) != len(node.elts):
            raise self.refused(node, f"{len(node.elts)} values for {len(asked)}")
        terms = [self._expression(part, kind) for part, kind in zip(node.elts, asked, strict=True)]
        terms = [
            self._as(term, kind, node) if kind else term for term, kind in zip(terms, asked, strict=True)
        ]
        kind = Kind("tuple", items=tuple(term.kind for term in terms))
        values = ", ".join(term.value for term in terms)
        return Term(f"({self._program.type_name(kind)}){{{values}}}", kind, has_address=True)

    def _subscript(self, node: ast.Subscript) -> Term:
        if isinstance(node.value, ast.Call) and isinstance(node.slice, ast.Constant):
            whole = self._expression(node.value)
            if whole.kind.what in ("record", "tuple") and isinstance(node.slice.value, int):
                return list(self._parts(whole, node))[node.slice.value]._replace(
                    has_address=whole.has_address
                )
        return self._entry(node)

    def _entry(self, node: ast.Subscript) -> Term:
        array = self._expression(node.value)
        if array.kind is not ARRAY or not isinstance(node.slice, ast.Tuple) or len(node.slice.elts) != 2:
            raise self.refused(node, f"the index in {ast.unparse(node)}")
        row, column = (self._as(self._number(index), INTEGER, node) for index in node.slice.elts)
        at = f"{row.inside(PRODUCT)} * {array.field('columns')} + {column.inside(SUM)}"
        return Term(f"{array.field('data')}[{at}]", REAL, has_address=True)
