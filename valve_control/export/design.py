# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""All numbers of a law's Params as one block, which a machine takes over without being compiled again.

Many parameters of the table go into several numbers, by way of a Riccati equation or a discretised filter.
They are designed here, and the block carries the numbers. It has two words that tell what it is for (the
layout, the form), and one over all bits, so that the C refuses a block of another law and a damaged one.
"""

import struct
from typing import Any

from valve_control import __version__
from valve_control.control.laws.registry import LAWS
from valve_control.export.samples import digest
from valve_control.export.unit import Unit, leaves

START, PRIME, MASK = 0xCBF29CE484222325, 0x100000001B3, 0xFFFFFFFFFFFFFFFF  # of FNV-1a


def _hashed(text: str) -> int:
    value = START
    for byte in text.encode():
        value = ((value ^ byte) * PRIME) & MASK
    return value


def _fixed(record: Any) -> list[str]:
    """What in a nested NamedTuple is no number with a point, and cannot be set."""
    found = []
    for name, value in zip(record._fields, record, strict=True):
        if hasattr(value, "_fields"):
            found += [f"{name}.{text}" for text in _fixed(value)]
        elif not isinstance(value, float):
            found.append(f"{name}={value!r}")
    return found


def layout(unit: Unit, single: bool) -> int:
    """Word that is the same where a block fits: law, numbers, sample period, number type and version."""
    paths = [path for path, _ in leaves(unit.params)]
    kind = "float" if single else "double"
    parts = [__version__, unit.name, unit.text, kind, unit.period.hex(), *paths, *_fixed(unit.params)]
    return _hashed("\n".join(parts))


def form(unit: Unit) -> int:
    """Word that is the same where the state of the law means the same."""
    return _hashed("\n".join(f"{name}={unit.values[name]!r}" for name in LAWS[unit.name].form))


def block(unit: Unit, single: bool) -> bytes:
    """The block as it is in memory: layout, form, numbers and the word over them, little-endian."""
    numbers = [number for _, number in leaves(unit.params)]
    head = struct.pack("<2Q", layout(unit, single), form(unit))
    body = head + struct.pack(f"<{len(numbers)}d", *numbers)
    over = digest(struct.unpack(f"<{len(body) // 8}d", body))
    return body + struct.pack("<Q", over)


def files(unit: Unit, single: bool) -> dict[str, str | bytes]:
    """The block as a file for the machine, as a C constant, and as a table to read."""
    name, data = unit.name, block(unit, single)
    numbers = dict(leaves(unit.params))
    over = struct.unpack("<Q", data[-8:])[0]
    lines = "".join(f"        {number.hex()}, /* {path}: {number!r} */\n" for path, number in numbers.items())
    header = (
        f"/* Numbers of {name} for {name}_set_design; made by valve_control {__version__}. */\n"
        f'#include "{name}.h"\n\n'
        f"static const {name}_design_t {name}_design = {{\n"
        f"    0x{layout(unit, single):016x}u,\n    0x{form(unit):016x}u,\n    {{\n{lines}    }},\n"
        f"    0x{over:016x}u,\n}};\n"
    )
    table = "number,value\n" + "".join(f"{path},{number!r}\n" for path, number in numbers.items())
    return {f"{name}_design.bin": data, f"{name}_design.h": header, f"{name}_design.csv": table}
