# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Makes the noise of the LVDTs of a batch, with the bits of numpy's generators; imports numba.

numba takes some ten microseconds to take in one of numpy's generators, whenever a compiled function is called
with it, and as long as it does so no other thread runs. Kept in a structure they are taken in once, and begin
anew with the seed of the next valve.
"""

import functools
import threading
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.core import types
from numba.experimental import structref

from valve_control.arrays import Floats
from valve_control.control.compiling import LANES

_of_thread = threading.local()


@structref.register
class GeneratorsType(types.StructRef):  # type: ignore[misc, name-defined]
    """numba's type of Generators."""


class Generators(structref.StructRefProxy):  # type: ignore[misc]
    """Generators of the LANES valves of a block."""

    def __new__(cls, each: tuple[np.random.Generator, ...]) -> "Generators":
        """Take in the generators ``each``."""
        return structref.StructRefProxy.__new__(cls, each)  # type: ignore[no-any-return]


structref.define_proxy(Generators, GeneratorsType, ["each"])


def fill(generators: Any, noise: Floats) -> None:
    """Fill every row of ``noise`` (LANES×n) with standard normal numbers of its own generator."""
    each = generators.each
    for j in range(noise.shape[0]):
        generator = each[j]
        for i in range(noise.shape[1]):
            noise[j, i] = generator.standard_normal()


@functools.lru_cache(maxsize=10_000)  # a search runs the same valves, with the same seeds, again and again
def _beginning(seed: int) -> Any:
    """State of numpy's generator ``default_rng(seed)`` before its first number."""
    return np.random.PCG64(seed).state


def seeded(seeds: npt.NDArray[np.int64]) -> Any:
    """Generators of this thread, each begun anew as ``default_rng(seed)``, to be given to ``fill``."""
    if not hasattr(_of_thread, "made"):
        each = tuple(np.random.default_rng(0) for _ in range(LANES))
        _of_thread.made = each, Generators(each)
    each, taken_in = _of_thread.made
    for generator, seed in zip(each, seeds, strict=True):
        generator.bit_generator.state = _beginning(int(seed))
    return taken_in
