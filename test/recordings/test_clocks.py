"""One clock for all of a recording, and stamps that stand alone."""

import json
import math

import numpy as np
import pytest
from made import BEGIN, FLOAT, PERIOD, Message, Run, number, write

from valve_control.bags.errors import BagError
from valve_control.cli.command import run as main
from valve_control.identification import recorded
from valve_control.recordings.analysis import analyze, as_dict
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


@pytest.mark.parametrize("speed", [0.5, 2.0, 0.9, 1.03, 10.0])
def test_nothing_is_taken_from_a_clock_of_another_speed(run, tmp_path, speed):
    """What ruled before: times from one clock, the period from the other."""
    bag = write(tmp_path / "bag", stretched(run.messages, speed))
    loaded = load(bag)
    assert loaded.clock.name == "log_time"
    told = " ".join(loaded.problems)
    assert "different speeds" in told and f"by {speed:.4g} s in each second" in told
    about = as_dict(analyze(loaded))
    assert about["bag"]["clock"] == "log_time"
    assert about["valves"]["valve"]["lvdt_period"]["measured_s"] == pytest.approx(1e-3, rel=0.01)
    assert about["valves"]["valve"]["lvdt_period"]["other_rates"] == []
    other = as_dict(analyze(load(bag, clock="publish")))
    assert other["bag"]["clock"] == "publish_time"
    assert other["bag"]["duration_s"] == pytest.approx(1.5 * speed, rel=0.01)
    assert other["valves"]["valve"]["lvdt_period"]["measured_s"] == pytest.approx(speed * 1e-3, rel=0.01)
    part = load(bag, start=0.2, end=0.5, clock="publish").valves["valve"].signals["spool_position"]
    assert (part.time[-1] - part.time[0]) * 1e-9 == pytest.approx(min(0.3, 1.5 * speed - 0.2), abs=0.01)


@pytest.mark.parametrize("clock", ["log", "publish"])
def test_the_clock_that_is_chosen_is_that_of_every_command(run, tmp_path, capsys, clock):
    bag = str(write(tmp_path / "bag", stretched(run.messages, 0.5)))
    for command in (["analyze"], ["replay", "--mode", "what-if"], ["compare"]):
        assert main([*command, bag, "--clock", clock]) == 0
        out, err = capsys.readouterr()
        assert f"{clock}_time is used" in out + err or f"({clock}_time;" in out + err


def test_publishers_that_differ_are_told_by_how_much(run, tmp_path):
    messages = [
        m._replace(time=m.time - 20_000_000) if m.topic == "/spool_position" else m for m in run.messages
    ]
    told = " ".join(load(write(tmp_path / "bag", messages)).problems)
    assert "/spool_position +20.0" in told and "/spool_command +0." in told


def test_a_bag_without_times_of_publication_has_but_one_clock(run, tmp_path):
    messages = [m._replace(time=m.log_time) for m in run.messages]
    bag = write(tmp_path / "bag", messages)
    assert load(bag).clock.name == "log_time" and load(bag, clock="log").clock.name == "log_time"
    with pytest.raises(BagError, match="no publish_time of its own"):
        load(bag, clock="publish")


def test_identify_finds_the_valve_by_the_clock_that_it_names(tmp_path, capsys):
    """A lag of first order twice at 5 Hz, sampled at 1 kHz; publication at half the speed."""
    messages, spool = [], [0.0, 0.0]
    decay = math.exp(-2.0 * math.pi * 5.0 * 1e-3)
    for k in range(12_000):
        time = BEGIN + k * PERIOD
        voltage = 2.0 * math.sin(2.0 * math.pi * (0.5 * 60.0 ** (k / 12_000)) * k * 1e-3)
        for topic, value, late in (("/spool_position", spool[1], 0), ("/valve_voltage", voltage, 200_000)):
            messages.append(Message(topic, FLOAT, time // 2, k + 1, number(value), time + late))
        spool[1] += (1.0 - decay) * (spool[0] - spool[1])
        spool[0] += (1.0 - decay) * (voltage - spool[0])
    bag = str(write(tmp_path / "bag", messages))
    assert main(["identify", bag, "--json", "-", "--order", "2"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert any("different speeds" in note for note in told["notes"])
    assert any("log_time" in note for note in told["notes"])
    loaded = load(bag)
    assert recorded.recorded(loaded, loaded.valves["valve"]).period == pytest.approx(1e-3, rel=1e-3)
    assert recorded.recorded(
        load(bag, clock="publish"), load(bag, clock="publish").valves["valve"]
    ).period == (pytest.approx(0.5e-3, rel=1e-3))


# Stamps that stand alone

STAMPS = {
    "zero": 0,
    "largest": 2**63 - 1,
    "a year later": BEGIN + 365 * 86_400 * 10**9,
    "hours before": BEGIN - 3 * 3600 * 10**9,
}


@pytest.mark.parametrize("place", [0, 700, -1])
@pytest.mark.parametrize(
    ("stamp", "kinds"),
    [
        (stamp, kinds)
        for stamp in STAMPS
        for kinds in (("log_time",), ("time",), ("log_time", "time"))
        if (stamp, kinds) != ("zero", ("time",))  # 0 means that there is no time of publication
    ],
)
def test_one_stray_stamp_costs_one_message(run, tmp_path, stamp, place, kinds):
    """The rest is analysed as if that message were not there; --from counts from the same beginning."""
    from made import STORE

    from valve_control.bags.writer import BagWriter

    ordered = sorted(run.messages, key=lambda m: m.log_time)
    at = [i for i, m in enumerate(ordered) if m.topic == "/spool_position"][place]
    stray = ordered[at]._replace(**dict.fromkeys(kinds, STAMPS[stamp]))
    with BagWriter(tmp_path / "bag", "mcap") as writer:
        known = set()
        for m in [*ordered[:at], stray, *ordered[at + 1 :]]:
            if m.topic not in known:
                known.add(m.topic)
                text, _ = STORE.generate_msgdef(m.type, ros_version=2)
                writer.add_topic(m.topic, m.type, text, STORE.hash_rihs01(m.type))
            writer.write(m.topic, m.log_time, m.time, m.sequence, m.data)
    loaded = load(tmp_path / "bag")
    (note,) = loaded.problems
    assert "1 message of /spool_position has a stamp far from all others" in note
    without = [*ordered[:at], *ordered[at + 1 :]]
    usual = load(write(tmp_path / "usual", without))
    found, expected = as_dict(analyze(loaded)), as_dict(analyze(usual))
    assert found["valves"] == expected["valves"]
    assert found["bag"]["duration_s"] == expected["bag"]["duration_s"]
    assert loaded.bag.begin == usual.bag.begin


@pytest.mark.parametrize("away", [-5.0, 5.0, 1800.0])
def test_a_stamp_that_leaps_away_and_back_is_no_clock_that_was_set(run, tmp_path, away):
    messages = list(run.messages)
    at = [i for i, m in enumerate(messages) if m.topic == "/valve_voltage"][600]
    messages[at] = messages[at]._replace(time=messages[at].time + round(away * 1e9))
    loaded = load(write(tmp_path / "bag", messages))
    assert loaded.clock.source and len(loaded.problems) == 1
    assert np.array_equal(align(loaded.valves["valve"]).measurement, run.readings)
