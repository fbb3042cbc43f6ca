# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
import json

import pytest

from research.theorems import adaptive, figures, robust, sampling, tables
from research.theorems.__main__ import main

FEW = ("--loop-valves", "4", "--learning-valves", "1", "--processes", "1")


@pytest.fixture
def short(monkeypatch):
    """The experiments on the theorems over in a second."""
    monkeypatch.setattr(
        robust.experiment, "__defaults__", (2000, 1, ("arc",), (1e-3, 5e-4, 2e-4), 0.05, 1, None)
    )
    motions = ("rest", "three sines")
    defaults = (40, 1, ("arc",), motions, (1e-3, 1e-4), 3.0, 1, None)
    monkeypatch.setattr(adaptive.experiment, "__defaults__", defaults)


@pytest.mark.campaign
def test_command_writes_table_json_and_figure(tmp_path, capsys, short):
    target, figure = tmp_path / "a.json", tmp_path / "a.svg"
    arguments = ["--valves", "6", "--adaptive-valves", "2", *FEW]
    assert main([*arguments, "--json", str(target), "--figure", str(figure)]) == 0
    out = capsys.readouterr().out
    assert "ARC, true velocity" in out and "three sines" in out
    result = json.loads(target.read_text())
    assert [c["period"] for c in result["bound"]["cells"]] == [1e-3, 5e-4, 2e-4]
    assert result["bound"]["valves"] == 6 and result["error"]["valves"] == 2
    assert figure.stat().st_size > 10_000


def test_sample_period_table_and_figure(tmp_path):
    limits = sampling.sample_period_limit([1.0, 1.44e6], [2e-4, 1e-3], duration=0.5)
    figures.draw_sample_period([tmp_path / "a.png", tmp_path / "a.svg"], limits)
    assert all((tmp_path / name).stat().st_size > 5_000 for name in ("a.png", "a.svg"))
    data = tables.sampling_data(limits)
    assert [line["z2_weight"] for line in data["lines"]] == [1.0, 1.44e6]
    assert "nan" not in "\n".join(tables.sampling_lines(limits))
