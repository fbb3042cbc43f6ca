"""Compile the undecorated step functions with numba, for runs of many samples.

A step refers to helpers of other modules by name; numba wants those compiled too. ``compile_function``
rebuilds a function with every such helper replaced by its compiled twin, so that the laws themselves
stay plain Python without an import of numba.
"""

import dis
import functools
import hashlib
import os
import tempfile
import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

PACKAGE = "valve_control"


@functools.cache
def sources_digest() -> str:
    """Sixteen hexadecimal digits that change with any of the package's sources."""
    digest = hashlib.sha256()
    root = Path(__file__).resolve().parent
    for source in sorted(root.rglob("*.py")):
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
    folder = home / PACKAGE / sources_digest()
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

    ``nogil``: other Python threads run while it does.
    """
    return _compile(function, tuple(sorted((replace or {}).items(), key=lambda item: item[0])), nogil)


@functools.cache
def _compile(
    function: Callable[..., Any], replace: tuple[tuple[str, Callable[..., Any]], ...], nogil: bool
) -> Callable[..., Any]:
    numba = _numba()
    assert isinstance(function, types.FunctionType)
    scope = dict(function.__globals__)
    scope.update(replace)
    for instruction in dis.get_instructions(function):
        if instruction.opname != "LOAD_GLOBAL":
            continue
        name = instruction.argval
        value = scope.get(name)
        if isinstance(value, types.FunctionType) and value.__module__.startswith(PACKAGE):
            scope[name] = compile_function(value)
        elif isinstance(value, types.ModuleType) and value.__name__.startswith(PACKAGE):
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
        if isinstance(value, types.FunctionType) and value.__module__ == module.__name__:
            setattr(twin, name, compile_function(value))
        else:
            setattr(twin, name, value)
    return twin
