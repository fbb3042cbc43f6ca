# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Studies: numbered valves that can be run again, and folders that outlive a stop."""

import json

import numpy as np
import pytest

from valve_control.cli import main
from valve_control.control.parameters import build
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import measures, offline, robustness
from valve_control.parameter import ParameterError, defaults, updated


def small(valves=20, seed=1, controller="oarc", lead=0.0):
    settings = {node: defaults(table) for node, table in NODES.items()}
    changes = {"controller": controller, "reshaping.lead": lead}
    settings["controller"] = updated(NODES["controller"], settings["controller"], changes)
    source = updated(NODES["command_source"], settings["command_source"], {"duration": 0.5, "start": 0.0})
    return robustness.Study({**settings, "command_source": source}, valves, seed)


@pytest.mark.parametrize(("lead", "fixed"), [(0.0, ()), (0.005, ("gain", "lvdt.delay"))])
def test_every_valve_can_be_run_again_alone(lead, fixed):
    chosen = small(lead=lead)
    values = {**chosen.settings["valve_simulator"], "lvdt.delay": 0.0007, "friction.presliding": 0.02}
    box = [q for q in robustness.BOX if q.name not in fixed]
    chosen = chosen._replace(box=box, settings={**chosen.settings, "valve_simulator": values})
    found, part = robustness.run_chunk(chosen, 0, 20), robustness.run_chunk(chosen, 12, 8)
    assert len(np.unique(found.period)) == 3 and np.array_equal(found.points[12:], part.points)
    assert np.array_equal(np.array(found.results)[:, 12:], np.array(part.results), equal_nan=True)
    for number in (0, 7, 19):
        settings = robustness.settings_of_number(chosen, number)
        assert (settings["valve_simulator"]["lvdt.delay"] == 0.0007) == bool(fixed)
        command = build.commands(settings["command_source"])
        run = offline.simulate(settings["controller"], settings["valve_simulator"], command)
        assert found.results.e_M[number] == run.indices.e_M
        assert found.results.e_rms[number] == pytest.approx(run.indices.e_rms, rel=1e-12)


def test_stopped_study_goes_on_and_is_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(robustness, "CHUNK", 8)

    def stop(valves):
        if valves >= 16:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        robustness.run(small(), tmp_path / "a", stop)
    assert len(list((tmp_path / "a").glob("valves_*.npz"))) == 2
    again = robustness.run(small(), tmp_path / "a", lambda valves: None)
    anew = robustness.run(small(), tmp_path / "b", lambda valves: None)
    for a, b in zip(again.results, anew.results, strict=True):
        assert len(a) == 20 and np.array_equal(a, b, equal_nan=True)
    with pytest.raises(ParameterError, match="other parameters"):
        robustness.run(small(seed=2), tmp_path / "a", lambda valves: None)
    part = tmp_path / "b" / "valves_00000000.npz"
    part.write_bytes(part.read_bytes()[:300])
    done = []
    mended = robustness.run(small(), tmp_path / "b", done.append)
    assert done == [12, 20] and np.array_equal(mended.points, anew.points)
    monkeypatch.setattr(robustness, "sources_digest", lambda: "0" * 16)
    with pytest.raises(ParameterError, match="another version"):
        robustness.run(small(), tmp_path / "a", lambda valves: None)


def test_command_prints_replays_and_draws(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(robustness, "CHUNK", 8)
    monkeypatch.chdir(tmp_path)
    options = ["--set", "duration=0.3", "--study-seed", "3"]
    assert main(["study", *options, "--valves", "12", "--figure", "study.svg", "--json", "study.json"]) == 0
    assert "(unstable): " in capsys.readouterr().out and (tmp_path / "study.svg").stat().st_size > 1000
    result = json.loads((tmp_path / "study.json").read_text())
    assert result["valves"] == 12 and len(list((tmp_path / result["folder"]).glob("valves_*.npz"))) == 2
    assert main(["study", *options, "--valves", "16"]) == 0
    assert "12 of 16 valves" not in capsys.readouterr().err  # both chunks were whole
    assert main(["study", *options, "--replay", "5", "--output", "worst.yaml", "--json", "worst.json"]) == 0
    assert json.loads((tmp_path / "worst.json").read_text())["valve_simulator"]["seed"] == 8
    assert main(["simulate", "--params-file", "worst.yaml", "--json", "five.json"]) == 0
    rows = np.load(tmp_path / result["folder"] / "valves_00000000.npz")["rows"]
    five = json.loads((tmp_path / "five.json").read_text())
    assert five["seed"] == 8 and five["indices"]["e_M"] == rows[5, measures.Results._fields.index("e_M")]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--set", "friction.coulomb=1.0"], "the study varies friction.coulomb from 0 to 2 V"),
        (["--fix", "friction"], "no such quantity"),
        (["--seed", "2"], "--study-seed"),
        (["--study-seed", "-1"], "must lie between 0 and"),
        (["--valves", "3000000000"], "there is no valve 2999999999"),
        (["--replay", "-1", "--output", "x.yaml"], "numbers begin at 0"),
        (["--command", "c.csv"], "give --sample-period too"),
        (["--set", "u_max=5.0", "--folder", "taken"], "cannot be written"),
        (["--duration", "100"], "--fix drift.gain"),
    ],
)
def test_bad_input_is_one_sentence(options, text, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("")
    np.savetxt("c.csv", np.zeros(100))
    assert main(["study", *options]) in (1, 2)
    printed = capsys.readouterr().err
    assert text in printed and len(printed.splitlines()) == 1
