# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of numbers, text and MATLAB files, read as bags: the same run as a bag is the reference."""

import matio
import numpy as np
import pytest
from asammdf import MDF, Signal
from hypothesis import given, settings
from hypothesis import strategies as st
from made import Run, write
from matio.utils import matclass
from scipy.io import savemat

from valve_control.recordings.bags import logs
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.recording import align, load

PLAIN = ["spool_command=command", "spool_position=lvdt", "valve_voltage=u"]


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    run = Run()
    run.move(900)
    valve = load(write(tmp_path_factory.mktemp("reference") / "bag", run.messages)).valves["valve"]
    return align(valve)


def rows(reference):
    """Time [s], command, reading and voltage [V] of each sample, from an odd zero."""
    time = 12.5 + np.arange(len(reference.time)) * 1e-3
    return np.column_stack([time, reference.command, reference.measurement, reference.voltage])


def text(table, separator=",", comma=False, form="%.17g"):
    lines = [separator.join(form % number for number in row) for row in table.tolist()]
    return "\n".join(line.replace(".", ",") if comma else line for line in lines) + "\n"


HEADER = "time_s,command,lvdt,u\n"
SCOPE = """Name\tvalve
File\tvalve.csv
Starttime of export\t132959733843760000\tMontag, 2. Mai 2022\t15:56:24.376

Name\tcommand\tName\tlvdt\tu
SymbolComment\t\tSymbolComment\t\t
Data-Type\tREAL64\tData-Type\tREAL32\tINT16
SampleTime[ms]\t10\tSampleTime[ms]\t1\t1
Port\t851\tPort\t851\t851
Unit\tmV (Voltage)\tUnit\tV (Voltage)\t(None)
Unit Offset\t0\tUnit Offset\t0\t0

"""  # of TwinCAT: two columns of times, that of the second channel is also that of the third
LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Multi_Headings\tYes
X_Columns\tOne
Date\t2016/08/23
Time\t10:45:47.0352557312499836422
***End_of_Header***\t
\t
Channels\t3
Samples\t900\t900\t900\t
Y_Unit_Label\tmV\tVolts\tVolts\t
X_Dimension\tTime\tTime\tTime\t
X0\t0.0000000000000000E+0\t0.0\t0.0\t
Delta_X\t0.001\t0.001\t0.001\t
***End_of_Header***\t\t\t\t
X_Value\tcommand\tlvdt\tu\tComment
"""


def scope(table, every=1):
    """TwinCAT's export, whose slower channel ends before the others; the command in mV."""
    lines = []
    for k, (time, _, reading, voltage) in enumerate(table.tolist()):
        slow = ["", ""]
        if k * every < len(table):
            slow = [f"{1e3 * table[k * every, 0]:.17g}", f"{1e3 * table[k * every, 1]:.17g}"]
        lines.append("\t".join([*slow, f"{1e3 * time:.17g}", f"{reading:.17g}", f"{voltage:.17g}"]))
    return SCOPE + "\n".join(lines) + "\nEOF\n"


def dated(table, stamp, separator=","):
    """The table with dates in place of times; ``stamp``: text of seconds after ten o'clock."""
    lines = text(table[:, 1:], separator, separator == ";").splitlines()
    return "".join(f"{stamp(t)}{separator}{line}\n" for t, line in zip(table[:, 0], lines, strict=True))


TEXTS = {
    "plain": (lambda t: HEADER + text(t), PLAIN),
    "semicolons and decimal commas, as a German spreadsheet": (
        lambda t: "sep=;\r\n" + "Zeit [s];Soll;Weg;U\r\n" + text(t, ";", True).replace("\n", "\r\n"),
        ["spool_command=Soll", "spool_position=Weg", "valve_voltage=U"],
    ),
    "tabs, no header, milliseconds": (
        lambda t: text(t * [1e3, 1, 1, 1], "\t"),
        ["time=1*0.001", "spool_command=2", "spool_position=3", "valve_voltage=4"],
    ),
    "spaces, a remark as header": (
        lambda t: "% logged by hand\n#\n# time command lvdt u\n" + text(t, "  "),
        PLAIN,
    ),
    "spaces and decimal commas": (
        lambda t: "t c y u\n" + text(t, " ", True),
        ["spool_command=c", "spool_position=y", "valve_voltage=u"],
    ),
    "units in brackets below the names": (
        lambda t: HEADER.replace("time_s", "t") + "[ms],[mV],[mV],[µV]\n" + text(t * [1e3, 1e3, 1e3, 1e6]),
        PLAIN,
    ),
    "bare units below the names": (
        lambda t: "t;command;lvdt;u\nms;V;mV;V\n" + text(t * [1e3, 1, 1e3, 1], ";", True),
        PLAIN,
    ),
    "units behind the names": (
        lambda t: "Zeit [ms]\tcommand (mV)\tlvdt [V]\tu [kV]\n" + text(t * [1e3, 1e3, 1, 1e-3], "\t"),
        PLAIN,
    ),
    "TwinCAT Scope": (scope, PLAIN),
    "LabVIEW with a remark": (
        lambda t: LABVIEW + text(t * [1, 1e3, 1, 1], "\t").replace("\n", "\tLOST\n", 1),
        PLAIN,
    ),
    "LabVIEW without times": (
        lambda t: (
            LABVIEW.replace("One", "No") + "\t" + text(t[:, 1:] * [1e3, 1, 1], "\t").replace("\n", "\n\t")
        ),
        PLAIN,
    ),
    "LabVIEW with a time for each channel, decimal commas": (
        lambda t: (
            LABVIEW.replace("mV", "")
            .replace("\tVolts", "")
            .replace("command\tlvdt", "command\tX_Value\tlvdt")
            .replace("lvdt\tu", "lvdt\tX_Value\tu")
            + text(t[:, [0, 1, 0, 2, 0, 3]], "\t", True)
        ),
        PLAIN,
    ),
    "date and time, ISO": (
        lambda t: "when,command,lvdt,u\n" + dated(t, lambda s: f"2026-11-27T10:00:{s:09.6f}Z"),
        PLAIN,
    ),
    "date and time in one column, German": (
        lambda t: (
            "Zeit;command;lvdt;u\n"
            + dated(t, lambda s: f"27.11.2026 10:00:{s:06.3f}".replace(".", ",").replace(",", ".", 2), ";")
        ),
        PLAIN,
    ),
    "date and time in two columns": (
        lambda t: (
            "Datum;Uhrzeit;command;lvdt;u\n"
            + dated(t, lambda s: f"05.02.2009;13:08:{s:06.3f}".replace(":12.", ":12,"), ";")
        ),
        PLAIN,
    ),
    "time of day over midnight": (
        lambda t: (
            "Time\tcommand\tlvdt\tu\n"
            + dated(
                t,
                lambda s: f"{23 if s < 13 else 0:02d}:{59 if s < 13 else 0:02d}:{(s + 47) % 60:06.3f}",
                "\t",
            )
        ),
        PLAIN,
    ),
    "sample period": (lambda t: "command,lvdt,u\n" + text(t[:, 1:]), [*PLAIN, "time=row*0.001+3"]),
    "milliampere with offset": (
        lambda t: (
            "time_s,command,lvdt_mA,u\n" + text(np.column_stack([t[:, :2], (t[:, 2] + 15) / 1.25, t[:, 3]]))
        ),
        ["spool_command=command", "spool_position=lvdt_mA*1.25-15", "valve_voltage=u"],
    ),
    "head of an oscilloscope, units below the names": (
        lambda t: "Model,DPO2014\nInterval,0.001\n\nTime,Ch A,Ch B,Ch C\n(s),(V),(V),(V)\n\n" + text(t),
        ["spool_command=Ch A", "spool_position=Ch B", "valve_voltage=Ch C"],
    ),
    "names with the signs of scales and topics, quoted": (
        lambda t: 'time,"cmd, wanted",a*b-2.x,/boom/u [V]\n' + text(t),
        ["spool_command=cmd, wanted", "spool_position=a*b-2.x", "valve_voltage=/boom/u [V]*1"],
    ),
    "text beside the numbers, commas at the ends": (
        lambda t: (
            "clock,time_s,command,lvdt,u,\n"
            + "".join(f"2026-11-27 10:00:00,{line},\n" for line in text(t).splitlines())
        ),
        PLAIN,
    ),
    "first rows almost empty, a remark among them": (
        lambda t: HEADER + "-0.002,,,\n# armed\n-0.001,,,\n" + text(t),
        PLAIN,
    ),
    "UTF-16 of a spreadsheet": (lambda t: "\ufeff" + HEADER.replace(",", "\t") + text(t, "\t"), PLAIN),
    "a mark of the byte order, a name with a degree sign": (
        lambda t: "\ufefftime_s,command,lvdt,u,T [°C]\n" + text(np.column_stack([t, t[:, 0]])),
        PLAIN,
    ),
}


@pytest.mark.parametrize("kind", TEXTS)
def test_a_text_gives_the_signals_of_the_bag(tmp_path, reference, kind):
    make, maps = TEXTS[kind]
    path = tmp_path / "log.csv"
    path.write_bytes(make(rows(reference)).encode("utf-16-le" if "UTF-16" in kind else "utf-8"))
    same(path, maps, reference, 1e-12)


def same(path, maps, reference, tolerance=0.0):
    """That the table ``path`` is the run that the reference is."""
    valve = load(path, maps).valves["valve"]
    found = align(valve)
    for name in ("command", "measurement", "voltage"):
        assert np.allclose(getattr(found, name), getattr(reference, name), rtol=0.0, atol=tolerance), name
    assert np.allclose(found.time, np.arange(len(reference.time)) * 1e-3, atol=2e-9)
    assert len(found.latency) == 0 and found.unanswered is None
    return valve


MATLAB = {
    "vectors": (
        lambda t: {"t": t[:, 0], "command": t[:, 1], "lvdt": t[:, 2], "u": t[:, 3], "Ts": 1e-3, "note": "x"},
        PLAIN,
    ),
    "a matrix": (
        lambda t: {"data": t},
        ["time=data(:,1)", "spool_command=data(:,2)", "spool_position=data(:,3)", "valve_voltage=4"],
    ),
    "a structure, as Simulink saves it": (
        lambda t: {
            "out": {
                "time": t[:, 0],
                "signals": [{"values": t[:, k], "label": "s"} for k in (1, 2, 3)],
            },
        },
        [
            "time=out.time",
            "spool_command=out.signals(1).values",
            "spool_position=out.signals(2).values",
            "valve_voltage=out.signals(3).values",
        ],
    ),
    "integers of a converter": (
        lambda t: {"k": np.arange(len(t), dtype=np.uint16), "c": t[:, 1], "y": t[:, 2], "u": t[:, 3]},
        ["time=k*1e-3", "spool_command=c", "spool_position=y", "valve_voltage=u"],
    ),
}


@pytest.mark.parametrize("kind", MATLAB)
def test_a_matlab_file_gives_the_signals_of_the_bag(tmp_path, reference, kind):
    make, maps = MATLAB[kind]
    savemat(tmp_path / "log.mat", make(rows(reference)))
    same(tmp_path / "log.mat", maps, reference)


@pytest.mark.parametrize("every", [2, 5, 10])
def test_each_channel_of_twincat_has_its_own_time(tmp_path, reference, every):
    """A slower command is held; by the rows it would be that of another time."""
    (tmp_path / "scope.csv").write_text(scope(rows(reference), every))
    recording = load(tmp_path / "scope.csv", PLAIN)
    found = align(recording.valves["valve"])
    held = np.repeat(reference.command[::every], every)[: len(reference.time)]
    assert np.allclose(found.command, held, rtol=0.0, atol=1e-12)
    assert np.array_equal(found.measurement, reference.measurement)
    assert np.array_equal(found.voltage, reference.voltage)
    assert not any("empty" in note for note in recording.problems)


def series(name, table, column, uniform=False):
    """A timeseries as Simulink saves it; with a uniform time there is but its beginning and step."""
    times = {"Time_": np.empty((0, 0)) if uniform else table[:, :1]}
    info = {
        "Start_": table[:1, :1],
        "Increment_": np.array([[1e-3]]),
        "Length": np.array([[float(len(table))]]),
    }
    data = {
        "Name": name,
        "Data_": table[:, column].reshape(1, 1, -1),
        "TimeInfo": opaque(info, "tsdata.timemetadata"),
    }
    return opaque({**times, **data}, "timeseries")


def opaque(properties, name):
    return matclass.MatlabOpaque(properties, name)


def dataset(table):
    """A Simulink Dataset of signals, one of them with a uniform time."""
    elements = np.empty((1, 3), dtype=object)
    for k, name in enumerate(("command", "lvdt", "u")):
        values = series("", table, k + 1, k == 1)
        elements[0, k] = opaque({"Name": name, "Values": values}, "Simulink.SimulationData.Signal")
    storage = opaque({"Elements": elements}, "Simulink.SimulationData.Storage.RamDatasetStorage")
    return opaque({"Name": "logsout", "Storage_": storage}, "Simulink.SimulationData.Dataset")


OBJECTS = {
    "timeseries": lambda t: {name: series(name, t, k) for k, name in enumerate(("command", "lvdt", "u"), 1)},
    "dataset": lambda t: {"logsout": dataset(t)},
    "vectors": lambda t: {"time": t[:, :1], "command": t[:, 1:2], "lvdt": t[:, 2:3], "u": t[:, 3:]},
    "ControlDesk": lambda t: {
        "rec": {
            "Time": t[:, :1],
            "Y": np.array(
                [(name, t[:, k : k + 1]) for k, name in enumerate(("command", "lvdt", "u"), 1)],
                dtype=[("Name", object), ("Data", object)],
            ).reshape(1, 3),
        }
    },
}


@pytest.mark.parametrize("version", ["v7", "v7.3"])
@pytest.mark.parametrize("kind", OBJECTS)
def test_signals_of_matlab_are_found_by_name(tmp_path, reference, kind, version):
    matio.save_to_mat(str(tmp_path / "log.mat"), OBJECTS[kind](rows(reference)), version=version)
    same(tmp_path / "log.mat", PLAIN, reference)


@pytest.mark.parametrize("every", [1, 5, 10])
def test_an_mdf_file_gives_the_signals_of_the_bag(tmp_path, reference, every):
    """A group of channels for each rate; one signal in mV."""
    time, command, reading, voltage = rows(reference).T
    with MDF() as file:
        file.append(
            [Signal(1e3 * reading, time, name="lvdt", unit="mV"), Signal(voltage, time, name="u", unit="V")]
        )
        file.append([Signal(command[::every], time[::every], name="command", unit="V")])
        file.save(tmp_path / "log.mf4")
    found = align(load(tmp_path / "log.mf4", PLAIN).valves["valve"])
    assert np.allclose(found.measurement, reference.measurement, rtol=0.0, atol=1e-12)
    assert np.array_equal(found.voltage, reference.voltage)
    held = np.repeat(reference.command[::every], every)[: len(reference.time)]
    assert np.array_equal(found.command, held)


def test_what_an_extra_reads_is_said_without_it(tmp_path, reference, monkeypatch):
    table = rows(reference)
    matio.save_to_mat(str(tmp_path / "new.mat"), {"time": table[:, :1]}, version="v7.3")
    (tmp_path / "log.mf4").write_bytes(b"MDF     4.10")
    mixed = {**OBJECTS["vectors"](table), "logsout": dataset(table)}
    matio.save_to_mat(str(tmp_path / "log.mat"), mixed, version="v7")
    monkeypatch.setattr(logs, "find_spec", lambda name: None)
    for name in ("new.mat", "log.mf4"):
        with pytest.raises(BagError, match=r"needs? the extra logs"):
            load(tmp_path / name, PLAIN)
    valve = same(tmp_path / "log.mat", PLAIN, reference)
    assert valve and any("extra logs" in note for note in load(tmp_path / "log.mat", PLAIN).problems)


@pytest.mark.parametrize(("first", "count"), [(200, 60), (300, 300), (700, 10)])
def test_rows_that_are_missing_are_told(tmp_path, reference, first, count):
    table = np.delete(rows(reference), slice(first, first + count), axis=0)
    (tmp_path / "t.csv").write_text(HEADER + text(table))
    note = f"the first from row {first} to row {first + 1}, by {(count + 1) * 1e-3:.4g} s: rows are missing"
    assert any(note in problem for problem in load(tmp_path / "t.csv", PLAIN).problems)


def test_a_group_that_is_not_used_costs_nothing(tmp_path, reference):
    """A group of one sample has no period; only what needs it is refused."""
    time, _, reading, voltage = rows(reference).T
    with MDF() as file:
        file.append([Signal(reading, time, name="lvdt"), Signal(voltage, time, name="u")])
        file.append([Signal(np.ones(1), time[:1], name="start")])
        file.save(tmp_path / "log.mf4")
    assert len(align(load(tmp_path / "log.mf4", PLAIN[1:]).valves["valve"]).time) == len(time)
    with pytest.raises(BagError, match="has 1 row"):
        load(tmp_path / "log.mf4", [*PLAIN[1:], "spool_command=start"])


def test_units_are_told_where_they_are_not_known(tmp_path, reference):
    for scale, units, note in (
        (1.0, "", "no column has a unit: all count as V"),
        (1e3, "", "the rows are 1 s apart; if this is ms: --map time=COLUMN*0.001"),
        (1e3, "", "lvdt goes to 1979 V; map lvdt*0.001 if it is in mV, lvdt@% if in %"),
        (1.0, "[s],[V],[bar],[V]\n", "lvdt in bar counts as V without @%, @4..20mA or *FACTOR"),
        (1.0, "s,V,mA,V\n", "lvdt in mA counts as V without @%, @4..20mA or *FACTOR"),
    ):
        (tmp_path / "t.csv").write_text(HEADER + units + text(scale * rows(reference)))
        assert note in load(tmp_path / "t.csv", PLAIN).problems


@pytest.mark.parametrize(
    ("end", "note"),
    [
        ("EOF\n", "line 902, the last one, has 1 of 4 entries and is left out"),
        ("13.4,0.1", "line 902, the last one, has 2 of 4 entries and is left out"),
        (",,,\n,,,\n", "2 empty rows are left out"),
    ],
)
def test_the_end_of_a_log_that_is_no_row_is_left_out(tmp_path, reference, end, note):
    (tmp_path / "t.csv").write_text(HEADER + text(rows(reference)) + end)
    same(tmp_path / "t.csv", PLAIN, reference, 1e-12)
    assert note in load(tmp_path / "t.csv", PLAIN).problems


def test_a_coarse_time_keeps_the_rows_together(tmp_path, reference):
    """Ten rows have one stamp, and the command stands behind the reading."""
    table = rows(reference)
    table[:, 0] = np.round(table[:, 0], 2)
    path = tmp_path / "log.csv"
    path.write_text("time_s,lvdt,u,command\n" + text(table[:, [0, 2, 3, 1]]))
    found = align(load(path, PLAIN).valves["valve"])
    count = len(reference.time)
    assert count - 25 < len(found.time) <= count
    first = count - len(found.time)
    assert np.array_equal(found.measurement, reference.measurement[first:])
    assert np.array_equal(found.command, reference.command[first:])
    assert np.array_equal(found.voltage[:-1], reference.voltage[first:-1])


def test_another_column_shows_that_commas_separate_decimals(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t [ms];U [V];LVDT [mA]\n0;0,000;12,000\n1;1,250;12,004\n2;2,500;12,008\n")
    voltage, current = (column.values for column in logs.read(path, [])[1:])
    assert voltage.tolist() == [0.0, 1.25, 2.5] and current.tolist() == [12.0, 12.004, 12.008]


def test_empty_cells_are_no_messages(tmp_path, reference):
    """A command that a logger writes at 100 Hz is held between its rows."""
    table = rows(reference)
    lines = [
        f"{t:.17g},{c if k % 10 == 0 else ''},{y:.17g},{u:.17g}"
        for k, (t, c, y, u) in enumerate(table.tolist())
    ]
    path = tmp_path / "log.csv"
    path.write_text(HEADER + "\n".join(lines))
    recording = load(path, PLAIN)
    found = align(recording.valves["valve"])
    assert np.array_equal(found.command, np.repeat(reference.command[::10], 10)[: len(found.command)])
    assert any("command is empty in 810 of 900 rows" in note for note in recording.problems)


GOOD = HEADER + "0,0,0,0\n0.001,0,1,0\n0.002,0,2,0\n"
REFUSED = {
    "no such column": (
        GOOD,
        ["spool_position=lvdt_mA*2"],
        "has no column lvdt_mA; it has time_s, command, lvdt, u",
    ),
    "no number": (GOOD.replace("0.001,0,1", "0.001,0,one"), PLAIN, "column lvdt holds 'one' in line 3"),
    "a ragged row": (GOOD + "0.003,0,1\n0.004,0,1,0\n", PLAIN, "line 5 has 3 entries, line 2 has 4"),
    "time that runs backwards": (
        GOOD + "0.001,0,1,0\n",
        PLAIN,
        "backwards from row 3 to row 4, from 0.002 to 0.001",
    ),
    "a time that is missing": (GOOD + ",0,1,0\n", PLAIN, "no time in row 4"),
    "time without its factor": (
        "stamp,y\n1790000000000000000,1\n1790000000001000000,2\n",
        ["spool_position=y"],
        "1e-9",
    ),
    "a time that counts": (
        "Time,y\n1,1\n2,2\n3,3\n",
        ["spool_position=y"],
        "column Time counts 1, 2, 3 without a unit; give the time of a step: --map time=Time*0.001",
    ),
    "a day that does not exist": (
        "when;y\n31.02.2026 10:00:00;1\n31.02.2026 10:00:01;2\n",
        ["time=when", "spool_position=y"],
        "column when holds '31.02.2026 10:00:00' in line 2",
    ),
    "several times": ("t,time,y\n1,2,3\n3,4,3\n", ["spool_position=y"], "t, time may be times"),
    "two columns of one name": (
        "time,y,y\n0,1,2\n1,1,2\n",
        ["spool_position=y"],
        "2 columns y; take one by its number",
    ),
    "no numbers": ("a,b\nc,d\n", PLAIN, "no table of numbers"),
    "commas that may be thousands": (
        "time\ty\n0\t1,250\n1\t1,350\n",
        ["spool_position=y"],
        "decimals or thousands",
    ),
    "a comma among points": ("time\ty\n0.5\t1.25\n1.5\t1,35\n", ["spool_position=y"], "with a comma where"),
    "no text": (b"time,y\n\0\0\0", PLAIN, "no table of numbers"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_table_that_cannot_be_used_is_refused_in_one_sentence(tmp_path, kind):
    content, maps, words = REFUSED[kind]
    path = tmp_path / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(BagError) as caught:
        load(path, maps)
    said = str(caught.value)
    assert words in said and "\n" not in said and (str(path) in said or said.startswith("--map "))


def test_matlab_files_that_cannot_be_used(tmp_path):
    hdf5 = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\x02IM" + b"\x89HDF\r\n\x1a\n"
    torn = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\x01IM" + b"\x0f\0\0\0\xff\0\0\0abc"
    words, unknown = b"time,y\n1,2\n" * 20, "is not a MATLAB file"
    for content, reason in ((hdf5, "cannot be read"), (torn, unknown), (words, unknown)):
        (tmp_path / "log.mat").write_bytes(content)
        with pytest.raises(BagError, match=reason):
            load(tmp_path / "log.mat", PLAIN)
    savemat(tmp_path / "none.mat", {"Ts": 1.0, "name": "valve"})
    with pytest.raises(BagError, match=r"has no vector of numbers; it has Ts \(float\), name \(str\)"):
        load(tmp_path / "none.mat", PLAIN)
    savemat(
        tmp_path / "lengths.mat", {"time": np.arange(5.0) / 9, "y": np.arange(4.0), "c": np.arange(5.0) * 1j}
    )
    for column, words in (("y", "4 rows and the time 5"), ("c", "complex")):
        with pytest.raises(BagError, match=words):
            load(tmp_path / "lengths.mat", [f"spool_position={column}"])


numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)


@settings(max_examples=80, deadline=None)
@given(
    table=st.integers(2, 4).flatmap(
        lambda n: st.lists(st.lists(numbers, min_size=n, max_size=n), min_size=2)
    ),
    separator=st.sampled_from([";", "\t", ",", " "]),
    comma=st.booleans(),
    header=st.booleans(),
)
def test_any_table_comes_back_or_is_doubted(tmp_path_factory, table, separator, comma, header):
    """Never another number than the one that was written."""
    comma = comma and separator != ","
    path = tmp_path_factory.getbasetemp() / "any.csv"
    names = separator.join("abcd"[: len(table[0])]) + "\n" if header else ""
    path.write_text(names + text(np.array(table), separator, comma))
    found = logs.read(path, [])
    assert len(found) == len(table[0])
    for column, wanted in zip(found, np.array(table).T, strict=True):
        assert column.flaw or np.array_equal(column.values, wanted)
        assert not column.flaw or (comma and "thousands" in column.flaw)
