# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The folder of a commissioning: what is there from before, another valve's, an end while writing."""

import argparse
import json
import resource

import pytest
from supervised import SupervisedValve

from valve_control.cli import command, commission
from valve_control.control.parameters import files
from valve_control.design.commissioning import backup, commissioning_report
from valve_control.design.commissioning.bench import Fault
from valve_control.parameter import ParameterError

RESULTS = ("tuned.yaml", "report.html", "commission.json", "valve.yaml", "refused_1.yaml", "refused_2.yaml")


class Controller(SupervisedValve):
    """The supervised valve as the controller node that commission talks to."""

    def __init__(self, name, plant=None, controller=None, fault_at=None):
        super().__init__(plant, controller, fault_at)
        self.name = name

    def meet_valve(self):
        pass


def arguments(folder, *more) -> argparse.Namespace:
    line = ["commission", "--yes", "--folder", str(folder), *more]
    found = command.parser().parse_args(line)
    found.line = line
    return found


def state(folder):
    return json.loads((folder / "state.json").read_text(encoding="utf-8"))["state"]


def test_what_an_earlier_run_left_is_set_aside(tmp_path, capfd):
    """A run that fails leaves no results of another one beside its own files."""
    for name in RESULTS:
        (tmp_path / name).write_text(f"old {name}", encoding="utf-8")
    for number in (1, 2):
        valve = Controller("/controller", fault_at=500)
        before = valve.values()
        with pytest.raises(Fault):
            commission._run(arguments(tmp_path), valve)
        assert valve.values() == before and valve.active
        assert sorted(path.name for path in tmp_path.iterdir()) == ["before.yaml", "earlier", "state.json"]
        assert state(tmp_path) == backup.ABORTED
        assert (
            f"moved the files of an earlier commissioning to {tmp_path}/earlier/{number}"
            in capfd.readouterr().out
        )
    assert all((tmp_path / "earlier" / "1" / name).read_text() == f"old {name}" for name in RESULTS)
    assert sorted(path.name for path in (tmp_path / "earlier" / "2").iterdir()) == [
        "before.yaml",
        "state.json",
    ]


def test_the_parameters_from_before_an_earlier_run_can_be_brought_back(tmp_path):
    valve = Controller("/controller", controller={"arc.k1": 77.0})
    first = valve.values()
    backup.write(tmp_path, valve.name, first)
    backup.mark(tmp_path, valve.name, backup.DONE)
    valve.apply({"arc.k1": 55.0})
    valve.fault_at = 500
    with pytest.raises(Fault):
        commission._run(arguments(tmp_path), valve)
    assert valve.values() == {**first, "arc.k1": 55.0}
    assert commission._undo(arguments(tmp_path / "earlier" / "1", "--undo"), valve) == 0
    assert valve.values() == first


@pytest.mark.parametrize("kept", [backup.RUNNING, backup.DONE])
def test_what_another_valve_needs_to_be_undone_stays(tmp_path, kept):
    other = Controller("/boom/controller", controller={"arc.k1": 77.0})
    backup.write(tmp_path, other.name, other.values())
    backup.mark(tmp_path, other.name, kept)
    with pytest.raises(ParameterError, match=r"of /boom/controller; --folder gives /arm/controller one"):
        commission._run(arguments(tmp_path, "--node", "/arm/controller"), Controller("/arm/controller"))
    read = backup.read(tmp_path)
    assert (read.node, read.values, read.state) == (other.name, other.values(), kept)
    assert not (tmp_path / backup.EARLIER).exists()


@pytest.mark.campaign
def test_an_end_while_the_results_are_written_is_no_success(tmp_path, monkeypatch, capfd):
    """Ctrl-C then: 0 V, parameters from before, no results. Without it: new parameters and all results."""
    quick = [
        "--controller",
        "pid",
        "--max-chatter",
        "0.3",
        "--budget",
        "40",
        "--valves",
        "3",
        "--unseen",
        "8",
    ]
    plant = {"friction.coulomb": 0.6, "lvdt.noise": 0.004}
    valve, page = Controller("/controller", plant), commissioning_report.page
    before = valve.values()

    def interrupted(result):
        page(result)
        raise KeyboardInterrupt

    marked = backup.mark

    def interrupted_late(folder, node, wanted):
        if wanted == backup.DONE:
            raise KeyboardInterrupt
        marked(folder, node, wanted)

    for place, name, cut in ((commissioning_report, "page", interrupted), (backup, "mark", interrupted_late)):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, cut)
            with pytest.raises(KeyboardInterrupt):
                commission._run(arguments(tmp_path, *quick), valve)
        assert valve.values() == before and valve.active
        left = {path.name for path in tmp_path.iterdir()} - {"earlier"}
        assert (
            left == {"before.yaml", "state.json", "tests.npz", "valve.yaml"}
            and state(tmp_path) == backup.ABORTED
        )
    capfd.readouterr()
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, usual[1]))  # less than the report
    try:
        with pytest.raises(OSError, match="File too large"):
            commission._run(arguments(tmp_path, *quick), valve)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert valve.values() == before and valve.active
    assert "all its parameters are as before" in capfd.readouterr().err
    left = {path.name for path in tmp_path.iterdir()} - {"earlier"}
    assert (
        left == {"before.yaml", "state.json", "tests.npz", "valve.yaml"} and state(tmp_path) == backup.ABORTED
    )
    assert commission._run(arguments(tmp_path, *quick), valve) == 0
    told = json.loads((tmp_path / "commission.json").read_text(encoding="utf-8"))
    assert valve.active and valve.values() == {**before, **told["applied"]}
    assert files.load(str(tmp_path / "tuned.yaml"))["controller"] == told["applied"]
    said = capfd.readouterr().out
    assert all(
        f"wrote {tmp_path / name}" in said for name in ("report.html", "commission.json", "tuned.yaml")
    )
    assert state(tmp_path) == backup.DONE


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--seed", "-5"], "--seed is -5; it must lie between 0 and 2000000000"),
        (["--seed", "2147000000"], "--seed is 2147000000; it must lie between 0 and 2000000000"),
        (["--unseen", "1000000000"], "--unseen is 1000000000; it must lie between 1 and 100000"),
    ],
)
def test_numbers_are_looked_at_before_the_valve_moves(tmp_path, more, words):
    with pytest.raises(ParameterError, match=words):
        commission._check(arguments(tmp_path, *more))
