# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Terms of ~/state that are published on topics of their own are named before anything starts."""

import pytest

from valve_control.control.laws.registry import LAWS
from valve_control.control.supervision.record import HEAD, named_terms
from valve_control.parameter import ParameterError


def test_every_term_of_every_law_can_be_named_and_counts_once():
    for law in LAWS.values():
        names = (*HEAD, *law.term_labels)
        assert named_terms(names + names) == tuple(dict.fromkeys(names))


@pytest.mark.parametrize(
    ("name", "words"),
    [("voltgae", "did you mean 'voltage'"), ("xyzzy", "they are ")],
)
def test_a_term_that_no_law_has_is_refused_with_the_nearest_names_or_all(name, words):
    with pytest.raises(ParameterError) as error:
        named_terms(["voltage", name])
    assert f"state_topics has '{name}'" in str(error.value) and words in str(error.value)
