# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A driver on topics applies a voltage when it comes: the dead time of the way is not the valve's."""

from types import SimpleNamespace

import numpy as np
import pytest

from valve_control.control.analysis import timing
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.commissioning import valve_fit
from valve_control.design.commissioning.bench import Record
from valve_control.design.commissioning.evaluation import Friction, Rest
from valve_control.design.identification import dead_time
from valve_control.nodes.commissioning_client import _paired

PERIOD, FINE = 0.001, 40  # s, steps of the true valve in a period
MODEL = TransferFunction((40000.0,), (1.0, 240.0, 40000.0))
TRUE = valve_fit.Plant(MODEL, Friction(0.0, 1.0), 0.0, 0.0004, 1.0)
REST = Rest(0.0, 0.001, 0.0)


def over_topics(stands_still=False):
    """Readings and voltages with their stamps; a voltage comes 0.3 to 0.9 ms after its reading."""
    random = np.random.default_rng(3)
    n = 6000
    taken = PERIOD * np.arange(n)
    if stands_still:  # the valve goes on while its driver sends nothing
        taken[2000:] += 0.025
        taken[4000:] += 0.025
    wanted = np.sin(2.0 * np.pi * (3.0 + 3.0 * taken) * taken)
    sent = taken + random.uniform(0.0, 0.00005, n)
    sent[5000] += 0.003  # which the next ones make good
    arrival = np.maximum.accumulate(sent + random.uniform(0.0003, 0.0009, n))
    fine = np.arange(round(taken[-1] / PERIOD * FINE) + 1) * PERIOD / FINE
    applied = np.concatenate([[0.0], wanted])[np.searchsorted(arrival, fine, side="right")]
    exact = Record(PERIOD / FINE, np.zeros(len(fine)), applied, applied)
    position = valve_fit.simulated(TRUE, exact)[np.round(taken / PERIOD * FINE).astype(int)]
    position += REST.noise * random.standard_normal(n)

    def samples(times, values):
        return [(k, round(1e9 * t), float(v)) for k, (t, v) in enumerate(zip(times, values, strict=True))]

    return samples(sent, position), samples(arrival, wanted)


def fitted(record):
    begin = SimpleNamespace(order=2, model=MODEL, delay=0.001)
    return valve_fit.fitted([record], [begin], Friction(0.0, 1.0), 0.0, REST)


@pytest.mark.parametrize("stands_still", [False, True])
def test_the_dead_time_is_that_of_the_valve(stands_still):
    """0.4 ms; with the voltages as they were meant it was 0.6 ms more, and a pause spoiled the rest."""
    readings, voltages = over_topics(stands_still)
    commands = [(stamp, value) for _, stamp, value in voltages]
    found, meant = (fitted(_paired(readings, voltages, commands, PERIOD, waits)) for waits in (False, True))
    assert found.delay == pytest.approx(TRUE.delay, abs=2e-4)
    assert found.error < 1.2
    assert meant.delay > found.delay + 0.00045
    assert found.error < meant.error


def test_late_readings_are_left_out_and_the_way_is_told():
    readings, voltages = over_topics(stands_still=True)
    record = _paired(readings, voltages, [(0, 0.0)], PERIOD, False)
    assert len(record.reading) == 6000 + 50
    lost = set(np.flatnonzero(np.isnan(record.reading)).tolist())
    assert lost == {*range(2000, 2025), *range(4025, 4050), 5050}
    late = np.flatnonzero(_paired(readings, voltages, [(s, v) for _, s, v in voltages], PERIOD, False).late)
    assert set(late.tolist()) == {*range(2002, 2025), *range(4027, 4050), 5052}
    (note,) = dead_time.way_notes(timing.spread(record.latency))
    assert "voltages were sent 0.59 ms after their readings (median; 99 %: 0.89 ms)" in note
    assert dead_time.way_notes(timing.spread(np.empty(0))) == []


def test_late_readings_at_both_ends_leave_no_stretch_without_a_length():
    sent = 0.001 * np.arange(400)
    sent[[0, 1, -2, -1]] += [0.0009, 0.0008, 0.003, 0.004]
    readings = [(k, round(1e9 * t), 0.0) for k, t in enumerate(sent)]
    record = _paired(readings, readings, [(0, 0.0)], PERIOD, False)
    assert np.all(np.isfinite(record.voltage))
