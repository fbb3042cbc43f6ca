# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The folder of a commissioning: what is there from before, another valve's, an end while writing."""

import argparse
import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from supervised import SupervisedValve

from valve_control.cli import command, commission
from valve_control.control.parameters import build, files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.design.commissioning import commissioning_report, folder, sequence
from valve_control.design.commissioning.bench import Fault, SafetyLimits
from valve_control.design.commissioning.folder import Folder
from valve_control.parameter import ParameterError, defaults, updated

LIMITS = SafetyLimits(4.0, 2.0)
RESULTS = ("tuned.yaml", "report.html", "commission.json", "valve.yaml", "refused_1.yaml", "refused_2.yaml")
QUICK = ["--controller", "pid", "--max-chatter", "0.3", "--budget", "40", "--valves", "3", "--unseen", "8"]


class Controller(SupervisedValve):
    """The supervised valve as the controller node that commission talks to."""

    name = "/controller"

    def meet_valve(self):
        pass


def arguments(path, *more) -> argparse.Namespace:
    line = ["commission", "--yes", "--folder", str(path), *more]
    parsed = command.Commands().top.parse_args(line)
    parsed.line = line
    return parsed


def state(path):
    return json.loads((path / "state.json").read_text(encoding="utf-8"))["state"]


def test_an_earlier_run_is_set_aside_and_can_be_undone(tmp_path, capfd):
    """A run that fails leaves no results of another one beside its own files."""
    for name in RESULTS:
        (tmp_path / name).write_text(f"old {name}", encoding="utf-8")
    valve = Controller(controller={"arc.k1": 77.0})
    first, kept = valve.values(), Folder(tmp_path, valve.name, LIMITS)
    assert kept.begin(first) == tmp_path / "earlier" / "1"
    kept.mark(folder.DONE)
    valve.apply({"arc.k1": 55.0})
    before = valve.values()
    valve.fault_at = 500
    with pytest.raises(Fault):
        commission._run(arguments(tmp_path), valve)
    assert valve.values() == before and valve.active and state(tmp_path) == folder.ABORTED
    assert f"moved the files of an earlier commissioning to {tmp_path}/earlier/2" in capfd.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["before.yaml", "earlier", "state.json"]
    assert all((tmp_path / "earlier" / "1" / name).read_text() == f"old {name}" for name in RESULTS)
    assert commission._undo(arguments(tmp_path / "earlier" / "2", "--undo"), valve) == 0
    assert valve.values() == first


@pytest.mark.parametrize("kept", [folder.RUNNING, folder.DONE])
def test_what_another_valve_needs_to_be_undone_stays(tmp_path, kept):
    values = updated(CONTROLLER, defaults(CONTROLLER), {"arc.k1": 77.0})
    other = Folder(tmp_path, "/boom/controller", LIMITS)
    other.begin(values)
    other.mark(kept)
    with pytest.raises(ParameterError, match=r"of /boom/controller; --folder gives /arm/controller one"):
        commission._run(arguments(tmp_path, "--node", "/arm/controller"), Controller())
    assert other.backup() == ("/boom/controller", values, kept)
    assert not (tmp_path / folder.EARLIER).exists()


@pytest.mark.campaign
def test_an_end_while_the_results_are_written_is_no_success(tmp_path, monkeypatch, capfd):
    """0 V, parameters from before, no results. Without it: new parameters and all results."""
    valve, marked = Controller({"friction.coulomb": 0.6, "lvdt.noise": 0.004}), Folder.mark
    before = valve.values()

    def interrupted(result):
        raise KeyboardInterrupt

    def full(self, wanted):
        if wanted == folder.DONE:
            raise OSError("no space")
        marked(self, wanted)

    for place, name, cut, error in (
        (commissioning_report, "page", interrupted, KeyboardInterrupt),
        (Folder, "mark", full, OSError),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, cut)
            with pytest.raises(error):
                commission._run(arguments(tmp_path, *QUICK), valve)
        assert valve.values() == before and valve.active and state(tmp_path) == folder.ABORTED
        left = {path.name for path in tmp_path.iterdir()} - {"earlier"}
        assert left == {"before.yaml", "state.json", "tests.npz", "valve.yaml"}
    assert commission._run(arguments(tmp_path, *QUICK), valve) == 0
    result = json.loads((tmp_path / "commission.json").read_text(encoding="utf-8"))
    assert valve.active and valve.values() == {**before, **result["applied"]}
    assert files.load(str(tmp_path / "tuned.yaml"))["controller"] == result["applied"]
    output = capfd.readouterr().out
    for name in ("report.html", "commission.json", "tuned.yaml"):
        assert f"wrote {tmp_path / name}" in output
    assert state(tmp_path) == folder.DONE


@settings(max_examples=30)
@given(
    st.floats(0.1, 100.0),
    st.lists(st.floats(1e-3, 1e6), min_size=4, max_size=4),
    st.sampled_from(["", "2", "y"]),
)
def test_a_backup_has_every_parameter_to_the_last_bit(tmp_path_factory, u_max, gamma, name):
    changes = {"u_max": u_max, "arc.gamma": gamma, "load_file": name, "controller": "dcarc"}
    values = updated(CONTROLLER, defaults(CONTROLLER), changes)
    kept = Folder(tmp_path_factory.mktemp("backup"), "/boom/controller", LIMITS)
    assert kept.backup() is None
    kept.begin(values)
    assert kept.backup() == ("/boom/controller", values, folder.RUNNING)
    kept.mark(folder.DONE)
    assert kept.backup().state == folder.DONE
    assert sequence.differences({**values, "u_max": 0.1}, values) in ({"u_max": u_max}, {})
    (kept.path / folder.STATE).write_text("{")
    with pytest.raises(ParameterError, match="is damaged"):
        kept.backup()


MODEL = {
    "controller": "dcarc",
    "dcarc.model": "custom",
    "dcarc.numerator": [1706617.8],
    "dcarc.denominator": [1.0, 439.19, 40893.8, 1896320.0],
    "dcarc.coil": 0.003,
    "reshaping.natural_frequency": 500.0,
}
GAINS = {"dcarc.voltage_weight": 3.0, "reshaping.lead": 0.004}


@pytest.mark.parametrize(
    ("before", "applied"),
    [
        (MODEL, GAINS),  # the same law with its model: only gains are different
        ({"controller": "arc", "arc.k1": 77.0, "sample_period": 0.002}, {**MODEL, **GAINS}),
        ({**MODEL, "u_max": 9.0}, {"controller": "pid", "pid.kp": defaults(CONTROLLER)["pid.kp"]}),
    ],
)
def test_tuned_yaml_alone_is_the_law_that_stays(before, applied):
    usual = defaults(CONTROLLER)
    before = updated(CONTROLLER, usual, before)
    final = updated(CONTROLLER, before, applied)
    written = folder.tuned_values(before, applied)
    assert written.items() >= applied.items()
    alone = updated(CONTROLLER, usual, written)
    assert build.law_params(alone) == build.law_params(final)
    assert alone["controller"] == final["controller"] and alone["sample_period"] == final["sample_period"]
