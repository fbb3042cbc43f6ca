# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A search that was stopped goes on where it was: the same bits, and nothing simulated twice."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valve_control.design.tuning.kept import OUTCOMES, REQUEST, Kept, digest
from valve_control.parameter import ParameterError

REQUESTED = {"laws": ["pid"], "budget": 60}
MADE = [np.full((2, 4, 1, 3), 0.1), np.array(np.nan).reshape(1, 1, 1, 1), np.zeros((0, 4, 1, 3))]


def asked(kept, count, made):
    return [kept.outcomes(f"key {i}", lambda i=i: made.append(i) or MADE[i]) for i in range(count)]


def test_what_was_kept_is_not_made_again(tmp_path):
    first, done = Kept(tmp_path, REQUESTED, 1), []
    asked(first, 2, done)
    first.write()
    second = Kept(tmp_path, REQUESTED, 1)
    assert second.found == 2 and second.known
    found = asked(second, 3, done)
    assert done == [0, 1, 2] and not second.known
    for got, made in zip(found, MADE, strict=True):
        assert np.array_equal(got, made, equal_nan=True) and got.dtype == np.float64
    second.forget()
    assert not tmp_path.exists()


def test_a_search_that_wrote_nothing_deletes_nothing(tmp_path):
    (tmp_path / OUTCOMES).write_bytes(b"mine")
    kept = Kept(tmp_path, REQUESTED, 1)
    asked(kept, 2, [])
    kept.forget()
    assert (tmp_path / OUTCOMES).read_bytes() == b"mine"


def test_a_folder_that_cannot_be_written_does_not_end_the_search(tmp_path, capsys):
    (tmp_path / "file").touch()
    kept = Kept(tmp_path / "file" / "under", REQUESTED, 1)
    kept._written = -1e9
    assert len(asked(kept, 2, [])) == 2
    assert "note: the search is not kept any more" in capsys.readouterr().err
    with pytest.raises(OSError, match="file"):  # what is said when it is stopped
        kept.write()
    kept.forget()


def test_what_is_of_another_set_of_gains_is_made_anew(tmp_path):
    first, done = Kept(tmp_path, REQUESTED, 1), []
    asked(first, 3, done)
    first.write()
    second = Kept(tmp_path, REQUESTED, 1)
    second.outcomes("key 0", pytest.fail)
    assert second.outcomes("another", lambda: MADE[2]) is MADE[2]
    assert not second.known and second.outcomes("key 2", lambda: MADE[0]) is MADE[0]


def test_another_request_and_damage_are_one_sentence(tmp_path):
    kept = Kept(tmp_path, REQUESTED, 1)
    asked(kept, 1, [])
    kept.write()
    with pytest.raises(ParameterError, match="holds a search that was stopped, with other parameters"):
        Kept(tmp_path, {**REQUESTED, "budget": 61}, 1)
    whole = (tmp_path / OUTCOMES).read_bytes()
    (tmp_path / OUTCOMES).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ParameterError, match="stopped_search.npz is damaged; delete it"):
        Kept(tmp_path, REQUESTED, 1)
    (tmp_path / REQUEST).write_text("{")
    with pytest.raises(ParameterError, match="stopped_search.json is damaged; delete it"):
        Kept(tmp_path, REQUESTED, 1)


NUMBERS = st.floats(allow_nan=False) | st.integers() | st.booleans() | st.text() | st.none()
THINGS = st.recursive(NUMBERS, lambda t: st.lists(t) | st.dictionaries(st.text(), t), max_leaves=8)


@given(THINGS, THINGS)
def test_digests_differ_where_things_do(one, other):
    """The texts of Python tell 0.0 from -0.0, and 1 from 1.0 and True."""
    assert (digest(one) == digest(other)) == (repr_of(one) == repr_of(other))


def repr_of(thing):
    if isinstance(thing, dict):
        return "{" + ", ".join(f"{k!r}: {repr_of(thing[k])}" for k in sorted(thing)) + "}"
    return "[" + ", ".join(map(repr_of, thing)) + "]" if isinstance(thing, list) else repr(thing)


def test_a_digest_is_that_of_every_number_in_an_array():
    whole = np.zeros(5000)
    other = whole.copy()
    other[2500] = 1e-300
    assert digest(whole) == digest(whole.copy()) != digest(other)
    assert digest(np.zeros((2, 3))) != digest(np.zeros((3, 2)))
