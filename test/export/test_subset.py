# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The translated subset of Python: what is peculiar to Python has the same bits in C, the rest is refused."""

import ctypes
import math
import shutil
import sys
import types
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_control.export import compiler
from valve_control.export.kinds import REAL, Kind
from valve_control.export.subset import Program, SubsetError
from valve_control.export.terms import LIBRARY

HERE = sys.modules[__name__]
NUMBERS = [
    *(0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.0, 7.25, -7.0, 1e-3, 1e300, -1e-300, math.inf, -math.inf, math.nan)
]


class Pair(NamedTuple):
    first: float
    second: float


class Held(NamedTuple):
    last: float | None
    count: int
    fault: str


SHARED = Pair(0.1, -0.2)


def choose(p: Pair, a: float) -> tuple[float, Pair]:
    if a > p.first:
        found = a - p.first
        rest = Pair(second=a, first=found)
    elif 0.0 <= a < 1.0 < p.second:
        found = -p.second * -a
        rest = p._replace(first=found)
    else:
        found, rest = a % 3.0, SHARED
    a, found = found, a
    found += rest.second if not (a and p.second > 0.0 or p.first == a) else -rest.first
    return found, Pair(*rest)


def peculiar(a: float, b: float) -> float:
    x, y = choose(Pair(a, b), min(a, b, 2.0))
    return max(x, y.first, -abs(b)) - math.floor(a) * (1.0 if a <= b else -1.0)


HIGH = ("high", "highest")


def looped(a: float, b: float) -> float:
    total, last = a, 0.0
    for i in range(1, 4):
        last = b / (i + 1.0)
        total = 0.5 * total + last
        for k in range(i):
            total += k * last
    return total - last


def named(a: float, b: float) -> float:
    level = "highest" if a > b else "low"
    return 1.0 if level in HIGH and all(map(math.isfinite, Pair(a, b))) else -1.0


def mapped(a: float, b: float) -> float:
    pair = Pair(*map(least, Pair(a, b), SHARED))
    return pair.first - pair.second


def least(a: float, b: float) -> float:
    return min(a, b)


def most(a: float, b: float) -> float:
    return max(a, b, 0)


def rest_of(a: float, b: float) -> float:
    return a % b


def whole(a: float, b: float) -> float:
    return math.floor(a) + math.ceil(b) * 0.5


def floored(a: float, b: float) -> float:
    return math.floor(a)


def ceiled(a: float, b: float) -> float:
    return math.ceil(a)


def whole_times_real(a: float, b: float) -> float:
    return math.floor(a) * -1.5


def power(a: float, b: float) -> float:
    return abs(a) ** b + math.copysign(a, b)


def integers(a: float, b: float) -> float:
    i, j = int(a), 1 + int(abs(b))
    k = i // j + (-i) % j
    return k / 7 + (i % j if i > j else -j) + min(i, j, 3) * 0.1 + abs(k)


def held(s: Held, reading: float) -> Held:
    last, count, fault = s
    if last is None or abs(reading - last) > 1.0:
        fault = "jump" if fault == "" else fault
        return s._replace(fault=fault, count=count + 1)
    if fault:
        count = 0
    return Held(reading if reading != last else None, count, "")


def maybe(a: float, b: float) -> float:
    s = held(Held(None if a < 0.0 else 0.5, 3, ""), a)
    last = s.last if b > 0.0 else None
    return -1.0 if last is None else last


def remembers(a: float, b: float) -> float:
    s = held(held(Held(None if a < 0.0 else 0.5, 3, ""), a), b)
    kept = 0.25 if s.last is None else s.last
    return kept + s.count * 10.0 + (100.0 if s.fault == "jump" else 0.0)


def taken(a: float, b: float) -> float:
    changed1 = a + b  # a name that C would take for a changed record
    pair = SHARED._replace(first=changed1)
    return pair.first * pair.second


TRANSLATED = (
    *(peculiar, looped, named, mapped, least, most, rest_of),
    *(floored, ceiled, whole_times_real),
    *(whole, power, integers, remembers, maybe, taken),
)
LIBRARIES = [name for name in LIBRARY if name != "atan2"]


def library_calls():
    """A function of each function of the C library that is offered."""
    calls = [f"def {n}_(a: float, b: float) -> float:\n    return math.{n}(a)\n" for n in LIBRARIES]
    return "import math\n" + "".join(calls)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("subset")
    (folder / "calls_of_math.py").write_text(library_calls())
    module = types.ModuleType("calls_of_math")
    code = compile(library_calls(), folder / "calls_of_math.py", "exec")
    exec(code, vars(module))
    program = Program("test", HERE)
    functions = [*TRANSLATED, *(getattr(module, f"{name}_") for name in LIBRARIES)]
    made = [program.translate(function, [REAL, REAL]) for function in functions]
    words = ", ".join(program.words.values())
    text = ["#include <math.h>", "#include <stdbool.h>", "#include <stdint.h>", f"enum {{{words}}};"]
    text += [*program.types.values(), *program.constants, *program.helpers(), *program.functions]
    text += [
        f"double out{i}(double a, double b) {{ return {one.name}(a, b); }}" for i, one in enumerate(made)
    ]
    (folder / "subset.c").write_text("\n".join(text))
    options = ["-fPIC", "-shared", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror"]
    compiler.build([folder / "subset.c"], folder / "subset.so", options)
    library = ctypes.CDLL(str(folder / "subset.so"))
    found = {}
    for i, function in enumerate(functions):
        one = getattr(library, f"out{i}")
        one.argtypes, one.restype = [ctypes.c_double] * 2, ctypes.c_double
        found[function.__name__] = (function, one)
    return found


def bits(x):
    return "nan" if math.isnan(x) else float(x).hex()


def agree(compiled, name, a, b):
    function, in_c = compiled[name]
    try:
        wanted = bits(function(a, b))
    except (ArithmeticError, ValueError):
        return  # an error of Python is a number that is not finite in C, or none that anybody would want
    assert bits(in_c(a, b)) == wanted, (name, a, b)


@pytest.mark.parametrize("name", [f.__name__ for f in TRANSLATED])
def test_peculiar_numbers_have_the_same_bits(compiled, name):
    for a in NUMBERS:
        for b in NUMBERS:
            if name != "integers" or abs(a) + abs(b) < 1e15:
                agree(compiled, name, a, b)


@settings(max_examples=300)
@given(st.floats(-1e6, 1e6), st.floats(-1e3, 1e3))
def test_any_numbers_have_the_same_bits(compiled, a, b):
    for function in TRANSLATED:
        agree(compiled, function.__name__, a, b)


def test_functions_of_math_are_those_of_the_library_that_python_calls(compiled):
    random = np.random.default_rng(3)
    for name in LIBRARIES:
        for a in [*(10.0 ** random.uniform(-8, 2, 500)), *random.uniform(-1.0, 1.0, 500)]:
            agree(compiled, f"{name}_", float(a), 0.0)


REFUSED = {
    "for k in (1, 2):\n        a = a + 1.0": "a for loop over anything but a range of integers",
    "for k in range(3):\n        k = 2": "the loop's variable k is used elsewhere",
    "a = 1.0 if a in [b] else b": "in of anything but a tuple of constants",
    "while a > 0.0:\n        a -= 1.0": "While (while a > 0.0:)",
    "a = math.hypot(a, b)": "a call of math.hypot",
    "a = sum([a, b])": "a call of sum",
    "a = (lambda x: x)(a)": "a call of lambda x: x",
    "a = a // b": "// of numbers that are not integers",
    "a = a or b": "and or or between what is not true or false",
    "a = a @ b": "the operator in a @ b",
    "a = unknown(a)": "there is no unknown",
    "a = a.real": "a.real, which is no field of a NamedTuple",
    "raise ValueError": "Raise (raise ValueError)",
    "c = 1\n    c = a": "a value is a real here and an integer elsewhere",
    "a = step(a, b)": "step calls itself",
}


class Kept(NamedTuple):
    first: float
    second: float
    pair: Pair


Kept.changes = True  # a memory, which functions change in place


def told(m: Kept, text: str) -> None:
    raise AssertionError("C leaves it out")


told.node_only = True


def added(m: Kept, by: float) -> float:
    m.first += by
    return m.first


INSIDE = "added may change its memory inside another expression"
ORDERS = {
    "told(m, added(m, a))": INSIDE,
    "a = 1.0 + added(m, a)": INSIDE,
    "m.first += added(m, a)": INSIDE,
    "m.first, m.second = added(m, a), m.first": INSIDE,
    "if a > 0.0 and added(m, a) > 0.0:\n        a = 1.0": INSIDE,
    "if a > 0.0:\n        told(m, added(m, a))": INSIDE,
    "m.pair.first = a": "something else than a variable or a memory's slot",
    "m.third = a": "m.third, which is no field",
    "try:\n        a = 1.0\n    except KeyError:\n        a = 2.0": "a try block for other errors",
}


@pytest.mark.parametrize("code", [*REFUSED, *ORDERS], ids=lambda code: code[:20])
def test_what_is_outside_the_subset_is_named_with_file_and_line(tmp_path, code):
    """Among it a change of a memory whose order C leaves open."""
    path, memory = tmp_path / "a_law.py", code in ORDERS
    head = "m: Kept, a: float" if memory else "a: float, b: float"
    path.write_text(f"import math\n\n\ndef step({head}) -> float:\n    {code}\n    return a\n")
    module = types.ModuleType("a_law")
    vars(module).update(Kept=Kept, added=added, told=told)
    exec(compile(path.read_text(), path, "exec"), vars(module))
    with pytest.raises(SubsetError) as error:
        Program("test", module).translate(module.step, [Kind("record", Kept) if memory else REAL, REAL])
    assert {**REFUSED, **ORDERS}[code] in str(error.value) and "a_law.py:" in str(error.value)
    assert int(str(error.value).split("a_law.py:")[1].split(":")[0]) in (4, 5, 6)
