"""Translates pure step functions, and all that they call, from a small subset of Python to C99.

The subset: functions of numbers and NamedTuples; assignments, also of tuples; ``if``; ``return``;
arithmetic, comparisons, ``and``, ``or``, ``not`` and conditional expressions; ``abs``, ``min``, ``max``,
``int``, ``float``, ``len`` of an array; ``for`` over a ``range``; ``in`` a tuple of constants; the functions
of FUNCTIONS from ``math``; ``all(map(math.isfinite, …))``; ``map`` where arguments are taken apart; constants
of modules; ``_replace``. Everything else is named with its file and line.

Each operation stays where it is, in the order of Python, so that a compiler that keeps to IEEE 754 gives
the same bits. Where Python goes its own way, C goes along: ``min`` and ``max`` keep the first of equals and
of what cannot be compared, ``floor`` has no negative zero, ``%`` has the sign of the divisor, ``**`` and
what else the C library computes is not evaluated by the compiler. ``math.hypot``, ``math.fsum`` and others
for which Python does not call the C library are no part of the subset.
"""

import ast
import inspect
import math
import textwrap
import types
import typing
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control.export import kinds
from valve_control.export.kinds import (
    ARRAY,
    BOOLEAN,
    INTEGER,
    NOTHING,
    REAL,
    WORD,
    Kind,
    comment,
    identifier,
    snake,
)
from valve_control.parameter import ParameterError

EXACT = ("sqrt", "copysign", "fabs")  # rounded correctly by every C library: the compiler may evaluate them
LIBRARY = (
    *("exp", "expm1", "log", "log1p", "sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
    *("sinh", "cosh", "tanh"),
)
FUNCTIONS = (*EXACT, *LIBRARY, "floor", "ceil", "isfinite", "isnan", "isinf", "pow")
ARGUMENTS = {"copysign": 2, "atan2": 2, "pow": 2}
WIDTH = 110
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
        """Beginning of the names of what is in ``module``."""
        return self.prefix if module == self._own else f"{self.prefix}_{identifier(module.split('.')[-1])}"

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
                f"    {self.declared(k, identifier(n))};{_behind(texts.get(n, ''))}"
                for n, k in listed.items()
            ]
            about = (inspect.getdoc(record) or "").splitlines()
            said = about[0] if about and not about[0].startswith(f"{record.__name__}(") else record.__name__
            name = self.unique(f"{self.scope(record.__module__)}_{snake(record.__name__)}_t")
        elif kind.what == "array":
            lines = [f"    {self.real} *data;", "    int64_t rows, columns;"]
            said, name = (
                "Numbers with two indices, in memory of the caller.",
                self.unique(f"{self.prefix}_array_t"),
            )
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
            self.constants.append("\n".join(_wrapped(declaration, "")))
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
        """Translate ``function`` for arguments of these kinds, where its annotations say nothing else.

        Raises SubsetError.
        """
        if not isinstance(function, types.FunctionType):
            raise SubsetError(f"{function!r} is no function of Python, so that it cannot be exported")
        try:
            source = inspect.getsource(function)
        except (OSError, TypeError) as error:
            where = function.__code__.co_filename
            raise SubsetError(f"the source of {function.__name__} ({where}) cannot be read") from error
        parsed = ast.parse(textwrap.dedent(source)).body[0]
        body = _Body(self, function, parsed, kinds.comments(textwrap.dedent(source)))
        wanted = body.arguments(arguments)
        key = (function, wanted)
        if key in self._made:
            made = self._made[key]
            if made is None:
                raise body.refused(parsed, f"{function.__name__} calls itself")
            return made
        self._made[key] = None
        module = function.__module__
        middle = "law_" if module == self._own else ""
        made = body.translate(
            self.unique(f"{self.scope(module)}_{middle}{identifier(function.__name__)}"), wanted
        )
        self._made[key] = made
        return made

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
        for name, sign in (("least", "<"), ("most", ">")):
            if name in self.used:
                made.append(
                    f"/* {'min' if name == 'least' else 'max'} of Python: the first unless b {sign} a. */\n"
                    f"static {real} {self.prefix}_{name}({real} a, {real} b)\n"
                    f"{{\n    return b {sign} a ? b : a;\n}}"
                )
        if "modulo" in self.used:
            zero = self.number(0.0)
            made.append(
                f"/* % of Python. */\nstatic {real} {self.prefix}_modulo({real} a, {real} b)\n{{\n"
                f"    {real} rest = fmod{f}(a, b);\n"
                f"    if (rest == {zero})\n        return copysign{f}({zero}, b);\n"
                f"    return (b < {zero}) != (rest < {zero}) ? rest + b : rest;\n}}"
            )
        if "int_modulo" in self.used:
            made.append(
                f"/* % of Python. */\nstatic int64_t {self.prefix}_int_modulo(int64_t a, int64_t b)\n{{\n"
                "    int64_t rest = a % b;\n"
                "    return rest != 0 && (b < 0) != (rest < 0) ? rest + b : rest;\n}"
            )
        if "int_quotient" in self.used:
            made.append(
                f"/* // of Python. */\nstatic int64_t {self.prefix}_int_quotient(int64_t a, int64_t b)\n{{\n"
                "    int64_t quotient = a / b;\n"
                "    return a % b != 0 && (b < 0) != (a < 0) ? quotient - 1 : quotient;\n}"
            )
        return made


def _behind(text: str) -> str:
    return f" /* {comment(text)} */" if text else ""


def _wrapped(code: str, indent: str) -> list[str]:
    """``code`` in lines of at most WIDTH columns."""
    return textwrap.wrap(
        code,
        WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "    ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def shown_path(path: str) -> str:
    """``path`` from the current folder, if it is in it."""
    whole, here = Path(path).resolve(), Path.cwd()
    return str(whole.relative_to(here)) if whole.is_relative_to(here) else str(whole)


class _Body:
    """Translates the body of one function."""

    def __init__(
        self, program: Program, function: types.FunctionType, parsed: ast.stmt, said: dict[int, str]
    ) -> None:
        self._program = program
        self._function = function
        if not isinstance(parsed, ast.FunctionDef):
            raise self.refused(parsed, "only plain functions can be exported")
        self._parsed = parsed
        self._said = said
        self._scope: dict[str, Term] = {}
        self._lines: list[str] = []
        self._indent = "    "
        self._temporaries = 0
        self._declared: dict[str, Kind] = {}
        self._early: dict[int, list[str]] = {}  # variables to be declared before a statement, by its id
        self._returns: Kind | None = None
        self._sought: set[str] = set()  # variables whose kind is being looked for
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

    # The whole

    def arguments(self, given: Sequence[Kind]) -> tuple[Kind, ...]:
        """Kinds of the arguments: those of the annotations, else those ``given``."""
        a = self._parsed.args
        if a.vararg or a.kwarg or a.kwonlyargs or a.posonlyargs:
            raise self.refused(self._parsed, f"{self._parsed.name} has other than plain arguments")
        if self._function.__closure__ or self._parsed.decorator_list:
            raise self.refused(
                self._parsed, f"{self._parsed.name} is decorated, or made inside another function"
            )
        try:
            hints = typing.get_type_hints(self._function)
        except NameError as error:
            raise self.refused(self._parsed, f"the annotations of {self._parsed.name}: {error}") from error
        found = []
        for argument, kind in zip(a.args, given, strict=True):
            said = kinds.of_annotation(hints[argument.arg]) if argument.arg in hints else None
            found.append(said or kind)
        self._returns = kinds.of_annotation(hints["return"]) if "return" in hints else None
        return tuple(found)

    def translate(self, name: str, wanted: tuple[Kind, ...]) -> Function:
        """Write the function ``name`` into the program."""
        program = self._program
        given = []
        for argument, kind in zip(self._parsed.args.args, wanted, strict=True):
            own = self._local(argument.arg)
            if not kind.is_struct:
                given.append(self._type(argument, kind, own))
                self._scope[argument.arg] = Term(own, kind, has_address=True)
            elif argument.arg in self._stored:
                given.append(f"const {self._type(argument, kind, f'*{own}_given')}")
                self._line(f"{program.declared(kind, own)} = *{own}_given;")
                self._scope[argument.arg] = Term(own, kind, has_address=True)
            else:
                given.append(f"const {self._type(argument, kind, f'*{own}')}")
                self._scope[argument.arg] = Term(own, kind, has_address=True, pointer=True)
            self._declared[argument.arg] = kind
        unused = {a.arg for a in self._parsed.args.args}
        unused -= {n.id for n in ast.walk(self._parsed) if isinstance(n, ast.Name)}
        for argument in self._parsed.args.args:
            if argument.arg in unused:
                self._line(f"(void){self._local(argument.arg)};")
        self._place_declarations()
        ended = self._block(self._parsed.body)
        returns = self._returns or NOTHING
        if not ended and returns is not NOTHING:
            raise self.refused(self._parsed, f"{self._parsed.name} can end without a result")
        head = f"static {program.declared(returns, name)}({', '.join(given) or 'void'})"
        file = Path(self._function.__code__.co_filename)
        about = f"/* {file.parent.name}/{file.name}, {self._function.__name__}"
        text = (inspect.getdoc(self._function) or "").splitlines()
        about += f": {comment(text[0])} */" if text else " */"
        lines = [*_wrapped(about, ""), *_wrapped(head, ""), "{", *self._lines, "}"]
        program.functions.append("\n".join(lines))
        return Function(name, wanted, returns)

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
        self._lines += _wrapped(text + _behind(said), self._indent)

    def _temporary(self, term: Term, node: ast.AST) -> Term:
        """``term`` in a variable of its own."""
        self._temporaries += 1
        name = f"made{self._temporaries}"
        while name in self._taken:
            self._temporaries += 1
            name = f"made{self._temporaries}"
        self._line(f"const {self._type(node, term.kind, name)} = {term.value};")
        return Term(name, term.kind, has_address=True)

    # Where variables are declared

    def _place_declarations(self) -> None:
        """Find the variables that are used outside the block in which they are first given a value."""
        paths: dict[str, list[tuple[tuple[int, int], ...]]] = {}
        first: dict[str, tuple[tuple[int, int], ...]] = {}
        statements: dict[tuple[tuple[int, int], ...], ast.stmt] = {}

        def walk(body: list[ast.stmt], block: tuple[tuple[int, int], ...], branch: int) -> None:
            for i, statement in enumerate(body):
                here = (*block, (branch, i))
                statements[here] = statement
                parts: list[ast.AST] = [statement]
                if isinstance(statement, ast.If):
                    parts = [statement.test]
                elif isinstance(statement, ast.For):
                    parts = [statement.iter]
                for part in parts:
                    for node in ast.walk(part):
                        if isinstance(node, ast.Name) and node.id in self._stored:
                            paths.setdefault(node.id, []).append(here)
                            if isinstance(node.ctx, ast.Store):
                                first.setdefault(node.id, here)
                if isinstance(statement, ast.If):
                    walk(statement.body, here, 0)
                    walk(statement.orelse, here, 1)
                elif isinstance(statement, ast.For):
                    walk(statement.body, here, 0)

        walk(self._parsed.body, (), 0)
        for name, places in paths.items():
            if name in self._scope or name not in first:  # an argument, or the variable of a loop
                continue
            own = first[name]
            for place in places:
                depth = len(own) - 1
                inside = (
                    len(place) > depth and place[:depth] == own[:depth] and place[depth][0] == own[depth][0]
                )
                while depth > 0 and not inside:
                    depth -= 1
                    inside = (
                        len(place) > depth
                        and place[:depth] == own[:depth]
                        and place[depth][0] == own[depth][0]
                    )
                own = own[: depth + 1]
            if own != first[name]:
                self._early.setdefault(id(statements[own]), []).append(name)

    # Statements

    def _block(self, body: Sequence[ast.stmt]) -> bool:
        """Translate statements; returns whether they end with a return."""
        for i, statement in enumerate(body):
            if self._statement(statement):
                if i + 1 < len(body):
                    raise self.refused(body[i + 1], "this is never reached")
                return True
        return False

    def _statement(self, node: ast.stmt) -> bool:
        for name in self._early.pop(id(node), []):
            kind = self._kind_of_variable(name)
            self._line(f"{self._type(node, kind, self._local(name))};")
            self._scope[name] = Term(self._local(name), kind, has_address=True)
            self._declared[name] = kind
        said = self._said.get(node.end_lineno or node.lineno, "") if not isinstance(node, ast.If) else ""
        if isinstance(node, ast.Return):
            self._return(node, said)
            return True
        if isinstance(node, ast.If):
            return self._if(node)
        if isinstance(node, ast.For):
            self._for(node)
            return False
        if isinstance(node, ast.Assign):
            if len(node.targets) != 1:
                raise self.refused(node, "a chain of assignments")
            self._assign(node.targets[0], node.value, said)
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            self._annotated(node, said)
        elif isinstance(node, ast.AugAssign):
            left = ast.copy_location(ast.Name(getattr(node.target, "id", ""), ast.Load()), node)
            if not isinstance(node.target, ast.Name):
                raise self.refused(node, "an assignment to something else than a variable")
            value = ast.copy_location(ast.BinOp(left, node.op, node.value), node)
            self._assign(node.target, value, said)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            self._line(f"{self._expression(node.value).code};", said)
        elif isinstance(node, ast.Pass) or (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        ):
            pass
        else:
            raise self.refused(node, _named(node))
        return False

    def _return(self, node: ast.Return, said: str) -> None:
        if node.value is None:
            if self._returns not in (None, NOTHING):
                raise self.refused(node, "a return without a value")
            self._returns = NOTHING
            self._line("return;")
            return
        term = self._expression(node.value, self._returns)
        if self._returns is None:
            self._returns = term.kind
        self._line(f"return {self._as(term, self._returns, node).value};", said)

    def _if(self, node: ast.If, opening: str = "") -> bool:
        """An if with all that follows it; ``opening``: what is before its word, of an if behind an else."""
        self._line(f"{opening}if ({self._truth(node.test).value}) {{", self._said.get(node.lineno, ""))
        ended = self._nested(node.body)
        rest = node.orelse
        if not rest:
            self._line("}")
            return False
        if len(rest) == 1 and isinstance(rest[0], ast.If) and not self._needs_lines(rest[0]):
            return self._if(rest[0], "} else ") and ended
        self._line("} else {")
        ended = self._nested(rest) and ended
        self._line("}")
        return ended

    def _for(self, node: ast.For) -> None:
        """A loop over a range of integers, whose variable nothing else gives a value."""
        call, target = node.iter, node.target
        if not (
            isinstance(call, ast.Call)
            and isinstance(target, ast.Name)
            and self._resolved(call.func) is range
            and len(call.args) in (1, 2)
            and not (call.keywords or node.orelse)
        ):
            raise self.refused(node, "a for loop over anything but a range of integers")
        inside = {id(part) for part in ast.walk(node)}
        for other in ast.walk(self._parsed):
            if not isinstance(other, ast.Name) or other.id != target.id or other is target:
                continue
            if isinstance(other.ctx, ast.Store) or id(other) not in inside:
                raise self.refused(other, f"the loop's variable {target.id} outside of its loop")
        bounds = [self._as(self._number(bound), INTEGER, node) for bound in call.args]
        end = bounds[-1] if bounds[-1].code.isdigit() else self._temporary(bounds[-1], node)
        begin = bounds[0].value if len(bounds) == 2 else "0"
        own = self._local(target.id)
        self._line(f"for (int64_t {own} = {begin}; {own} < {end.value}; {own}++) {{")
        outer = self._scope.get(target.id)
        self._scope[target.id] = Term(own, INTEGER)
        self._declared[target.id] = INTEGER
        self._nested(node.body)
        del self._scope[target.id], self._declared[target.id]
        if outer is not None:
            raise self.refused(node, f"the loop's variable {target.id} outside of its loop")
        self._line("}")

    def _needs_lines(self, node: ast.If) -> bool:
        """Whether something must be computed or declared before the if."""
        lines, temporaries = list(self._lines), self._temporaries
        self._truth(node.test)
        needed = len(self._lines) > len(lines) or id(node) in self._early
        self._lines, self._temporaries = lines, temporaries
        return needed

    def _nested(self, body: Sequence[ast.stmt]) -> bool:
        outer, declared, indent = dict(self._scope), dict(self._declared), self._indent
        self._indent += "    "
        ended = self._block(body)
        self._indent = indent
        self._scope, self._declared = outer, declared
        return ended

    def _annotated(self, node: ast.AnnAssign, said: str) -> None:
        assert node.value is not None
        if not isinstance(node.target, ast.Name):
            raise self.refused(node, "an assignment to something else than a variable")
        hint = eval(ast.unparse(node.annotation), self._function.__globals__)
        kind = kinds.of_annotation(hint)
        if kind is None:
            raise self.refused(node, f"a variable of the type {ast.unparse(node.annotation)}")
        self._declared.setdefault(node.target.id, kind)
        self._store(node.target, self._as(self._expression(node.value, kind), kind, node), said)

    def _assign(self, target: ast.expr, value: ast.expr, said: str) -> None:
        if isinstance(target, ast.Tuple):
            self._unpack(target, value, said)
            return
        wanted = self._declared.get(target.id) if isinstance(target, ast.Name) else REAL
        self._store(target, self._expression(value, wanted), said)

    def _unpack(self, target: ast.Tuple, value: ast.expr, said: str) -> None:
        names = {n.id for n in ast.walk(target) if isinstance(n, ast.Name)}
        if isinstance(value, ast.Tuple):
            if len(value.elts) != len(target.elts):
                raise self.refused(target, "as many names as values")
            used = [n.id for v in value.elts[1:] for n in ast.walk(v) if isinstance(n, ast.Name)]
            terms = [
                self._expression(v, self._declared.get(getattr(t, "id", "")))
                for t, v in zip(target.elts, value.elts, strict=True)
            ]
            if names & set(used):
                terms = [self._temporary(term, value) for term in terms]
        else:
            whole = self._expression(value)
            named = {n.id for n in ast.walk(value) if isinstance(n, ast.Name)}
            if not whole.has_address or names & named:
                whole = self._temporary(whole, value)
            terms = list(self._parts(whole, target))
        if len(terms) != len(target.elts):
            raise self.refused(target, f"{len(target.elts)} names for {len(terms)} values")
        for i, (part, term) in enumerate(zip(target.elts, terms, strict=True)):
            if isinstance(part, ast.Tuple):
                raise self.refused(target, "a tuple in a tuple")
            if not (isinstance(part, ast.Name) and part.id == "_"):
                self._store(part, term, said if i == len(terms) - 1 else "")

    def _parts(self, whole: Term, node: ast.AST) -> Iterator[Term]:
        if whole.kind.what == "record":
            for name, kind in kinds.fields(whole.kind.record).items():
                yield Term(whole.field(identifier(name)), kind, has_address=True)
        elif whole.kind.what == "tuple":
            for i, kind in enumerate(whole.kind.items):
                yield Term(whole.field(f"item{i}"), kind, has_address=True)
        else:
            raise self.refused(node, "what is no tuple is taken apart")

    def _store(self, target: ast.expr, term: Term, said: str) -> None:
        if isinstance(target, ast.Subscript):
            self._line(f"{self._entry(target).code} = {self._as(term, REAL, target).value};", said)
            return
        if not isinstance(target, ast.Name):
            raise self.refused(target, "an assignment to something else than a variable")
        name = target.id
        kind = self._declared.get(name)
        if kind is None:
            kind = self._declared[name] = self._whole_kind(name, term.kind)
        term = self._as(term, kind, target)
        begin = "" if name in self._scope else f"{self._program.type_name(kind)} "
        self._scope[name] = Term(self._local(name), kind, has_address=True)
        self._line(f"{begin}{self._local(name)} = {term.value};", said)

    def _whole_kind(self, name: str, kind: Kind) -> Kind:
        """Kind of a variable that is first given a value of ``kind``."""
        if kind is NOTHING:
            raise self.refused(
                self._parsed, f"{name} is None at first; annotate it, as in {name}: float | None"
            )
        return kind

    def _kind_of_variable(self, name: str) -> Kind:
        """Kind of a variable that must be declared before its first value, from that value."""
        for node in ast.walk(self._parsed):
            if isinstance(node, ast.AnnAssign) and getattr(node.target, "id", "") == name:
                kind = kinds.of_annotation(eval(ast.unparse(node.annotation), self._function.__globals__))
                if kind is not None:
                    return kind
        lines, temporaries = list(self._lines), self._temporaries
        scope, declared = dict(self._scope), dict(self._declared)
        self._sought.add(name)
        try:
            for node in ast.walk(self._parsed):
                if isinstance(node, ast.Assign):
                    kind = self._tried(node, name)
                    if kind is not None:
                        return kind
        finally:
            self._sought.discard(name)
            self._lines, self._temporaries = lines, temporaries
            self._scope, self._declared = scope, declared
        raise self.refused(self._parsed, f"what {name} is cannot be told; annotate it")

    def _tried(self, node: ast.Assign, name: str) -> Kind | None:
        """Kind that the assignment ``node`` gives to ``name``, None if that cannot be told here."""
        target = node.targets[0]
        if name not in {n.id for n in ast.walk(target) if isinstance(n, ast.Name)}:
            return None
        try:
            for used in ast.walk(node.value):
                if isinstance(used, ast.Name) and used.id in self._stored - self._sought - set(self._scope):
                    kind = self._kind_of_variable(used.id)
                    self._scope[used.id] = Term(self._local(used.id), kind, has_address=True)
            if isinstance(target, ast.Name):
                return self._expression(node.value).kind
            if isinstance(target, ast.Tuple):
                listed = [getattr(part, "id", "") for part in target.elts]
                if name in listed and isinstance(node.value, ast.Tuple):
                    return self._expression(node.value.elts[listed.index(name)]).kind
                if name in listed:
                    return list(self._parts(self._expression(node.value), node))[listed.index(name)].kind
        except SubsetError:
            return None
        return None

    # Kinds

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
        raise self.refused(node, f"a value is {_article(term.kind)} here and {_article(kind)} elsewhere")

    def _joined(self, a: Kind, b: Kind, node: ast.AST) -> Kind:
        """Kind that holds values of both."""
        if a == b:
            return a
        if NOTHING in (a, b):
            return kinds.optional(b if a is NOTHING else a)
        if a.is_number and b.is_number:
            return REAL if REAL in (a, b) else INTEGER
        for one, other in ((a, b), (b, a)):
            if one.what == "optional" and one.items[0] == other:
                return one
        raise self.refused(node, f"a value is {_article(a)} in one case and {_article(b)} in the other")

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
        raise self.refused(node, f"{_article(term.kind)} is taken for true or false")

    # Expressions

    def _number(self, node: ast.expr) -> Term:
        """``node`` as a number."""
        term = self._expression(node)
        if term.kind.what == "optional":
            term = self._as(term, term.kind.items[0], node)
        if not term.kind.is_number:
            raise self.refused(node, f"{_article(term.kind)} in arithmetic")
        return self._as(term, INTEGER, node) if term.kind is BOOLEAN else term

    def _real(self, node: ast.expr) -> Term:
        return self._as(self._number(node), REAL, node)

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
        raise self.refused(node, _named(node))

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
                raise self.refused(node, f"a comparison of {_article(a.kind)} with {_article(b.kind)}")
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

    # Calls

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
        self._temporaries += 1
        name = f"changed{self._temporaries}"
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
        for term, kind in zip(terms, made.arguments, strict=True):
            term = self._as(term, kind, node)
            if kind.is_struct:
                if not (term.has_address or term.pointer):
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
            whole = whole if whole.has_address else self._temporary(whole, node)
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


def _article(kind: Kind) -> str:
    if kind.what == "record":
        return f"a {kind.record.__name__}"
    return {
        "integer": "an integer",
        "array": "an array",
        "optional": "a value or None",
        "nothing": "None",
    }.get(kind.what, f"a {kind.what}")


def _named(node: ast.AST) -> str:
    """What ``node`` is, in words."""
    words: dict[type[ast.AST], str] = {
        ast.While: "a while loop",
        ast.With: "a with block",
        ast.Try: "a try block",
        ast.Raise: "a raise",
        ast.Assert: "an assert",
        ast.FunctionDef: "a function inside a function",
        ast.Lambda: "a lambda",
        ast.List: "a list",
        ast.Dict: "a dictionary",
        ast.Set: "a set",
        ast.ListComp: "a list comprehension",
        ast.GeneratorExp: "a generator",
        ast.JoinedStr: "a formatted string",
        ast.Import: "an import",
        ast.ImportFrom: "an import",
        ast.Global: "a global variable",
        ast.NamedExpr: "an assignment inside an expression",
    }
    return words.get(type(node), f"{type(node).__name__} ({ast.unparse(node)})")
