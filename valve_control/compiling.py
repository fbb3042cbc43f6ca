"""Compiles the plain step functions with numba, for runs of many samples.

A step refers to helpers of other modules by name; numba wants those compiled too. ``compile_function``
rebuilds a function with every such helper replaced by its compiled twin, so that the laws themselves
stay plain Python without an import of numba.
"""

import contextlib
import dis
import functools
import hashlib
import os
import tempfile
import types
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from valve_control.parameter import ParameterError

PACKAGE = "valve_control"
LANES = 8  # valves side by side in a compiled loop: the doubles of one AVX-512 register
_packages = {PACKAGE: Path(__file__).resolve().parent}
_beside: set[str] = set()  # packages that add no laws


def add_sources(package: str, folder: Path, laws: bool = True) -> None:
    """Let functions of ``package``, in ``folder``, be compiled too; call it before anything is compiled.

    ``laws``: it adds laws to this package, so that its sources decide results of this package's commands.
    """
    _packages[package] = folder.resolve()
    if not laws:
        _beside.add(package)


def _ours(name: str) -> bool:
    return name.split(".")[0] in _packages


@functools.cache
def sources_digest(everything: bool = False) -> str:
    """Hash, sixteen hexadecimal digits, of the sources of this package and of packages that add laws.

    ``everything``: of all packages whose functions are compiled.
    """
    digest = hashlib.sha256()
    for package, root in _packages.items():
        for source in sorted(root.rglob("*.py")) if everything or package not in _beside else ():
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

    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = home / PACKAGE / sources_digest(everything=True)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = Path(tempfile.mkdtemp(prefix=f"{PACKAGE}-"))
    numba.config.CACHE_DIR = str(folder)
    return numba


def compile_function(
    function: Callable[..., Any],
    replace: Mapping[str, Callable[..., Any]] | None = None,
    nogil: bool = False,
) -> Callable[..., Any]:
    """Compiled twin of ``function``; globals named in ``replace`` are taken from there.

    ``nogil``: other Python threads run while it does. What is compiled already is given back.
    """
    if not isinstance(function, types.FunctionType):
        return function
    return _compile(function, tuple(sorted((replace or {}).items(), key=lambda item: item[0])), nogil)


def bind(functions: Mapping[str, Callable[..., Any]], places: Mapping[str, Any]) -> dict[str, Any]:
    """``functions`` of one module, by name, in plain Python, with others in the ``places`` of its globals.

    They call each other; ``places`` are returned with them.
    """
    scope: dict[str, Any] = dict(next(iter(functions.values())).__globals__)
    scope.update(places)
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
    function: Callable[..., Any], replace: tuple[tuple[str, Callable[..., Any]], ...], nogil: bool
) -> Callable[..., Any]:
    numba = _numba()
    scope = dict(function.__globals__)
    scope.update(replace)
    for instruction in dis.get_instructions(function):
        if instruction.opname != "LOAD_GLOBAL":
            continue
        name = instruction.argval
        value = scope.get(name)
        if isinstance(value, types.FunctionType) and _ours(value.__module__):
            scope[name] = compile_function(value)
        elif isinstance(value, types.ModuleType) and _ours(value.__name__):
            scope[name] = _compiled_module(value)
    rebuilt = types.FunctionType(function.__code__, scope, function.__name__)
    rebuilt.__module__ = function.__module__
    rebuilt.__qualname__ = function.__qualname__
    if replace:
        # numba's cache tells functions apart by name and types, not by what their globals are.
        names = ",".join(f"{value.__module__}.{value.__qualname__}" for _, value in replace)
        rebuilt.__qualname__ += f"_{hashlib.sha256(names.encode()).hexdigest()[:12]}"
    make = numba.njit(cache=True, error_model="numpy", forceinline=True, nogil=nogil)
    return make(rebuilt)  # type: ignore[no-any-return]


@functools.cache
def _compiled_module(module: types.ModuleType) -> types.ModuleType:
    twin = types.ModuleType(module.__name__)
    for name, value in vars(module).items():
        own = isinstance(value, types.FunctionType) and value.__module__ == module.__name__
        if own and value.__closure__ is None:  # a context manager has a closure
            setattr(twin, name, compile_function(value))
        else:
            setattr(twin, name, value)
    return twin


@contextlib.contextmanager
def explained(what: str) -> Iterator[None]:
    """Raise ParameterError, naming ``what``, if numba refuses to compile something within the block."""
    try:
        yield
    except Exception as error:
        if not type(error).__module__.startswith("numba."):
            raise
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        reason = next((line for line in lines[1:] if "Failed in" not in line), lines[0] if lines else "")
        raise ParameterError(f"{what} does not compile: {reason}") from error
