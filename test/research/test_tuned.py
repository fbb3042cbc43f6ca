# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The comparison of tuned laws as a user runs it, and the former commands of research."""

import json

import pytest

from research.tuned import main


@pytest.fixture
def tuned(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        try:
            status = main(list(arguments))
        except SystemExit as ended:
            status = ended.code
        return status, *capsys.readouterr()

    return call


def test_tuned_laws_beside_the_oracle(tuned, tmp_path):
    status, out, err = tuned("--valves", "2", "--json", "t.json", "--figure", "t.png")
    assert status == 0, err
    assert "medians over 2 valves of the narrow box" in out and "wrote t.png" in out
    result = json.loads((tmp_path / "t.json").read_text())
    assert result["valves"] == 2 and result["laws"]["pid_plain"]["preview_s"] > 0.0
    for mode in ("with preview", "command alone"):
        assert {"pid_plain", "pid_reference", "oarc", "dcarc", "oracle"} == result[mode].keys()
        for told in result[mode].values():
            assert len(told["median"]) == 5 and told["c_u"] > 0.0
    assert (tmp_path / "t.png").read_bytes()[:4] == b"\x89PNG"
