"""Standard normal numbers with the bits of numpy's ``default_rng(seed).standard_normal``, for compiled loops.

numpy's generator, PCG64 (O'Neill 2014: 128-bit LCG, output XSL-RR), and its ziggurat (Marsaglia and Tsang
2000) in numba: inlined they take less than half of the time, and a thread that fills its own noise waits for
no other. Imports numba.

The compiled loop has numpy's bits only as long as numpy keeps its streams (NEP 19 lets Generator change);
test_batch compares the two.
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from valve_control.simulation.ziggurat import DENSITY, INSIDE, INVERSE_TAIL, TAIL, WIDTH

Words = npt.NDArray[np.uint64]
Halves = npt.NDArray[np.uint32]
MULTIPLIER = 0x2360ED051FC65DA44385DF649FCCF645
BELOW, WHOLE = 2**64 - 1, 2**128 - 1


def _hashed(value: Halves, constant: int, factor: int) -> tuple[Halves, int]:
    following = constant * factor & 0xFFFFFFFF
    value = (value ^ np.uint32(constant)) * np.uint32(following)
    return value ^ (value >> np.uint32(16)), following


def states_of(seeds: npt.NDArray[np.int64]) -> Words:
    """Words (N×4), low before high, of state and increment of numpy's PCG64 for each of ``seeds``.

    numpy's SeedSequence (O'Neill 2015) for all seeds at once: a tenth of the time of making the generators.
    """
    given = np.asarray(seeds).astype(np.uint64)
    zero = np.zeros(len(given), dtype=np.uint32)
    entropy = [given.astype(np.uint32), (given >> np.uint64(32)).astype(np.uint32), zero, zero]
    constant = 0x43B0D7E5
    pool: list[Halves] = []
    for part in entropy:
        value, constant = _hashed(part, constant, 0x931E8875)
        pool.append(value)
    for i in range(4):
        for j in range(4):
            if i != j:
                value, constant = _hashed(pool[i], constant, 0x931E8875)
                value = np.uint32(0xCA01F9DD) * pool[j] - np.uint32(0x4973F715) * value
                pool[j] = value ^ (value >> np.uint32(16))
    constant = 0x8B51F9DD
    made = []
    for i in range(8):
        value, constant = _hashed(pool[i % 4], constant, 0x58F38DED)
        made.append(value.astype(np.uint64))
    wide = [(made[2 * i] | (made[2 * i + 1] << np.uint64(32))).tolist() for i in range(4)]
    words = np.empty((len(given), 4), dtype=np.uint64)
    for k, (high, low, sequence_high, sequence_low) in enumerate(zip(*wide, strict=True)):
        increment = ((sequence_high << 64 | sequence_low) << 1 | 1) & WHOLE
        state = ((increment + (high << 64 | low)) * MULTIPLIER + increment) & WHOLE
        words[k] = (state & BELOW, state >> 64, increment & BELOW, increment >> 64)
    return words


@intrinsic  # type: ignore[untyped-decorator]
def next_word(typing: Any, words: Any) -> Any:
    """The next 64 random bits of the generator whose state is in ``words``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        wide, narrow = ir.IntType(128), ir.IntType(64)
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        address = builder.bitcast(data, wide.as_pointer())
        increment = builder.load(builder.gep(address, [ir.Constant(narrow, 1)]), align=8)
        state = builder.load(address, align=8)
        state = builder.add(builder.mul(state, ir.Constant(wide, MULTIPLIER)), increment)
        builder.store(state, address, align=8)
        high = builder.trunc(builder.lshr(state, ir.Constant(wide, 64)), narrow)
        folded = builder.xor(high, builder.trunc(state, narrow))
        turn = builder.lshr(high, ir.Constant(narrow, 58))
        back = builder.and_(builder.neg(turn), ir.Constant(narrow, 63))
        return builder.or_(builder.lshr(folded, turn), builder.shl(folded, back))

    return types.uint64(words), generate


def unit(words: Words) -> float:
    """Uniform in [0, 1), of 53 bits."""
    return (next_word(words) >> np.uint64(11)) * (1.0 / 9007199254740992.0)  # type: ignore[no-any-return]


def normal(words: Words) -> float:
    """The next standard normal number."""
    while True:
        r = next_word(words)
        i = r & np.uint64(0xFF)
        size = (r >> np.uint64(9)) & np.uint64(0x000FFFFFFFFFFFFF)
        x = float(size * WIDTH[i])
        if (r >> np.uint64(8)) & np.uint64(1):
            x = -x
        if size < INSIDE[i]:
            return x
        if i == 0:
            while True:
                beyond = -INVERSE_TAIL * math.log1p(-unit(words))
                height = -math.log1p(-unit(words))
                if height + height > beyond * beyond:
                    far = float(TAIL + beyond)
                    return -far if (size >> np.uint64(8)) & np.uint64(1) else far
        elif (DENSITY[i - 1] - DENSITY[i]) * unit(words) + DENSITY[i] < math.exp(-0.5 * x * x):
            return x


def fill(words: Words, numbers: npt.NDArray[np.float64]) -> None:
    """Fill every row of ``numbers`` (LANES×n) from the generator in the row of ``words`` (LANES×4)."""
    for j in range(numbers.shape[0]):
        own = words[j]
        for i in range(numbers.shape[1]):
            numbers[j, i] = normal(own)
