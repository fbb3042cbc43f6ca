"""Studies: numbered valves that can be run again, and folders that outlive a stop."""

import numpy as np
import pytest

from valve_control.cli import main
from valve_control.parameters.table import NODES, ParameterError, defaults, updated
from valve_control.simulation import offline, study


def small(valves=20, seed=1, controller="oarc"):
    settings = {node: defaults(table) for node, table in NODES.items()}
    settings["controller"] = updated(NODES["controller"], settings["controller"], {"controller": controller})
    source = updated(NODES["command_source"], settings["command_source"], {"duration": 0.5, "start": 0.0})
    return study.Study({**settings, "command_source": source}, valves, seed)


def test_every_valve_can_be_run_again_alone():
    chosen = small()
    found = study.run_chunk(chosen, 0, 20)
    assert len(np.unique(found.period)) == 3
    for number in (0, 7, 19):
        settings = study.settings_of_number(chosen, number)
        command = offline.commands(settings["command_source"])
        run = offline.simulate(settings["controller"], settings["valve_simulator"], command)
        assert found.results.e_M[number] == run.indices.e_M
        assert found.results.e_rms[number] == pytest.approx(run.indices.e_rms, rel=1e-12)


def test_valve_is_the_same_in_a_longer_study_and_in_a_later_part():
    whole, part = study.run_chunk(small(), 0, 20), study.run_chunk(small(), 12, 8)
    assert np.array_equal(whole.points[12:], part.points)
    for a, b in zip(whole.results, part.results, strict=True):
        assert np.array_equal(a[12:], b, equal_nan=True)


def test_stopped_study_goes_on_and_is_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "CHUNK", 8)

    def stop(valves):
        if valves >= 16:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study.run(small(), tmp_path / "a", stop)
    assert len(list((tmp_path / "a").glob("valves_*.npz"))) == 2
    again = study.run(small(), tmp_path / "a", lambda valves: None)
    anew = study.run(small(), tmp_path / "b", lambda valves: None)
    for a, b in zip(again.results, anew.results, strict=True):
        assert len(a) == 20 and np.array_equal(a, b, equal_nan=True)
    with pytest.raises(ParameterError, match="other parameters"):
        study.run(small(seed=2), tmp_path / "a", lambda valves: None)


def test_worst_come_first_and_what_is_not_finite_before_them():
    found = study.run_chunk(small(), 0, 20)
    finite = found.results.finite.copy()
    finite[4] = False
    found = found._replace(results=found.results._replace(finite=finite))
    numbers = study.worst(found, "e_rms", 3)
    assert numbers[0] == 4 and numbers[1] == np.argmax(np.where(finite, found.results.e_rms, 0.0))
    assert found.unstable(1e9).sum() == 1
    assert study.summary(found)["valves"] == 20


def test_scaled_model_has_its_poles_and_gain_scaled():
    from valve_control.plant.models import MODELS

    model = MODELS["fourth_order"]
    fast = study.faster(model, 1.1, 1.25)
    assert fast.static_gain == pytest.approx(1.1 * model.static_gain)
    assert np.sort(np.roots(fast.denominator)) == pytest.approx(1.25 * np.sort(np.roots(model.denominator)))
    assert np.sort(np.roots(fast.numerator)) == pytest.approx(1.25 * np.sort(np.roots(model.numerator)))


def test_command_prints_replays_and_draws(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(study, "CHUNK", 8)
    options = ["--set", "duration=0.3", "--study-seed", "3"]
    folder, figure = tmp_path / "study", tmp_path / "study.png"
    assert main(["study", *options, "--valves", "12", "--folder", str(folder), "--figure", str(figure)]) == 0
    assert "unstable: " in capsys.readouterr().out and figure.stat().st_size > 1000
    assert main(["study", *options, "--replay", "5"]) == 0
    assert "seed = 8" in capsys.readouterr().out
