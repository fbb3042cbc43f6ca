# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Kinds of values in the subset of Python that is translated, and the C types that stand for them."""

import ast
import inspect
import io
import re
import textwrap
import tokenize
import types
import typing
from typing import Any, NamedTuple

import numpy as np

KEYWORDS = frozenset((
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum",
    "extern", "float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return",
    "short", "signed", "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void",
    "volatile", "while", "bool", "true", "false", "asm", "main",
))  # fmt: skip


class Kind(NamedTuple):
    """What a value is: real, integer, boolean, word, nothing, array, record, tuple or optional."""

    what: str
    record: Any = None  # the NamedTuple class of a record
    items: tuple[Any, ...] = ()  # kinds in a tuple, or the one that is optional

    @property
    def is_struct(self) -> bool:
        """Whether C passes it by address."""
        return self.what in ("record", "tuple", "optional", "array")

    @property
    def is_memory(self) -> bool:
        """Whether functions change it in place: a record that is marked with ``changes``."""
        return bool(getattr(self.record, "changes", False))

    @property
    def is_number(self) -> bool:
        """Whether one can calculate with it."""
        return self.what in ("real", "integer", "boolean")


REAL = Kind("real")
INTEGER = Kind("integer")
BOOLEAN = Kind("boolean")
WORD = Kind("word")
NOTHING = Kind("nothing")
ARRAY = Kind("array")  # of doubles with two indices, overwritten in place
SCALARS = {float: REAL, int: INTEGER, bool: BOOLEAN, str: WORD, type(None): NOTHING}


def optional(kind: Kind) -> Kind:
    """Kind of a value that may be None."""
    return Kind("optional", items=(kind,))


def of_annotation(hint: Any) -> Kind | None:
    """Kind of what is annotated with ``hint``; None if that says nothing."""
    if hint in SCALARS:
        return SCALARS[hint]
    if hasattr(hint, "_fields"):
        return Kind("record", hint)
    origin = typing.get_origin(hint)
    if origin is tuple:
        items = tuple(of_annotation(item) for item in typing.get_args(hint))
        return Kind("tuple", items=items) if None not in items else None
    if origin in (types.UnionType, typing.Union):
        others = [item for item in typing.get_args(hint) if item is not type(None)]
        inner = of_annotation(others[0]) if len(others) == 1 else None
        return optional(inner) if inner is not None else None
    if origin is np.ndarray or hint is np.ndarray:
        return ARRAY
    return None


def fields(record: Any) -> dict[str, Kind]:
    """Kinds of a record's fields by name. Raises TypeError for one that C cannot have."""
    found = {}
    for name, hint in typing.get_type_hints(record).items():
        kind = of_annotation(hint)
        if kind is None or kind.what in ("tuple", "nothing"):
            raise TypeError(f"{record.__module__}.{record.__name__}.{name} is a {hint}")
        found[name] = kind
    return found


def of_value(value: Any) -> Kind | None:
    """Kind of a constant."""
    if hasattr(value, "_fields"):
        return Kind("record", type(value))
    return SCALARS.get(type(value))


def comments(lines: str) -> dict[int, str]:
    """What is behind # in each line of a source, by number from 1."""
    tokens = tokenize.generate_tokens(io.StringIO(lines).readline)
    return {t.start[0]: t.string.lstrip("# ").strip() for t in tokens if t.type == tokenize.COMMENT}


def field_texts(record: Any) -> dict[str, str]:
    """Unit and meaning of a record's fields: the comments beside them."""
    try:
        source = textwrap.dedent(inspect.getsource(getattr(record, "template", record)))
    except (OSError, TypeError):
        return {}
    said = comments(source)
    found = {}
    body = ast.parse(source).body[0]
    assert isinstance(body, ast.ClassDef)
    for node in body.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            texts = [said[k] for k in range(node.lineno, (node.end_lineno or node.lineno) + 1) if k in said]
            found[node.target.id] = re.sub(r"\s+", " ", " ".join(texts)).strip()
    return found


def comment(text: str) -> str:
    """``text`` as it may stand in a comment of C."""
    return text.replace("\\", "/").replace("*/", "* /").replace("/*", "/ *")


def identifier(name: str) -> str:
    """``name`` as an identifier of C."""
    plain = re.sub(r"[^A-Za-z0-9_]", lambda found: f"u{ord(found[0]):04x}", name)
    return f"{plain}_" if plain in KEYWORDS else plain


def snake(name: str) -> str:
    """Class name in lower case."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
