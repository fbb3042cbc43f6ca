# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Blocks of designed numbers: a running law is retuned by them as by a new export, and by nothing else."""

import ctypes
import math
import shutil
import struct

import changed
import numpy as np
import pytest
from c_library import Library
from driven import random_value

from valve_control.control.laws.registry import LAWS
from valve_control.control.linear.linear_loop import flatten
from valve_control.control.parameters.table import CONTROLLER
from valve_control.export import design, samples, settable, unit
from valve_control.parameter import ParameterError, defaults

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


def law(name, **changes):
    return unit.law(changed.controller(controller=name, **changes))


class Machine:
    """The C of an export, with its parameters."""

    def __init__(self, chosen):
        self.function = getattr(Library(chosen).functions, f"{chosen.name}_set_design")
        self.function.restype = ctypes.c_bool
        numbers = flatten(chosen.params)
        self.params = (ctypes.c_double * len(numbers))(*numbers)

    def take(self, block):
        return self.function(self.params, ctypes.create_string_buffer(bytes(block), len(block)))


def random_design(name, random):
    """A unit of the law ``name`` with random parameters."""
    while True:
        changes = {p.name: random_value(p, random) for p in LAWS[name].parameters}
        try:
            return unit.law({**defaults(CONTROLLER), "controller": name, **changes})
        except ParameterError:
            continue


@pytest.mark.parametrize("name", LAWS)
def test_a_block_makes_the_parameters_of_a_new_export(name):
    machine = Machine(law(name))
    random = np.random.default_rng(3)
    for _ in range(5):
        wanted = random_design(name, random)
        assert machine.take(design.block(wanted, False))
        assert list(machine.params) == flatten(wanted.params)


def test_damaged_and_foreign_blocks_are_refused_and_change_nothing():
    chosen = law("oarc")
    machine = Machine(chosen)
    before = list(machine.params)
    block = design.block(law("oarc", oarc__ks1=90.0), False)
    for at in range(len(block)):
        damaged = bytearray(block)
        damaged[at] ^= 1 << (at % 8)
        assert not machine.take(damaged) and list(machine.params) == before, at
    period = design.block(law("oarc", sample_period=0.002), False)
    other = design.block(law("pid"), False).ljust(len(block), b"\0")
    single = design.block(chosen, True)
    for foreign in (period, other, single, bytes(len(block))):
        assert not machine.take(foreign) and list(machine.params) == before
    assert machine.take(block)


def test_numbers_out_of_the_ranges_of_the_table_are_refused():
    """A block with a sound word over it, as somebody would make it by hand."""
    chosen = law("oarc")
    machine = Machine(chosen)
    before = list(machine.params)
    block = design.block(chosen, False)
    places = [path for path, _ in unit.leaves(chosen.params)]
    for setter in settable.find(chosen).setters:
        for wrong in (math.nextafter(setter.parameter.high, math.inf), math.nan, math.inf):
            words = list(struct.unpack(f"<{len(block) // 8}d", block))[:-1]
            words[2 + places.index(setter.path)] = wrong
            made = struct.pack(f"<{len(words)}d", *words)
            made += struct.pack("<Q", samples.digest(struct.unpack(f"<{len(words)}d", made)))
            assert not machine.take(made) and list(machine.params) == before, setter.path


def test_the_form_tells_whether_the_state_goes_on():
    assert design.form(law("pid")) == design.form(law("pid", pid__kp=3.0))
    assert design.form(law("pid", pid__form="plain")) != design.form(law("pid", pid__form="reference"))


def test_the_contract(run, tmp_path):
    words = ["export", "--controller", "dcarc", "--set", "dcarc.input_noise=3.0"]
    status, out, err = run(*words, "--parameters-only", "--output", "new")
    assert (status, err) == (0, "")
    assert out == "wrote new/ with dcarc_design.bin, dcarc_design.h, dcarc_design.csv\n"
    wanted = law("dcarc", dcarc__input_noise=3.0)
    machine = Machine(law("dcarc"))
    assert list(machine.params) != flatten(wanted.params)
    assert machine.take((tmp_path / "new" / "dcarc_design.bin").read_bytes())
    assert list(machine.params) == flatten(wanted.params)
    assert len((tmp_path / "new" / "dcarc_design.csv").read_text().splitlines()) == 1 + len(machine.params)
    status, _, err = run("export", "--plant", "valve", "--parameters-only", "--output", "other")
    assert status == 2 and "--parameters-only is for the C of a law" in err
