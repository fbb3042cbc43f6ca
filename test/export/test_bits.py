# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The exported C of each law equals its Python to the last bit, with every compiler that is there."""

import numpy as np
import pytest
from changed import controller
from driven import COMPILERS, SANITIZERS, build, case, finite_share, in_c, in_python, random_params, same_bits

from valve_control.control.laws.registry import LAWS

pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler")
FEW = case(400, 100)


@pytest.mark.parametrize("name", LAWS)
def test_the_c_equals_the_plain_python_and_has_no_undefined_behaviour(tmp_path, name):
    law = LAWS[name]
    random = np.random.default_rng(7)
    sets = [random_params(law, random) for _ in range(12)]
    voltages, ends = in_python(law, sets, FEW, compiled=False)
    saturated = [np.any(np.abs(row) == p.u_max) for row, p in zip(voltages, sets, strict=True)]
    assert finite_share(voltages) > 0.99 and np.mean(saturated) > 0.25
    programs = [build(law, tmp_path, compiler) for compiler in COMPILERS]
    programs.append(build(law, tmp_path, COMPILERS[0], *SANITIZERS))
    for program in programs:
        found, found_ends = in_c(law, program, sets, FEW)
        assert same_bits(found, voltages) and same_bits(found_ends, ends), program


def test_dcarc_with_a_coil_in_its_model_has_the_same_bits(tmp_path):
    """Third order without zeros, and the sixth order with three."""
    law = LAWS["dcarc"]
    models = (
        ([48361.0], [0.0015, 1.46, 380.4, 48361.0]),
        ([250.0, 185000.0, 70000000.0, 9.6e9], [0.002, 2.44, 1380.0, 399780.0, 38998000.0, 2.099e9, 2.25e10]),
    )
    sets = [
        law.build(controller(dcarc__model="custom", dcarc__numerator=up, dcarc__denominator=down, **magnet))
        for up, down in models
        for magnet in (
            {},
            {
                "dcarc.coil": 0.0015,
                "dcarc.hysteresis": 0.1,
                "dcarc.sides": 0.1,
                "dcarc.actuator_delay": 0.0013,
                "dcarc.hum": 50.0,
            },
        )
    ]
    voltages, ends = in_python(law, sets, FEW, compiled=False)
    compiled, compiled_ends = in_python(law, sets, FEW, compiled=True)
    found, found_ends = in_c(law, build(law, tmp_path, COMPILERS[0]), sets, FEW)
    assert finite_share(voltages) == 1.0
    assert same_bits(found, voltages) and same_bits(found_ends, ends)
    assert same_bits(compiled, voltages) and same_bits(compiled_ends, ends)
