# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings with faults that no real bag at hand has: each gives the true figures, or says what it lacks."""

import hashlib
import json
import os
import shutil
import sqlite3
import struct
import warnings
import zlib
from contextlib import closing

import numpy as np
import pytest
from made import BEGIN, FLOAT, PERIOD, STORE, Run, in_file_order, number, string
from mcap.writer import Writer as LibraryWriter
from test_clocks import FIRST_POLE, SECOND_POLE, stepped_sine

from valve_control.cli.command import run as main

pytestmark = pytest.mark.campaign

MS, SECOND = 10**6, 10**9
COMMAND, READING, VOLTAGE = SIGNALS = "/spool_command", "/spool_position", "/valve_voltage"
LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n"


@pytest.fixture(scope="module")
def messages():
    """1.5 s of a sine, in order of recording."""
    made = Run()
    made.move(1500)
    return sorted(made.messages, key=lambda m: m.log_time)


@pytest.fixture(scope="module")
def true(messages, tmp_path_factory):
    status, out, _ = call("analyze", in_file_order(tmp_path_factory.mktemp("true") / "bag", messages))
    assert status == 0
    return out["valves"]["valve"]["indices"]


def call(command, path, *more):
    """Status, output as JSON and what was said, of a command that must neither fail nor warn."""
    file = path.parent / "out.json"
    file.unlink(missing_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            status = main([command, str(path), "--json", str(file), *more])
        except SystemExit as error:
            status, said = 2, str(error.code)
        else:
            said = ""
    return status, json.loads(file.read_text()) if file.exists() else None, said


def analyzed(path, capsys):
    """Status, results of the valve, and everything that is said, as one text."""
    capsys.readouterr()
    status, out, said = call("analyze", path)
    if out is None:
        return status, None, said + capsys.readouterr().err
    valve = out["valves"].get("valve")
    return status, valve, "; ".join([*out["left_out"], *(valve["left_out"] if valve else [])])


def check(path, capsys, true, expected):
    """``expected``: words that are said; ``refused: `` with status 2, ``part: `` without all indices."""
    status, valve, said = analyzed(path, capsys)
    kind, _, words = expected.rpartition(": ")
    assert words in said, said
    assert (status == 2) == (kind == "refused"), said
    if kind == "":
        for name, value in true.items():
            assert valve["indices"][name] == pytest.approx(value, rel=0.03), (name, said)
        assert all(t["lost"] in (0, None) for t in valve["timing"].values()) or words, valve["timing"]
    elif kind == "part":
        for name, value in (valve["indices"] or {}).items():
            assert value is None or value == pytest.approx(true[name], rel=0.03), (name, said)


def times(at_log=None, at_publish=None, only=SIGNALS):
    """Changes of the stamps of all messages of the topics ``only`` (None: all), by functions of them."""

    def change(messages):
        for m in messages:
            if only is None or m.topic in only:
                if at_publish:
                    m = m._replace(time=at_publish(m))
                if at_log:
                    m = m._replace(log_time=at_log(m))
            yield m

    return change


def both(stamp, only=None):
    return times(lambda m: stamp(m.log_time), lambda m: stamp(m.time), only)


# A1: clocks

CLOCKS = {
    "backwards": (times(None, lambda m: 2 * BEGIN - m.time), "source times go backwards"),
    "none from the middle on": (
        times(None, lambda m: 0 if m.log_time > BEGIN + 700 * MS else m.time), "have no source times"),
    "none on each third": (times(None, lambda m: m.time * (m.sequence % 3 > 0)), "have no source times"),
    "microseconds for nanoseconds": (times(None, lambda m: m.time // 1000), "different speeds"),
    "seconds for nanoseconds": (times(None, lambda m: m.time // SECOND), "different speeds"),
    "nanoseconds without their carry": (
        times(None, lambda m: m.time - SECOND * (m.time % SECOND < 50 * MS)), "source times go backwards"),
    "32 bits of nanoseconds": (times(None, lambda m: m.time % 2**32), ""),
    "since the start of the machine": (times(None, lambda m: m.time - BEGIN + 5 * SECOND), ""),
    "sent after they were recorded": (times(None, lambda m: m.time + 37 * MS), ""),
    "one of three runs 2 % faster": (
        times(None, lambda m: BEGIN + round(1.02 * (m.time - BEGIN)), [VOLTAGE]),
        "publishers' clocks differ"),
    "another time zone": (
        times(None, lambda m: m.time + 3600 * SECOND, [READING]), "publishers' clocks differ"),
    "faster from the middle on": (
        times(None, lambda m: m.time + max(0, (m.time - BEGIN - 750 * MS) // 20)), "different speeds"),
    "the same for all": (times(None, lambda m: BEGIN), "different speeds"),
    "recorder at half the speed": (
        times(lambda m: BEGIN + (m.log_time - BEGIN) // 2, None, None), "different speeds"),
    "no source times": (times(None, lambda m: m.log_time, None), "paired by number"),
}  # fmt: skip


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("kind", CLOCKS)
def test_clocks(messages, true, tmp_path, capsys, kind, storage):
    change, words = CLOCKS[kind]
    check(in_file_order(tmp_path / "bag", list(change(messages)), storage), capsys, true, words)


# A2: jumps and gaps


def later(by):
    return lambda m: m._replace(time=m.time + round(by(m) * 1e9), log_time=m.log_time + round(by(m) * 1e9))


def at(m):
    """Number of its sample."""
    return (m.time - BEGIN) // PERIOD


GAPS = {
    "three pauses": (lambda m: [m] * (not any(0 <= at(m) - k < 500 for k in (8000, 15000, 25000))), True),
    "a stretch twice": (lambda m: [m] * (1 + (10000 <= at(m) < 12000)), True),
    "set and set back": (lambda m: [later(lambda m: 2.0 * (10000 <= at(m) < 20000))(m)], True),
    "set by one period": (lambda m: [later(lambda m: 1e-3 * (at(m) >= 10000))(m)], True),
    "500 ppm too slow": (lambda m: [later(lambda m: 5e-7 * at(m))(m)], True),
    "ten steps of -20 ms": (lambda m: [later(lambda m: -0.02 * (at(m) // 2500))(m)], False),
    "half the rate from the middle on": (lambda m: [m] * (at(m) < 15000 or at(m) % 2 == 0), False),
    "each fifth message": (lambda m: [m] * (zlib.crc32(f"{m.topic} {at(m)}".encode()) % 5 > 0), True),
    "each third reading": (lambda m: [m] * (m.topic != READING or at(m) % 3 > 0), False),
    "each third voltage": (lambda m: [m] * (m.topic != VOLTAGE or at(m) % 3 > 0), False),
    "a day later": (lambda m: [later(lambda m: 86400.0 * (at(m) >= 15000))(m)], True),
    "a leap second": (lambda m: [later(lambda m: -1.0 * (at(m) >= 15000))(m)], True),
    "a leap second without numbers": (lambda m: [later(lambda m: -1.0 * (at(m) >= 15000))(m)], False),
    "a leap second smeared over 10 s": (
        lambda m: [later(lambda m: float(np.clip(1e-4 * (at(m) - 10000), 0.0, 1.0)))(m)], True),
    "numbers that run over": (lambda m: [m._replace(sequence=(m.sequence - 9000) % 2**32)], True),
    "numbers that begin anew": (lambda m: [m._replace(sequence=m.sequence - 15000 * (at(m) >= 15000))], True),
    "voltages from 3 s on": (lambda m: [m] * (m.topic == READING or at(m) > 3000), True),
}  # fmt: skip


@pytest.fixture(scope="module")
def identifiable():
    return stepped_sine()


@pytest.mark.parametrize("kind", GAPS)
def test_jumps_and_gaps(identifiable, tmp_path, kind):
    """The poles within 3 %, or a refusal."""
    change, numbered = GAPS[kind]
    bag = [m._replace(sequence=m.sequence * numbered) for one in identifiable for m in change(one)]
    status, out, _ = call("identify", in_file_order(tmp_path / "bag", bag), "--order", "2")
    assert status == 0
    poles = sorted(pole["frequency"] for pole in out["fits"][0]["poles"])
    assert poles == pytest.approx([FIRST_POLE, SECOND_POLE], rel=0.03)


# A3: equal stamps


def floor(step):
    return lambda stamp: stamp // step * step


def twice(messages):
    return [m for one in messages for m in (one, one)]


EQUAL = {
    "one stamp for all": (both(lambda stamp: BEGIN), "refused: share 1 stamp"),
    "one stamp for the readings": (both(lambda stamp: BEGIN, [READING]), "part: share 1 stamp"),
    "one stamp for the voltages": (both(lambda stamp: BEGIN, [VOLTAGE]), "part: share 1 stamp"),
    "one stamp for the commands": (both(lambda stamp: BEGIN, [COMMAND]), "part: share 1 stamp"),
    "whole seconds": (both(floor(SECOND)), "refused: share 2 stamps"),
    "readings of 10 ms": (both(floor(10 * MS), [READING]), "resolution of 10 ms"),
    "100 ms": (both(floor(100 * MS)), "resolution of 100 ms"),
    "60 Hz": (both(lambda stamp: stamp * 60 // SECOND * SECOND // 60), "resolution of 16.67 ms"),
    "pairs": (both(floor(2 * MS)), "resolution of 2 ms"),
    "all messages twice": (twice, "2 publishers are interleaved"),
    "one stamp a sample": (both(lambda stamp: floor(MS)(stamp + 400_000)), "resolution of 1 ms"),
    "10 ms from the middle on": (
        both(lambda stamp: floor(10 * MS)(stamp) if stamp > BEGIN + 750 * MS else stamp),
        "resolution of 10 ms"),
    "10 ms until the middle": (
        both(lambda stamp: floor(10 * MS)(stamp) if stamp < BEGIN + 750 * MS else stamp),
        "resolution of 10 ms"),
    "voltages at the next tick": (
        lambda messages: [
            one for m in messages for k in (10 * MS * (m.topic == VOLTAGE),)
            for one in both(lambda stamp, k=k: floor(10 * MS)(stamp) + k)([m])
        ], "resolution of 10 ms"),
}  # fmt: skip


@pytest.mark.parametrize("kind", EQUAL)
def test_equal_stamps(messages, true, tmp_path, capsys, kind):
    change, words = EQUAL[kind]
    check(in_file_order(tmp_path / "bag", list(change(messages))), capsys, true, words)


# A4: stray stamps


def stray(stamp, *places, kinds=("log_time", "time")):
    """``places``: topic and number among its messages, which get ``stamp`` [ns]."""

    def change(messages):
        chosen = {[i for i, m in enumerate(messages) if m.topic == topic][k] for topic, k in places}
        return [
            m._replace(**dict.fromkeys(kinds, stamp)) if i in chosen else m for i, m in enumerate(messages)
        ]

    return change


def after(*changes):
    def change(messages):
        for one in changes:
            messages = one(messages)
        return messages

    return change


APART = "far from all others"
STRAYS = {
    "-1": (stray(2**64 - 1, (READING, 3)), "mcap", APART),
    "-5": (stray(-5, (READING, 9), kinds=("log_time",)), "sqlite3", APART),
    "the least": (stray(-(2**63), (READING, 9), kinds=("log_time",)), "sqlite3", APART),
    "1": (stray(1, (READING, 0)), "mcap", APART),
    "parameters at 0": (stray(0, ("/parameter_events", 0)), "mcap", APART),
    "a state in 2116": (stray(2**62, ("/controller/state", 5)), "mcap", APART),
    "a journal in 2116": (stray(2**62, ("/controller/journal", 2)), "mcap", ""),
    "diagnostics in 2116": (stray(2**62, ("/diagnostics", 0)), "mcap", APART),
    "one on each topic": (stray(7, *((topic, 4) for topic in SIGNALS)), "mcap", APART),
    "first and last": (after(stray(5, (READING, 0)), stray(2**61, (READING, -1))), "mcap", APART),
    "first three": (stray(0, *((READING, k) for k in range(3))), "mcap", APART),
    "all commands three years later": (
        both(lambda stamp: stamp + 10**17, [COMMAND]), "mcap", "part: no time in common"),
    "all voltages a day earlier": (
        both(lambda stamp: stamp - 86_400 * SECOND, [VOLTAGE]), "mcap", "part: no time in common"),
}  # fmt: skip


@pytest.mark.parametrize("kind", STRAYS)
def test_stray_stamps(messages, true, tmp_path, capsys, kind):
    change, storage, words = STRAYS[kind]
    check(in_file_order(tmp_path / "bag", list(change(messages)), storage), capsys, true, words)


# A5: serializations and definitions


def volts(m):
    return struct.unpack("<d", m.data[4:])[0]


def library(path, messages, change, only=SIGNALS, **options):
    """A file of the mcap library; ``change`` gives type, encoding, definition and message of a signal."""
    with path.open("wb") as stream:
        writer = LibraryWriter(stream, **options)
        writer.start("ros2")
        channels = {}
        for m in messages:
            text = STORE.generate_msgdef(m.type, ros_version=2)[0].encode()
            kind, encoding, text, data = change(m) if m.topic in only else (m.type, "cdr", text, m.data)
            key = m.topic, kind, encoding, text
            if key not in channels:
                channels[key] = writer.register_channel(
                    m.topic, encoding, writer.register_schema(kind, "ros2msg", text)
                )
            writer.add_message(channels[key], m.log_time, data, m.time, m.sequence)
        writer.finish()
    return path


DEFINITION = b"float64 data"
FLOAT32 = "std_msgs/msg/Float32"


def float64(data=None, text=DEFINITION, encoding="cdr"):
    return lambda m: (FLOAT, encoding, text, m.data if data is None else data(m))


def float32(m):
    return FLOAT32, "cdr", b"float32 data", b"\0\1\0\0" + struct.pack("<f", volts(m))


def every_other(one, other):
    return lambda m: (one if m.sequence % 2 else other)(m)


SERIALIZED = {
    "big endian": (float64(lambda m: b"\0\0\0\0" + struct.pack(">d", volts(m))), SIGNALS, ""),
    "XCDR2": (float64(lambda m: b"\0\7\0\0" + m.data[4:]), SIGNALS, "refused: not plain CDR"),
    "delimited": (
        float64(lambda m: b"\0\x09\0\0\x08\0\0\0" + m.data[4:]), SIGNALS, "refused: not plain CDR"),
    "parameter list": (
        float64(lambda m: b"\0\3\0\0\1\x80\x08\0" + m.data[4:]), SIGNALS, "refused: not plain CDR"),
    "no header": (float64(lambda m: m.data[4:]), SIGNALS, "refused: is left out"),
    "cut": (float64(lambda m: m.data[:8]), SIGNALS, "refused: ends in the middle"),
    "nothing": (float64(lambda m: b""), SIGNALS, "refused: not plain CDR"),
    "padded": (float64(lambda m: m.data + bytes(4)), SIGNALS, ""),
    "32 bits called 64": (float64(lambda m: float32(m)[3]), SIGNALS, "refused: ends in the middle"),
    "32 bits": (float32, SIGNALS, ""),
    "two types in turn": (every_other(float64(), float32), [READING], "part: has two types"),
    "two serializations in turn": (
        every_other(float64(), float64(lambda m: b'{"data":0.5}', b"{}", "json")), [READING],
        "part: has two serializations"),
    "two channels in turn": (every_other(float64(), float64(text=b"float64 data\n")), SIGNALS, ""),
    "CDR in capitals": (float64(encoding="CDR"), SIGNALS, "refused: only cdr"),
    "no UTF-8": (float64(text=b"float64 data # \xff\xfe"), SIGNALS, ""),
    "UTF-16": (float64(text="float64 data".encode("utf-16")), SIGNALS, ""),
    "text for a number": (
        lambda m: ("std_msgs/msg/String", "cdr", b"string data", string(str(volts(m)))), [READING],
        "part: there is no number 'data'"),
    "a definition of itself": (
        lambda m: ("mine/msg/A", "cdr", b"mine/A data\n===\nMSG: mine/A\nmine/A data", m.data), SIGNALS,
        "refused: no definition"),
    "each fifth not a number": (
        float64(lambda m: m.data if m.sequence % 5 else number(float("nan"))), [READING],
        "part: hold NaN or infinity"),
    "one of 1e308": (
        float64(lambda m: m.data if m.sequence != 700 else number(1e308)), [READING], "beyond 1e+100"),
}  # fmt: skip


@pytest.mark.parametrize("kind", SERIALIZED)
def test_serializations(messages, true, tmp_path, capsys, kind):
    change, only, words = SERIALIZED[kind]
    if words.startswith("part: h") and "two" in words or "each fifth" in kind:
        # Of half or a fifth of the readings the indices are other ones; what is read and what not is said.
        status, _, said = analyzed(library(tmp_path / "a.mcap", messages, change, only), capsys)
        assert status == 0 and words.removeprefix("part: ") in said
        return
    check(library(tmp_path / "a.mcap", messages, change, only), capsys, true, words)


# A6: recovery


def files(bag):
    return sorted(path for path in bag.iterdir() if path.suffix in (".mcap", ".db3"))


def replaced(content):
    return lambda bag: files(bag)[1].write_bytes(content)


def edited(change):
    return lambda bag: files(bag)[1].write_bytes(change(files(bag)[1].read_bytes()))


def described(change):
    def harm(bag):
        file = bag / "metadata.yaml"
        file.write_bytes(change(file.read_bytes()))

    return harm


def chunks(change):
    """One chunk's header, from its length on, changed by ``change``."""

    def harm(data):
        at, found = 8, bytearray(data)
        while found[at] != 6:
            at += 9 + int.from_bytes(found[at + 1 : at + 9], "little")
        change(memoryview(found)[at + 9 :])
        return bytes(found)

    return edited(harm)


def wrong_checksum(header):
    header[24:28] = bytes(byte ^ 0x5A for byte in header[24:28])


def wrong_size(header):
    header[16:24] = (10**15).to_bytes(8, "little")


def log_left(bag):
    with closing(sqlite3.connect(files(bag)[1])) as database:
        database.execute("PRAGMA journal_mode=wal")
        database.execute("PRAGMA wal_autocheckpoint=0")
        database.execute("CREATE TABLE other(a)")
        database.commit()
        side = files(bag)[1].with_name(files(bag)[1].name + "-wal")
        left = side.read_bytes()
    side.write_bytes(left)


def named_anew(bag):
    names = ["a b", "ü", "-x", "#", "é%20", "z"]
    for path, name in zip(files(bag), names, strict=True):
        path.rename(path.with_name(name + path.suffix))
    (bag / "metadata.yaml").unlink()


def of_another_storage(bag):
    (bag / "other.db3").write_bytes(b"SQLite format 3\0" + bytes(4080))


def a_folder(bag):
    (bag / "metadata.yaml").unlink()
    (bag / "metadata.yaml").mkdir()


def a_circle(bag):
    path = files(bag)[1]
    path.unlink()
    path.symlink_to(path.name)


def on_its_way(bag):
    files(bag)[1].rename(f"{files(bag)[1]}.part")


HARM = {  # storage, harm, words of a refusal or readings that must be left
    "a wrong checksum": ("mcap", chunks(wrong_checksum), 1500),
    "a chunk of 1e15 bytes": ("mcap", chunks(wrong_size), 1200),
    "a pointer in the middle": ("mcap", replaced(LFS), "git lfs pull"),
    "a pointer with other line ends": ("mcap", replaced(LFS.replace(b"\n", b"\r\n")), "git lfs pull"),
    "a pointer with a mark of UTF-8": ("sqlite3", replaced(b"\xef\xbb\xbf" + LFS), "git lfs pull"),
    "a page of a server": ("mcap", replaced(b"\n<!DOCTYPE html><html>Sign in</html>"), "web server"),
    "on its way": ("mcap", on_its_way, "finish its transfer"),
    "zeros": ("mcap", edited(lambda data: bytes(len(data))), 1199),
    "one file of no byte": ("mcap", replaced(b""), 1199),
    "text before the beginning": ("mcap", edited(lambda data: b"HTTP/1.1 200 OK\r\n\r\n" + data), 1500),
    "text behind the end": ("mcap", edited(lambda data: data + b"garbage" * 100), 1500),
    "without its last bytes": ("mcap", edited(lambda data: data[:-8]), 1500),
    "a page size that is none": (
        "sqlite3", edited(lambda data: data[:16] + b"\0\7" + data[18:]), 1500),
    "a log of the database": ("sqlite3", log_left, 1500),
    "strange names": ("mcap", named_anew, 1500),
    "a file of the other storage": ("mcap", of_another_storage, "files of one storage"),
    "a folder for metadata": ("mcap", a_folder, "Is a directory"),
    "a link to itself": ("mcap", a_circle, "does not exist"),
    "a hard link": ("mcap", lambda bag: os.link(files(bag)[1], bag / "again.mcap"), 1500),
    "a copy in a folder of its own": (
        "mcap", lambda bag: shutil.copytree(bag, bag / "copy", ignore=lambda *_: ["copy"]), 1500),
    "metadata from another system": (
        "mcap", described(lambda text: b"\xef\xbb\xbf" + text.replace(b"\n", b"\r\n")), 1500),
    "metadata in Latin-1": ("mcap", described(lambda text: text.replace(b"jazzy", b"j\xe4zzy")), 1500),
    "counts of 1e12": (
        "mcap", described(lambda text: text.replace(b"message_count: ", b"message_count: 99999999")), 1500),
    "a duration below 0": (
        "mcap", described(lambda text: text.replace(b"nanoseconds: 1", b"nanoseconds: -1")), 1500),
    "paths of another machine": (
        "mcap", described(lambda text: text.replace(b"- bag_", b"- /data/bag_")), 1500),
}  # fmt: skip


def digests(bag):
    return {hashlib.sha256(path.read_bytes()).digest() for path in bag.iterdir() if path.is_file()}


@pytest.mark.parametrize("kind", HARM)
def test_recovery_does_no_harm(messages, tmp_path, capsys, kind):
    """A refusal touches nothing; else no readable reading is lost, and a second time nothing is done."""
    storage, harm, expected = HARM[kind]
    bag = in_file_order(tmp_path / "bag", messages, storage, max_seconds=0.3)
    harm(bag)
    _, valve, before = analyzed(bag, capsys)
    readable = valve["timing"]["spool_position"]["messages"]
    content = digests(bag)

    def recovered():
        try:
            status = main(["bag", "recover", str(bag)])
        except SystemExit as error:
            return 2, str(error.code)
        return status, "".join(capsys.readouterr())

    status, said = recovered()
    if isinstance(expected, str):
        assert status == 2 and expected in said
        assert digests(bag) == content
        assert "recover writes" not in before
        return
    assert status == 0, said
    _, valve, _ = analyzed(bag, capsys)
    assert valve["timing"]["spool_position"]["messages"] >= max(readable, expected)
    assert "nothing was done" in recovered()[1]
    assert analyzed(bag, capsys)[1]["timing"] == valve["timing"]
