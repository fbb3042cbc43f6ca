# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compiles the plain step functions with numba, for runs of many samples.

A step refers to helpers of other modules by name; numba wants those compiled too. ``compile_function``
rebuilds a function with every such helper replaced by its compiled twin, so that the laws themselves
stay plain Python without an import of numba.
"""

import contextlib
import dis
import functools
import hashlib
import importlib.util
import os
import re
import tempfile
import traceback
import types
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from valve_control.parameter import ParameterError

PACKAGE = "valve_control"
LANES = 8  # valves side by side in a compiled loop: the doubles of one AVX-512 register
_packages = {PACKAGE: Path(__file__).resolve().parents[1]}


class CompileError(ParameterError):
    """Says which law cannot be compiled, whatever its parameters are, and why."""


class LawError(RuntimeError):
    """Says that a law has raised an error or left the finite numbers in a run, where and when."""


def add_sources(module: types.ModuleType) -> None:
    """Let functions of the package of ``module`` be compiled too, or of the file of one without a package."""
    source = getattr(module, "__file__", None)
    if source is not None:
        path, package = Path(source).resolve(), module.__package__
        _packages[module.__name__.split(".")[0]] = path.parents[package.count(".")] if package else path
        # The folder of numba's cache is named after the sources; what has begun with another stays there.
        for known in (sources_digest, _numba, _compile, _compiled_module):
            known.cache_clear()


def _ours(name: str) -> bool:
    return name.split(".")[0] in _packages


@functools.cache
def sources_digest() -> str:
    """Hash, sixteen hexadecimal digits, of the sources of all packages whose functions are compiled."""
    digest = hashlib.sha256()
    for root in _packages.values():
        for source in sorted(root.rglob("*.py")) if root.is_dir() else [root]:
            digest.update(str(source.relative_to(root)).encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


@functools.cache
def _numba() -> Any:
    """numba, with a cache folder that changes with the package's sources.

    numba does not notice an edit in another file than that of the function: without this, a cached loop
    could silently run an old law.
    """
    import numba
    from numba.core import boxing, pythonapi

    folder = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"), PACKAGE, sources_digest())
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix=f"{PACKAGE}-"))
    numba.config.CACHE_DIR = str(folder)
    # The refusal that follows it says what is wrong.
    warnings.filterwarnings("ignore", category=numba.core.errors.NumbaTypeSafetyWarning)
    for kind in (numba.types.NamedTuple, numba.types.NamedUniTuple, numba.types.Array):
        pythonapi._boxers.functions[kind] = functools.partial(_from_constants, boxing)
    return numba


def _from_constants(boxing: Any, kind: Any, value: Any, c: Any) -> Any:
    """Make a record or array without a step in Python, where Ctrl-C would be raised, and crash numba."""
    table, api = c.env_manager, c.pyapi
    if not hasattr(kind, "instance_class"):  # an array
        api.serialize_object, api.unserialize = table.add_const, table.read_const
        made = boxing.box_array(kind, value, c)
        del api.serialize_object, api.unserialize
        return made
    new, record = (table.read_const(table.add_const(one)) for one in (tuple.__new__, kind.instance_class))
    values = boxing.box_tuple(kind, value, c)
    made = api.call_function_objargs(new, (record, values))
    api.decref(values)
    return made


def compile_function(
    function: Callable[..., Any],
    replace: Mapping[str, Callable[..., Any]] | None = None,
    nogil: bool = False,
) -> Callable[..., Any]:
    """Compiled twin of ``function``; globals named in ``replace`` are taken from there.

    ``nogil``: other Python threads run while it does. What is compiled already is given back. Without numba
    it is the plain function, whose results have the same bits.
    """
    if not isinstance(function, types.FunctionType):
        return function
    if importlib.util.find_spec("numba") is None:
        return types.FunctionType(
            function.__code__, {**function.__globals__, **(replace or {})}, function.__name__
        )
    return _compile(function, tuple(sorted((replace or {}).items(), key=lambda item: item[0])), nogil, False)


def bind(functions: Mapping[str, Callable[..., Any]], places: Mapping[str, Any]) -> dict[str, Any]:
    """``functions`` of one module, by name, in plain Python, with others in the ``places`` of its globals.

    They call each other; ``places`` are returned with them.
    """
    scope: dict[str, Any] = {**next(iter(functions.values())).__globals__, **places}
    made: dict[str, Any] = dict(places)
    for name, function in functions.items():
        # The interpreter adapts code to the scope in which it runs: each scope has its own.
        code = function.__code__.replace()
        made[name] = types.FunctionType(code, scope, function.__name__, function.__defaults__)
        made[name].__dict__.update(function.__dict__)
        made[name].__annotations__ = dict(function.__annotations__)
    scope.update(made)
    return made


@functools.cache
def _compile(
    function: Callable[..., Any], replace: tuple[tuple[str, Callable[..., Any]], ...], nogil: bool, part: bool
) -> Callable[..., Any]:
    """Compiled twin; ``part``: for calls from compiled functions only, in half of the time.

    A part lacks the wrapper that unpacks records of Python. Python must not call it.
    """
    numba = _numba()
    if function.__closure__ is not None:
        raise TypeError(f"{function.__qualname__} is a function within a function")
    scope = dict(function.__globals__)
    scope.update((name, _part(value)) for name, value in replace)
    for instruction in dis.get_instructions(function):
        if instruction.opname != "LOAD_GLOBAL":
            continue
        name = instruction.argval
        value = scope.get(name)
        if isinstance(value, types.FunctionType) and _ours(value.__module__):
            scope[name] = _compile(value, (), False, True)
        elif isinstance(value, types.ModuleType) and _ours(value.__name__):
            scope[name] = _compiled_module(value)
    rebuilt = types.FunctionType(function.__code__, scope, function.__name__)
    rebuilt.__module__ = function.__module__
    rebuilt.__qualname__ = function.__qualname__
    if replace:
        # numba's cache tells functions apart by name and types, not by what their globals are.
        names = ",".join(f"{value.__module__}.{value.__qualname__}" for _, value in replace)
        rebuilt.__qualname__ += f"_{hashlib.sha256(names.encode()).hexdigest()[:12]}"
    if part:
        rebuilt.__qualname__ += "_part"
    wrappers = {"no_cpython_wrapper": part, "no_cfunc_wrapper": part}
    make = numba.njit(cache=True, error_model="numpy", forceinline=True, nogil=nogil, **wrappers)
    compiled = make(rebuilt)
    cache = getattr(compiled, "_cache", None)  # None: numba is told to compile nothing
    if cache is not None:
        save = cache.save_overload

        def save_if_there_is_room(*entry: Any) -> None:
            with contextlib.suppress(OSError):  # on a full disk a recorder still ends its bag
                save(*entry)

        cache.save_overload = save_if_there_is_room
    compiled.made_from = function, replace
    return compiled  # type: ignore[no-any-return]


def _part(value: Any) -> Any:
    """The part that corresponds to ``value``, if this module has compiled it; otherwise ``value``."""
    made_from = getattr(value, "made_from", None)
    return value if made_from is None else _compile(*made_from, False, True)


@functools.cache
def _compiled_module(module: types.ModuleType) -> types.ModuleType:
    twin = types.ModuleType(module.__name__)
    for name, value in vars(module).items():
        own = isinstance(value, types.FunctionType) and value.__module__ == module.__name__
        if own and value.__closure__ is None:  # a context manager has a closure
            setattr(twin, name, _compile(value, (), False, True))
        else:
            setattr(twin, name, value)
    return twin


@contextlib.contextmanager
def explained(what: str) -> Iterator[None]:
    """Raise CompileError, naming ``what``, if something within the block cannot be compiled.

    Raise LawError if it is compiled and raises an error.
    """
    try:
        yield
    except (ParameterError, OSError, MemoryError):
        raise
    except Exception as error:
        if not _while_compiling(error):
            raise LawError(f"{what} raised {in_words(error)}") from error
        raise CompileError(f"{what} does not compile: {_reason(error)}") from error


def in_words(error: Exception) -> str:
    """The kind of ``error``, its text and the line that raised it."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<frozen ")]
    known = isinstance(error, SyntaxError) or frames[-1].name == "try_out"  # which calls the parts of a law
    place = "" if known else f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})"
    return ": ".join(filter(None, [type(error).__name__, str(error)])) + place


def _while_compiling(error: Exception) -> bool:
    """Whether numba or ``_compile`` raised ``error``, of whatever type, and not what was compiled."""
    frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__))
    return type(error).__module__.startswith("numba.") or any(
        (frame.f_globals is globals() and frame.f_code.co_name == _compile.__name__)
        or str(frame.f_globals.get("__name__", "")).startswith("numba.")
        for frame in frames
    )


def _reason(error: Exception) -> str:
    """The cause out of numba's explanation of many lines, with the line of the source if it names one."""
    if isinstance(error, RecursionError):
        return "one of its functions calls itself"
    text = str(error)
    lines = [line.strip(" >") for line in text.splitlines() if line.strip(" >")]
    at = next((i for i, line in enumerate(lines) if i and "Failed in" not in line), 0)
    reason = (
        " ".join(lines[at : at + 2]) if lines and lines[at].endswith(":") else "".join(lines[at : at + 1])
    )
    places = [
        (name, line)
        for name, line in re.findall(r'File "(.+?)", line (\d+)', text)
        if not {PACKAGE, "numba"} & set(Path(name).parts)
    ]
    if places and places[0][0] not in reason:
        reason += f" ({Path(places[0][0]).name}, line {places[0][1]})"
    return reason or type(error).__name__
