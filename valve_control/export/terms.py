# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Terms of C, the functions and operators that they may have, and the error that names what they may not."""

import ast
from pathlib import Path
from typing import NamedTuple

from valve_control.export.kinds import Kind
from valve_control.parameter import ParameterError

EXACT = ("sqrt", "copysign", "fabs")  # rounded correctly by every C library: the compiler may evaluate them
LIBRARY = (
    *("exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
    *("sinh", "cosh", "tanh"),
)
FUNCTIONS = (*EXACT, *LIBRARY, "floor", "ceil", "isfinite", "isnan", "isinf", "pow")
ARGUMENTS = {"copysign": 2, "atan2": 2, "pow": 2}
ATOM, UNARY, PRODUCT, SUM, RELATION, EQUALITY, BOTH, EITHER, CHOICE = range(
    9
)  # how tightly an operator binds
BINARY: dict[type[ast.operator], tuple[str, int]] = {
    ast.Add: ("+", SUM),
    ast.Sub: ("-", SUM),
    ast.Mult: ("*", PRODUCT),
    ast.Div: ("/", PRODUCT),
}
COMPARED: dict[type[ast.cmpop], tuple[str, int]] = {
    ast.Lt: ("<", RELATION),
    ast.LtE: ("<=", RELATION),
    ast.Gt: (">", RELATION),
    ast.GtE: (">=", RELATION),
    ast.Eq: ("==", EQUALITY),
    ast.NotEq: ("!=", EQUALITY),
}
MISSING = object()


class SubsetError(ParameterError):
    """Names code that cannot be translated, with its file and line."""


class Term(NamedTuple):
    """An expression in C."""

    code: str
    kind: Kind
    binds: int = ATOM
    has_address: bool = False
    pointer: bool = False  # whether ``code`` is the address of the value

    def inside(self, binds: int) -> str:
        """The value as an operand of an operator that binds like ``binds``."""
        code = f"*{self.code}" if self.pointer else self.code
        own = UNARY if self.pointer else self.binds
        return f"({code})" if own > binds else code

    @property
    def value(self) -> str:
        """The value as an argument."""
        return self.inside(CHOICE)

    def field(self, name: str) -> str:
        """A field of the value."""
        return f"{self.code}->{name}" if self.pointer else f"{self.inside(ATOM)}.{name}"


class Function(NamedTuple):
    """A translated function."""

    name: str
    arguments: tuple[Kind, ...]
    returns: Kind


def shown_path(path: str) -> str:
    """``path`` from the current folder, if it is in it."""
    whole, here = Path(path).resolve(), Path.cwd()
    return str(whole.relative_to(here)) if whole.is_relative_to(here) else str(whole)


def article(kind: Kind) -> str:
    if kind.what == "record":
        return f"a {kind.record.__name__}"
    return {
        "integer": "an integer",
        "array": "an array",
        "optional": "a value or None",
        "nothing": "None",
    }.get(kind.what, f"a {kind.what}")


def named(node: ast.AST) -> str:
    """What ``node`` is, in words."""
    return f"{type(node).__name__} ({ast.unparse(node).splitlines()[0]})"
