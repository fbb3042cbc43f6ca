import json

import pytest

from valve_control.cli import main
from valve_control.theorems import adaptive, bench, figures, robust, sampling, tables


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--valves", "0"], "--valves must be at least 1"),
        (["--seed", "-1"], "--seed must not be negative"),
        (["--errata-figures", "no/such/folder"], "there is no such folder"),
        (["--json", "no/such/folder/a.json"], "there is no folder"),
    ],
)
def test_bad_arguments_are_refused_in_one_sentence(capsys, arguments, message):
    assert main(["theorems", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_command_writes_table_json_and_figure(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(robust.study, "__defaults__", (2000, 1, ("arc",), (1e-3, 5e-4, 2e-4), 0.05, 1, None))
    motions = ("rest", "three sines")
    short = (40, 1, ("arc",), motions, (1e-3, 1e-4), 3.0, 1, None)
    monkeypatch.setattr(adaptive.study, "__defaults__", short)
    target, figure = tmp_path / "a.json", tmp_path / "a.svg"
    arguments = ["--valves", "6", "--adaptive-valves", "2", "--processes", "1"]
    assert main(["theorems", *arguments, "--json", str(target), "--figure", str(figure)]) == 0
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


def test_work_counts_its_progress():
    seen = []
    assert bench.work(abs, [-1, 2, -3], 1, lambda done, total: seen.append((done, total))) == [1, 2, 3]
    assert seen == [(1, 3), (2, 3), (3, 3)]
