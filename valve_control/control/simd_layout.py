# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Stores nested NamedTuples of floats in arrays, valve beside valve, so that a loop over valves becomes SIMD.

A block holds ``LANES`` valves: number f of lane j stands at f·LANES + j. Imports numba; the compiled loop of
``batch`` takes these in place of its stand-ins.
"""

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from valve_control.control.compiling import LANES


def _address(context: Any, builder: Any, array_type: Any, array: Any, lane: Any, number: int) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    offset = ir.Constant(lane.type, number * LANES)
    return builder.gep(data, [builder.add(lane, offset)], inbounds=True)


def _load(context: Any, builder: Any, kind: Any, array_type: Any, array: Any, lane: Any, at: int) -> Any:
    """Value of type ``kind`` from number ``at`` on, and the number after it."""
    if isinstance(kind, types.Float):
        return builder.load(_address(context, builder, array_type, array, lane, at)), at + 1
    parts = []
    for entry in kind:
        part, at = _load(context, builder, entry, array_type, array, lane, at)
        parts.append(part)
    return context.make_tuple(builder, kind, parts), at


def _store(
    context: Any, builder: Any, kind: Any, value: Any, array_type: Any, array: Any, lane: Any, at: int
) -> int:
    """Number after those of ``value``."""
    if isinstance(kind, types.Float):
        builder.store(value, _address(context, builder, array_type, array, lane, at))
        return at + 1
    for entry, part in zip(kind, cgutils.unpack_tuple(builder, value), strict=True):
        at = _store(context, builder, entry, part, array_type, array, lane, at)
    return at


@intrinsic  # type: ignore[untyped-decorator]
def load(typing: Any, like: Any, array: Any, lane: Any) -> Any:
    """Record of one ``lane``, of the type of ``like``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _, block, j = arguments
        return _load(context, builder, signature.args[0], signature.args[1], block, j, 0)[0]

    return like(like, array, types.intp), generate


@intrinsic  # type: ignore[untyped-decorator]
def store(typing: Any, value: Any, array: Any, lane: Any) -> Any:
    """Write ``value``, a record, into one ``lane``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind, array_type, _ = signature.args
        part, block, j = arguments
        _store(context, builder, kind, part, array_type, block, j, 0)
        return context.get_dummy_value()

    return types.void(value, array, types.intp), generate
