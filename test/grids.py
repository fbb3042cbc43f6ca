# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Grids of test cases: `make test` runs a covering array of them, the campaign the others."""

import itertools

import pytest


def covering(axes, strength):
    """Combinations that hold each combination of values of any ``strength`` axes (greedy method)."""
    every = list(itertools.product(*(range(len(axis)) for axis in axes)))
    held = {one: set(itertools.combinations(enumerate(one), strength)) for one in every}
    missing, chosen = set().union(*held.values()), []
    while missing:
        chosen.append(max(every, key=lambda one: len(held[one] & missing)))
        missing -= held[chosen[-1]]
    return chosen


def grid(names, *axes, strength=2):
    """parametrize ``names`` by all combinations of ``axes``.

    `make test` runs a covering array: of ``strength`` 2 it finds each failure that two values together cause,
    of 1 each that one value causes. The campaign runs the others.
    """
    axes = [list(axis) for axis in axes]
    few = covering(axes, strength)
    cases = []
    for one in itertools.product(*(range(len(axis)) for axis in axes)):
        values = [axis[i] for axis, i in zip(axes, one, strict=True)]
        cases.append(pytest.param(*values, marks=[] if one in few else pytest.mark.campaign))
    return pytest.mark.parametrize(names, cases)
