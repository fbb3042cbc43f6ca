# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""A pause spoils a stretch of a test, not the commissioning; a failed one goes on after its whole tests."""

from types import SimpleNamespace

import numpy as np
import pytest
from supervised import Steps, SupervisedValve

from benchmarks import supervised as bench_without_ros
from valve_control.design.commissioning import folder, gains, sequence, valve_fit
from valve_control.design.commissioning.bench import Diagnosis, Fault, Plan, SafetyLimits
from valve_control.design.commissioning.folder import Folder
from valve_control.design.tuning.trial import TuningMotion
from valve_control.parameter import ParameterError

LIMITS = SafetyLimits(3.0, 1.5)
PLAN = Plan(LIMITS, "pid", 0.3, 40, 3, 8, 1, 1)
OF_VALVE = {"friction.coulomb": 0.6, "disturbance.offset": 0.2, "lvdt.noise": 0.004, "lvdt.delay": 0.0012}
BEFORE = {"controller": "oarc", "u_max": 9.0, "oarc.k1": 77.0, "command_limit": 8.0}
STOOD = 60  # samples


class Pausing(SupervisedValve):
    """Its controller stands still before some of its samples, and gives 0 V then."""

    def __init__(self, pauses=(), every=0):
        super().__init__(OF_VALVE, BEFORE)
        self.pauses, self.every, self.paused = set(pauses), every, 0

    def sample(self):
        at = len(self.readings)
        if self.active and (at in self.pauses or (self.every and at > 3000 and at % self.every == 0)):
            self.paused += 1
            self.supervisor.silence(STOOD * 0.001, stalled=True)
            for _ in range(STOOD):
                self.state = self._step(self.params, self.state, 0.0)
        return super().sample()


def made(valve):
    """Records and fitted valve of the tests."""
    before, steps = valve.values(), Steps()
    run = sequence.Commissioning(valve, PLAN, before, steps)
    valve.off()
    run._open_loop()
    return run._tested(), run, steps


def test_tests_with_pauses_tell_the_same_valve(monkeypatch):
    """At random moments 5 to 15 s apart; each stretch is whole in the end."""
    monkeypatch.setattr(valve_fit, "fitted", lambda *about: None)
    moments = np.cumsum(np.random.default_rng(44).uniform(5000.0, 15000.0, 12)).astype(int)
    (found, run, steps), (usual, *_) = made(valve := Pausing(moments)), made(Pausing())
    assert valve.paused >= 3 and run._pauses.total() == valve.paused
    assert np.max(np.abs(valve.voltages)) <= LIMITS.voltage
    assert 2 <= len(found.slow.begins) + len(found.sine.begins) - 1 <= 1 + valve.paused
    assert len(found.sine.reading) == pytest.approx(len(usual.sine.reading), abs=2)
    assert found.static.gain == pytest.approx(usual.static.gain, rel=0.01)
    assert found.static.friction == pytest.approx(usual.static.friction, rel=0.02)
    assert found.static.dead_zone == pytest.approx(usual.static.dead_zone, rel=0.1)
    assert len(found.response.frequency) == len(usual.response.frequency)
    assert all(done <= total for _, done, total in steps.reports)


def test_a_stretch_that_pauses_spoil_four_times_ends_it():
    valve = Pausing(every=150)
    before = valve.values()
    with (
        pytest.raises(Fault, match="stood still .* 4 times in one stretch of the step"),
        sequence.reversible(valve, before, sequence.Reversal()),
    ):
        sequence.Commissioning(valve, PLAN, before, Steps()).run()
    assert valve.values() == before and valve.active


def test_no_sentence_steers_a_commissioning(monkeypatch):
    """Pauses, stretches, the end and what becomes of the parameters, whatever the controller's words."""
    words = "oscillates at 9 Hz; saturated for 9 s; stood still; all its parameters are as before"
    ends = []
    for text in ("", words):
        with monkeypatch.context() as patch:
            patch.setattr(
                bench_without_ros, "Diagnosis", lambda *about, text=text: Diagnosis(*about[:3], text)
            )
            valve, steps, reversal = Pausing([2500, 9000]), Steps(), sequence.Reversal()
            valve.fault_at = 12_000
            before = valve.values()
            with pytest.raises(Fault), sequence.reversible(valve, before, reversal):
                sequence.Commissioning(valve, PLAN, before, steps).run()
        assert valve.paused == 2 and valve.values() == before
        ends.append((valve.voltages, valve.applied, steps.asked, steps.reports, reversal.restored))
    assert ends[0] == ends[1]


def test_a_pause_without_a_course_is_counted_and_nothing_else():
    """During a search, and while the new gains are set: the controller's process stood still there."""
    valve = Pausing()
    run = sequence.Commissioning(valve, PLAN, valve.values(), Steps())
    watched = valve.watch

    def watch(limits):
        watched(limits)
        raise sequence.Pause("the controller's process stood still")

    valve.watch = watch
    run._modelled()
    assert run._pauses == {sequence.SEARCH: 1}
    run._paused -= 2.0 * sequence.APART
    assert run._kept({"oarc.k1": 50.0}) == valve.values() == {**run._before, "oarc.k1": 50.0}
    assert run._pauses == {sequence.SEARCH: 1, sequence.LAST: 1} and valve.active


def test_a_motion_that_a_pause_spoils_is_repeated_behind_another_approach():
    motions = [
        TuningMotion(name, 0.4 * np.sin(2.0 * np.pi * turns / 1500.0 * np.arange(1500)))
        for name, turns in (("a", 2), ("b", 4))
    ]
    tuned = gains.TunedGains(SimpleNamespace(chatter=0.25, law="oarc"), motions, {}, {})
    motion = gains.verifying_motion(tuned, 0.001)
    assert motion.stretches == (motion.judged, motion.judged + 1500 + 300)
    whole = len(motion.wanted) - motion.judged
    for pause, begins in ((700, (0,)), (motion.judged + 900, (0,)), (motion.judged + 2500, (0, 1800))):
        valve = Pausing()
        valve.pauses = {1000 + pause}
        valve.apply({"u_max": LIMITS.voltage})
        run = sequence.Commissioning(valve, PLAN, valve.values(), Steps())
        run._at_rest(1.0)
        record = run._moved(motion)
        assert record.begins == begins and valve.paused == 1
        assert len(record.reading) == pytest.approx(whole, abs=2)
        assert np.array_equal(record.command[:whole], motion.wanted[motion.judged :])
        assert gains._indices(record).e_rms < 0.03


def test_a_verification_run_of_late_messages_is_repeated_and_ends_with_the_reason(monkeypatch):
    """A machine that is late all the time is named, and no gains are blamed."""
    valve = Pausing()
    valve.apply({"u_max": LIMITS.voltage})
    run = sequence.Commissioning(valve, PLAN, valve.values(), Steps())
    run._at_rest(1.0)
    drive = valve.drive

    def late(*about):
        record = drive(*about)
        return record._replace(late=np.arange(len(record.reading)) % 200 == 0)

    monkeypatch.setattr(valve, "drive", late)
    motion = gains.VerifyingMotion(np.zeros(500), 100, (100,))
    with pytest.raises(Fault, match=r"late messages reach .*, 3 times: .*chrt -f 10"):
        run._moved(motion)
    assert run._pauses == {"verification": 3}


class Ends(Steps):
    def tested(self, records):
        super().tested(records)
        if sequence.SINE in records:
            raise Fault("the test wants it")


def test_a_test_that_cannot_be_evaluated_is_made_again(monkeypatch):
    def spoiled(record, rest):
        raise ParameterError("no triangle")

    monkeypatch.setattr(sequence.evaluation, "slow", spoiled)
    valve, steps = Pausing([9000]), Steps()
    with pytest.raises(ParameterError, match="no triangle"):
        sequence.Commissioning(valve, PLAN, valve.values(), steps).run()
    assert set(steps.records) == {sequence.REST}


def test_a_failed_commissioning_goes_on_after_its_whole_tests(tmp_path):
    valve, steps = Pausing([9000]), Ends()
    with pytest.raises(Fault):
        sequence.Commissioning(valve, PLAN, valve.values(), steps).run()
    assert set(steps.records) == {sequence.REST, sequence.SLOW, sequence.SINE}
    kept = Folder(tmp_path, "/controller", LIMITS)
    kept.tested(steps.records)
    records = kept.tests(0.001)
    for name, record in steps.records.items():
        assert records[name].begins == record.begins
        assert np.array_equal(records[name].reading, record.reading, equal_nan=True)
    del records[sequence.SINE]
    again = Ends()
    samples = len(valve.readings)
    with pytest.raises(Fault):
        sequence.Commissioning(valve, PLAN, valve.values(), again, records=records).run()
    assert len(valve.readings) - samples < 1.2 * len(steps.records[sequence.SINE].reading)
    assert {name for name, *_ in again.reports} == {sequence.SINE}
    assert again.records[sequence.SLOW] is records[sequence.SLOW]
    for node, limits, period in (
        ("/other", LIMITS, 0.001),
        ("/controller", SafetyLimits(3.0, 1.0), 0.001),
        ("/controller", LIMITS, 0.002),
    ):
        with pytest.raises(ParameterError, match=r"--resume needs the same node, --max-voltage"):
            Folder(tmp_path, node, limits).tests(period)
    (tmp_path / folder.TESTS).write_bytes(b"PK nothing")
    with pytest.raises(ParameterError, match="is damaged"):
        kept.tests(0.001)
    with pytest.raises(ParameterError, match="no whole test"):
        Folder(tmp_path / "nowhere", "/controller", LIMITS).tests(0.001)
