# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Which command counts for which reading in lockstep, by numbers alone."""

from collections import deque

import pytest

from valve_control.nodes.lockstep import Pairing


class Upper:
    """A command source: command n is n volts."""

    def __init__(self):
        self.waiting = deque()
        self.used = []
        self.pairing = Pairing(lambda: self.waiting.popleft() if self.waiting else None, self.used.append)

    def send(self, *numbers):
        self.waiting.extend((float(n), {"publication_sequence_number": n}) for n in numbers)

    def answer(self, reading):
        """The commands handed on for ``reading``, None if it has to wait."""
        self.used.clear()
        return list(self.used) if self.pairing.complete(reading) else None


def test_command_k_is_for_reading_k_whenever_it_comes():
    upper = Upper()
    upper.send(1)
    assert upper.answer(1) == [1.0]
    assert upper.answer(2) is None
    upper.send(2, 3)
    assert upper.answer(2) == [2.0]
    assert upper.answer(3) == [3.0]


def test_lost_readings_pass_over_their_commands_in_order():
    upper = Upper()
    upper.send(1, 2, 3, 4, 5)
    assert upper.answer(1) == [1.0]
    assert upper.answer(4) == [2.0, 3.0, 4.0]
    assert upper.answer(5) == [5.0]


@pytest.mark.parametrize("first, reading", [(1, 900), (37, 1)])
def test_a_source_or_a_simulator_that_began_anew_is_in_step_from_its_next_message_on(first, reading):
    upper = Upper()
    upper.send(*range(1, 41))
    for k in range(1, 41):
        assert upper.answer(k) == [float(k)]
    first += 40 if first > 1 else 0
    upper.send(first, first + 1)
    assert upper.answer(reading) == [first]
    assert upper.answer(reading + 1) == [first + 1]
    assert upper.answer(reading + 2) is None
