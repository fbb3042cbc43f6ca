# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""CMA-ES (pycma) on the unit cube, as the searches for gains and for valves use it."""

import warnings
from typing import Any

import cma
import numpy as np
import numpy.typing as npt


def strategy(start: npt.NDArray[np.float64], step: float, seed: int, population: int) -> Any:
    """A CMAEvolutionStrategy, quiet, that begins at ``start`` with the standard deviation ``step``.

    It stops when the costs of its generations agree to 1e-4. ``seed`` is that of numpy's global generator,
    which pycma draws from: the same calls in the same order give the same points.
    """
    options = {
        "seed": seed,
        "popsize": population,
        "verbose": -9,
        "tolfun": 1e-4,
        "tolfunhist": 1e-4,
        "tolflatfitness": 20,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return cma.CMAEvolutionStrategy(start, step, options)
