# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Emits C: names, types, numbers, constants and helper functions, each before it is used."""

import inspect
import math
import textwrap
import types
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from valve_control.export import kinds
from valve_control.export.kinds import Kind, comment, identifier, snake
from valve_control.export.terms import ARGUMENTS, LIBRARY, Function
from valve_control.parameter import ParameterError

WIDTH = 110
IN_C = {"binding": "watch", "lvdt_trust": "lvdt_watch", "saturation": "amplifier", "memory": "m"}  # public
_HELPERS = {
    "least": """/* min of Python: the first unless b < a. */
static {real} {prefix}_least({real} a, {real} b)
{{
    return b < a ? b : a;
}}""",
    "most": """/* max of Python: the first unless b > a. */
static {real} {prefix}_most({real} a, {real} b)
{{
    return b > a ? b : a;
}}""",
    "modulo": """/* % of Python. */
static {real} {prefix}_modulo({real} a, {real} b)
{{
    {real} rest = fmod{f}(a, b);
    if (rest == {zero})
        return copysign{f}({zero}, b);
    return (b < {zero}) != (rest < {zero}) ? rest + b : rest;
}}""",
    "int_modulo": """/* % of Python. */
static int64_t {prefix}_int_modulo(int64_t a, int64_t b)
{{
    int64_t rest = a % b;
    return rest != 0 && (b < 0) != (rest < 0) ? rest + b : rest;
}}""",
    "int_quotient": """/* // of Python. */
static int64_t {prefix}_int_quotient(int64_t a, int64_t b)
{{
    int64_t quotient = a / b;
    return a % b != 0 && (b < 0) != (a < 0) ? quotient - 1 : quotient;
}}""",
}


class Program:
    """The C that a few functions need: types, constants and functions, each before it is used."""

    def __init__(self, prefix: str, own: types.ModuleType, single: bool = False) -> None:
        """``prefix``: of all names; ``own``: module whose names have nothing between it and their own.

        ``single``: float in place of double.
        """
        self.prefix = prefix
        self.real = "float" if single else "double"
        self.single = single
        self.types: dict[str, str] = {}  # definitions by name, in their order
        self.constants: list[str] = []
        self.prototypes: list[str] = []
        self.functions: list[str] = []
        self.used: set[str] = set()  # functions of math
        self.words: dict[str, str] = {}
        self._own = own.__name__
        self._named: dict[Any, str] = {}
        self._made: dict[Any, Function | None] = {}
        self._names: set[str] = set()

    # Names and types

    def unique(self, name: str) -> str:
        """``name``, or with a number if it is taken."""
        found, count = name, 1
        while found in self._names:
            count += 1
            found = f"{name}{count}"
        self._names.add(found)
        return found

    def scope(self, module: str) -> str:
        """Beginning of the names of what is in ``module``: the word of its file, or of IN_C in its place."""
        file = module.split(".")[-1]
        return self.prefix if module == self._own else f"{self.prefix}_{identifier(IN_C.get(file, file))}"

    def type_name(self, kind: Kind) -> str:
        """C type of ``kind``, defined if need be. Raises TypeError for a field that C cannot have."""
        simple = {
            "real": self.real,
            "integer": "int64_t",
            "boolean": "bool",
            "word": "int",
            "nothing": "void",
        }
        if kind.what in simple:
            return simple[kind.what]
        if kind in self._named:
            return self._named[kind]
        if kind.what == "record":
            record = kind.record
            listed, texts = kinds.fields(record), kinds.field_texts(record)
            lines = [
                f"    {self.declared(k, identifier(n))};{behind(texts.get(n, ''))}" for n, k in listed.items()
            ]
            about = (inspect.getdoc(record) or "").splitlines()
            said = about[0] if about and not about[0].startswith(f"{record.__name__}(") else record.__name__
            name = self.unique(f"{self.scope(record.__module__)}_{snake(record.__name__)}_t")
        elif kind.what == "array":
            lines = [f"    {self.real} *data;", "    int64_t rows, columns;"]
            said = "Numbers with two indices, in memory of the caller."
            name = self.unique(f"{self.prefix}_array_t")
        elif kind.what == "optional":
            lines = ["    bool given;", f"    {self.declared(kind.items[0], 'value')};"]
            said = "A value, or none."
            name = self.unique(f"{self.prefix}_optional_{self._short(kind.items[0])}_t")
        else:
            lines = [f"    {self.declared(item, f'item{i}')};" for i, item in enumerate(kind.items)]
            said = "Results of a function."
            name = self.unique(f"{self.prefix}_{'_'.join(self._short(item) for item in kind.items)}_t")
        self._named[kind] = name
        self.types[name] = "\n".join([f"/* {comment(said)} */", "typedef struct {", *lines, f"}} {name};"])
        return name

    def _short(self, kind: Kind) -> str:
        name = self.type_name(kind)
        return name.removeprefix(f"{self.prefix}_").removesuffix("_t")

    def declared(self, kind: Kind, name: str) -> str:
        """Declaration of a variable."""
        return f"{self.type_name(kind)} {name}"

    # Numbers

    def number(self, value: float, exact: bool = False) -> str:
        """A constant; ``exact``: hexadecimal, with its decimal. Raises ParameterError for infinity."""
        rounded = np.float32(value) if self.single else value
        suffix = "f" if self.single else ""
        if not math.isfinite(rounded):
            raise ParameterError(f"a constant is {value:g}, which is no finite {self.real} in C")
        if exact:
            return f"{float(rounded).hex()}{suffix} /* {rounded!s} */"
        return f"{rounded!s}{suffix}"

    def constant(self, value: Any, kind: Kind, exact: bool = False) -> str:
        """Initialiser of a constant of ``kind``."""
        if kind.what == "optional":
            if value is None:
                return f"{{false, {self._zero(kind.items[0])}}}"
            return f"{{true, {self.constant(value, kind.items[0], exact)}}}"
        if kind.what == "record":
            listed = kinds.fields(kind.record)
            return (
                "{" + ", ".join(self.constant(getattr(value, n), k, exact) for n, k in listed.items()) + "}"
            )
        if kind.what == "boolean":
            return "true" if value else "false"
        if kind.what == "integer":
            return str(int(value))
        if kind.what == "word":
            return self.word(value)
        return self.number(float(value), exact)

    def _zero(self, kind: Kind) -> str:
        if kind.what == "optional":
            return f"{{false, {self._zero(kind.items[0])}}}"
        if kind.is_struct:
            return "{" + ", ".join(self._zero(k) for k in kinds.fields(kind.record).values()) + "}"
        return {"real": self.number(0.0), "boolean": "false"}.get(kind.what, "0")

    def word(self, text: str) -> str:
        """A string as a constant of an enumeration; the empty one is 0."""
        if text and not self.words:
            self.word("")
        if text not in self.words:
            self.words[text] = self.unique(f"{self.prefix}_{identifier(text or 'none')}".upper())
        return self.words[text]

    def shared(self, value: Any, kind: Kind, name: str, module: str) -> str:
        """Name of a constant with several numbers."""
        key = (name, module, repr(value))
        if key not in self._named:
            found = self.unique(f"{self.scope(module)}_{identifier(name)}")
            self._named[key] = found
            declaration = f"static const {self.declared(kind, found)} = {self.constant(value, kind)};"
            self.constants.append("\n".join(wrapped(declaration, "")))
        return self._named[key]

    # Functions

    def helper(self, name: str) -> str:
        """Name of a function of math in the C that is made."""
        self.used.add(name)
        if name in LIBRARY or name in ("pow", "least", "most", "modulo", "int_modulo", "int_quotient"):
            return f"{self.prefix}_{name}"
        return {"isfinite": "isfinite", "isnan": "isnan", "isinf": "isinf"}.get(
            name, f"{name}f" if self.single else name
        )

    def translate(self, function: Callable[..., Any], arguments: Sequence[Kind]) -> Function:
        """Place of the translator."""
        raise NotImplementedError

    def helpers(self) -> list[str]:
        """Definitions of the functions that C lacks, or that its compiler must not evaluate."""
        real, f = self.real, "f" if self.single else ""
        made = []
        for name in sorted(self.used & {*LIBRARY, "pow"}):
            arguments = ["x", "y"][: ARGUMENTS.get(name, 1)]
            given = ", ".join(f"{real} {a}" for a in arguments)
            copies = " ".join(f"volatile {real} {a}_now = {a};" for a in arguments)
            called = ", ".join(f"{a}_now" for a in arguments)
            made.append(
                f"/* {name} of the C library, never that of the compiler. */\n"
                f"static {real} {self.prefix}_{name}({given})\n"
                f"{{\n    {copies}\n    return {name}{f}({called});\n}}"
            )
        names = {"real": real, "f": f, "prefix": self.prefix, "zero": self.number(0.0)}
        made += [text.format(**names) for name, text in _HELPERS.items() if name in self.used]
        return made


def behind(text: str) -> str:
    return f" /* {comment(text)} */" if text else ""


def wrapped(code: str, indent: str) -> list[str]:
    """``code`` in lines of at most WIDTH columns."""
    return textwrap.wrap(
        code,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "    ",
        break_long_words=False,
        break_on_hyphens=False,
    )
