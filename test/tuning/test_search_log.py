# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A search that was stopped goes on where it was: the same bits, and nothing simulated twice."""

import numpy as np
import pytest

from valve_control.design.tuning.search_log import FILE, SearchLog, digest
from valve_control.parameter import ParameterError

RESULTS = [np.full((2, 4, 1, 3), 0.1), np.array([np.nan]), np.zeros((0, 4, 1, 3))]


def results(log, count, simulated):
    return [log.result(lambda i=i: simulated.append(i) or RESULTS[i]) for i in range(count)]


def test_what_is_in_the_log_is_not_simulated_again(tmp_path):
    folder, simulated = tmp_path / "log", []
    first = SearchLog(folder, "request")
    results(first, 2, simulated)
    first.write()
    second = SearchLog(folder, "request")
    assert second.length == 2 and second.replays
    for got, wanted in zip(results(second, 3, simulated), RESULTS, strict=True):
        assert np.array_equal(got, wanted, equal_nan=True) and got.dtype == np.float64
    assert simulated == [0, 1, 2] and not second.replays
    second.delete()
    assert not folder.exists()


def test_a_folder_that_cannot_be_written_does_not_end_the_search(tmp_path, capsys):
    (tmp_path / "file").touch()
    log = SearchLog(tmp_path / "file" / "under", "request")
    log._written = -1e9
    assert len(results(log, 2, [])) == 2
    assert "note: a stopped search will be lost" in capsys.readouterr().err
    log.delete()


def test_another_request_and_damage_are_one_sentence(tmp_path):
    log = SearchLog(tmp_path, "request")
    results(log, 1, [])
    log.write()
    with pytest.raises(ParameterError, match="other parameters or of another version"):
        SearchLog(tmp_path, "another")
    whole = (tmp_path / FILE).read_bytes()
    (tmp_path / FILE).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ParameterError, match="stopped_search.npz is damaged; delete it"):
        SearchLog(tmp_path, "request")


def test_a_digest_is_that_of_every_bit():
    whole = np.zeros(5000)
    other = whole.copy()
    other[2500] = 1e-300
    assert digest({"a": [whole]}) == digest({"a": [whole.copy()]}) != digest({"a": [other]})
    values = [0.0, -0.0, 0, False, "0", None, [], [0.0], {"a": 0.0}, np.zeros((2, 3)), np.zeros((3, 2))]
    assert len({digest(value) for value in values}) == len(values)
