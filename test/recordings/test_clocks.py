# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""One clock for all of a recording, and stamps that stand alone."""

import json
import math

import numpy as np
import pytest
from made import BEGIN, FLOAT, PERIOD, Message, Run, in_file_order, number, write

from valve_control.cli.command import run as main
from valve_control.recordings.analysis import analyze, as_dict
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.recording import align, load

SIGNALS = ("/spool_command", "/spool_position", "/valve_voltage")


@pytest.fixture(scope="module")
def run():
    made = Run()
    made.move(1500)
    return made


def stretched(messages, speed, begin=1_700_000_000_000_000_000):
    """Times of publication that go on at ``speed`` times those of recording."""
    return [m._replace(time=begin + round((m.log_time - BEGIN) * speed)) for m in messages]


def rate(about):
    """Rate [Hz] of the readings."""
    return about["valves"]["valve"]["timing"]["spool_position"]["rate_hz"]


@pytest.mark.parametrize("speed", [0.5, 1.03, 10.0])
def test_nothing_is_taken_from_a_clock_of_another_speed(run, tmp_path, speed):
    """What ruled before: times from one clock, the period from the other."""
    bag = write(tmp_path / "bag", stretched(run.messages, speed))
    loaded = load(bag)
    assert loaded.clock.name == "log_time"
    told = " ".join(loaded.problems)
    assert "different speeds" in told and f"by {speed:.4g} s in each second" in told
    about = as_dict(analyze(loaded))
    assert about["bag"]["clock"] == "log_time"
    assert rate(about) == pytest.approx(1000.0, rel=0.01)
    other = as_dict(analyze(load(bag, clock="publish")))
    assert other["bag"]["clock"] == "publish_time"
    assert other["bag"]["duration_s"] == pytest.approx(1.5 * speed, rel=0.01)
    assert rate(other) == pytest.approx(1000.0 / speed, rel=0.01)
    part = load(bag, start=0.2, end=0.5, clock="publish").valves["valve"].signals["spool_position"]
    assert (part.time[-1] - part.time[0]) * 1e-9 == pytest.approx(0.3 * speed, abs=0.01 * speed)


def test_a_bag_without_times_of_publication_has_but_one_clock(run, tmp_path):
    messages = [m._replace(time=m.log_time) for m in run.messages]
    bag = write(tmp_path / "bag", messages)
    assert load(bag).clock.name == "log_time" and load(bag, clock="log").clock.name == "log_time"
    with pytest.raises(BagError, match="no publish_time of its own"):
        load(bag, clock="publish")


def changed(at_publish, only=SIGNALS):
    """Changes the times of publication of the topics ``only`` by a function of the message."""
    return lambda messages: [m._replace(time=at_publish(m)) if m.topic in only else m for m in messages]


CONTRADICTIONS = {
    "backwards": (changed(lambda m: 2 * BEGIN - m.time), "go backwards"),
    "none from the middle on": (
        changed(lambda m: 0 if m.log_time > BEGIN + 700_000_000 else m.time), "have no source times"),
    "none on each third": (changed(lambda m: m.time * (m.sequence % 3 > 0)), "have no source times"),
    "seconds for nanoseconds": (changed(lambda m: m.time // 10**9), "different speeds"),
    "since the start of the machine": (changed(lambda m: m.time - BEGIN + 5 * 10**9), ""),
    "sent after they were recorded": (changed(lambda m: m.time + 37_000_000), ""),
    "one of three runs 2 % faster": (
        changed(lambda m: BEGIN + round(1.02 * (m.time - BEGIN)), SIGNALS[2:]), "publishers' clocks differ"),
    "another time zone": (
        changed(lambda m: m.time + 3600 * 10**9, SIGNALS[1:2]), "publishers' clocks differ"),
    "no source times": (lambda messages: [m._replace(time=m.log_time) for m in messages], "paired by number"),
}  # fmt: skip


@pytest.mark.parametrize("kind", CONTRADICTIONS)
def test_contradicting_times_are_named_and_move_no_figure(run, tmp_path, kind):
    change, words = CONTRADICTIONS[kind]
    messages = sorted(run.messages, key=lambda m: m.log_time)
    right = as_dict(analyze(load(write(tmp_path / "right", messages))))["valves"]["valve"]["indices"]
    found = as_dict(analyze(load(in_file_order(tmp_path / "bag", change(messages)))))
    valve = found["valves"]["valve"]
    assert words in "; ".join([*found["left_out"], *valve["left_out"]])
    assert valve["indices"] == pytest.approx(right, rel=0.03)


def test_several_publishers_on_one_topic_are_named(run, tmp_path):
    """Their numbers tell no losses then."""
    other = [m._replace(sequence=m.sequence + 50_000) for m in run.messages if m.topic == "/spool_position"]
    found = as_dict(analyze(load(write(tmp_path / "bag", [*run.messages, *other]))))["valves"]["valve"]
    assert any("several publishers" in text for text in found["left_out"])
    assert found["timing"]["spool_position"]["lost"] is None


# Stamps that stand alone


@pytest.mark.parametrize("hours", [-1.0, 0.5, 9.0])
def test_a_part_of_a_recording_whose_publishers_are_hours_off(tmp_path, hours):
    """--from and --to are times of recording; what was in force there is of the clock that counts."""
    made = Run(controller={"arc.k1": 120.0})
    made.move(1000)
    made.change(arc__k1=100.0)
    made.move(1000)
    usual = load(write(tmp_path / "usual", made.messages), start=0.5, end=1.5)
    moved = [m._replace(time=m.time + round(hours * 3600e9)) for m in made.messages]
    loaded = load(write(tmp_path / "moved", moved), start=0.5, end=1.5)
    valve, expected = loaded.valves["valve"], usual.valves["valve"]
    assert loaded.clock.name == "publish_time" and valve.controller.initial["arc.k1"] == 120.0
    assert len(valve.controller.changes) == len(expected.controller.changes) == 1
    found = align(valve).measurement
    assert abs(len(found) - len(align(expected).measurement)) <= 2 and len(found) > 990


# Clocks that are set, and gaps

SECOND_POLE, FIRST_POLE = 32.3, 5.89  # Hz
NAMED = ("leaps", "far from all others")


def stepped_sine(set_at=None, by=0.0, numbered=True, lost=(), publish=True, seed=1):
    """Voltages and readings of a valve with two poles, 1 kHz; at a reading all clocks are set ``by`` [s].

    ``lost``: readings from the first to before the second that nobody recorded, nor the voltages meanwhile.
    """
    random = np.random.default_rng(seed)
    decays = [math.exp(-2.0 * math.pi * pole * 1e-3) for pole in (FIRST_POLE, SECOND_POLE)]
    messages, spool, k = [], [0.0, 0.0], 0
    for frequency in np.geomspace(1.0, 60.0, 10):
        for i in range(round(1000 * max(1.5, 4.0 / frequency))):
            time = BEGIN + k * PERIOD + (round(by * 1e9) if set_at is not None and k >= set_at else 0)
            voltage = 2.0 * math.sin(2.0 * math.pi * frequency * i * 1e-3)
            for topic, value, late in (
                ("/spool_position", spool[1] + 0.004 * random.standard_normal(), 0),
                ("/valve_voltage", voltage, 200_000),
            ):
                sent = time + late
                log = sent + int(random.integers(50_000, 300_000))
                if not lost or not lost[0] <= k < lost[1]:
                    messages.append(
                        Message(
                            topic, FLOAT, sent if publish else log, (k + 1) * numbered, number(value), log
                        )
                    )
            new = spool[0] + (1.0 - decays[0]) * (voltage - spool[0])
            spool[1] += (1.0 - decays[1]) * (0.5 * (spool[0] + new) - spool[1])
            spool[0] = new
            k += 1
    return messages


HARD = {
    "set by +2 s, without numbers": ({"set_at": 10_500, "by": 2.0, "numbered": False}, True),
    "set by -20 ms": ({"set_at": 9_300, "by": -0.02}, True),
    "1970 to 2026": ({"set_at": 3_800, "by": 56 * 365 * 86_400.0}, True),
    "2 s missing, without numbers": ({"lost": (10_500, 12_500), "numbered": False, "publish": False}, True),
}


@pytest.mark.parametrize("case", HARD)
def test_a_valve_is_identified_whatever_the_clock_did(tmp_path, capsys, case):
    options, told = HARD[case]
    bag = str(in_file_order(tmp_path / "bag", stepped_sine(**options)))
    assert main(["identify", bag, "--json", "-", "--order", "2"]) == 0
    found = json.loads(capsys.readouterr().out)
    poles = sorted(pole["frequency"] for pole in found["fits"][0]["poles"])
    assert poles == pytest.approx([FIRST_POLE, SECOND_POLE], rel=0.03)
    assert told == any(word in note for note in found["notes"] for word in NAMED), found["notes"]


@pytest.mark.parametrize(
    ("by", "numbered"), [(2.0, True), (-3.0, False), (56 * 365 * 86_400.0, False), (-0.02, True)]
)
def test_a_clock_that_is_set_is_named_and_loses_nothing(run, tmp_path, by, numbered):
    """Of the longer part all is right: rates, lost ones, modes and length."""
    messages = []
    for m in sorted(run.messages, key=lambda m: m.log_time):
        more = round(by * 1e9) if m.log_time > BEGIN + 900_000_000 else 0
        messages.append(
            m._replace(log_time=m.log_time + more, time=m.time + more, sequence=m.sequence * numbered)
        )
    in_file_order(tmp_path / "bag", messages)
    loaded = load(tmp_path / "bag")
    about = as_dict(analyze(loaded))
    valve = about["valves"]["valve"]
    gap = valve["timing"]["spool_position"]["longest_gap_s"]
    assert gap > 1.9 or any(
        word in text for text in [*about["left_out"], *valve["left_out"]] for word in NAMED
    )
    for timing in valve["timing"].values():
        assert timing["rate_hz"] == pytest.approx(1000.0, rel=0.01)
        assert timing["lost"] == (0 if numbered else None)
    assert about["bag"]["duration_s"] < 5.0
    assert sum(valve["modes"][name]["duration_s"] for name in ("ok", "safe", "degraded")) < 5.0


# Stamps that stand alone

STAMPS = {"zero": 0, "largest": 2**63 - 1, "hours before": BEGIN - 3 * 3600 * 10**9}


@pytest.mark.parametrize("place", [0, 700])
@pytest.mark.parametrize("kinds", [("log_time",), ("log_time", "time")])
@pytest.mark.parametrize("stamp", STAMPS)
def test_one_stray_stamp_costs_one_message(run, tmp_path, stamp, place, kinds):
    """The rest is analysed as if that message were not there; --from counts from the same beginning."""
    ordered = sorted(run.messages, key=lambda m: m.log_time)
    at = [i for i, m in enumerate(ordered) if m.topic == "/spool_position"][place]
    stray = ordered[at]._replace(**dict.fromkeys(kinds, STAMPS[stamp]))
    in_file_order(tmp_path / "bag", [*ordered[:at], stray, *ordered[at + 1 :]])
    loaded = load(tmp_path / "bag")
    (note,) = loaded.problems
    assert note.startswith("1 of 1500 messages of /spool_position have a stamp far from all others")
    without = [*ordered[:at], *ordered[at + 1 :]]
    usual = load(write(tmp_path / "usual", without))
    found, expected = as_dict(analyze(loaded)), as_dict(analyze(usual))
    assert found["valves"] == expected["valves"]
    assert found["bag"]["duration_s"] == expected["bag"]["duration_s"]
    assert loaded.bag.begin == usual.bag.begin
