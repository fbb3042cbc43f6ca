# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""``valve-control export --watch``: the supervisor's watch in C, through faults, bit for bit."""

import re
import shutil
import subprocess

import changed
import pytest
from driven import SANITIZERS
from grids import grid

from valve_control.export import folder, sources, unit

SANITIZED = f"CFLAGS={sources.FLAGS} {folder.WARNINGS} {' '.join(SANITIZERS)}"
compiles = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


def supervised(**changes):
    return unit.supervised(changed.controller(**changes))


def check(place, *words):
    return subprocess.run(["make", "-C", place, "clean", "check", *words], capture_output=True, text=True)


@compiles
def test_the_contract(run, tmp_path):
    status, out, err = run("export", "--controller", "oarc", "--watch", "--output", "made")
    assert (status, err) == (0, "") and out.startswith("wrote made/ with oarc.h, oarc.c, check.csv, Makefile")
    place = tmp_path / "made"
    text, header = (place / "oarc.c").read_text(), (place / "oarc.h").read_text()
    assert "malloc" not in text and set(re.findall("#include (.*)", text)) == {
        "<float.h>",  # of constants alone, for the guards
        "<math.h>",
        '"oarc.h"',
    }
    assert "`oarc_watch_sample(&oarc_exported, &state, reading, 0)`" in (place / "README.md").read_text()
    assert "bool oarc_set_lvdt_limit(oarc_watch_params_t *p, double value);" in header
    assert "OARC_LVDT_DISAGREES" in header and "OARC_LIMIT_CYCLE" in header and "OARC_LVDT_HUM" in header
    rows = (place / "check.csv").read_text().splitlines()
    assert {row.split(",")[0] for row in rows[1:]} == {
        *("sample", "command", "at", "point", "unpoint", "gone", "silence", "reset")
    }
    done = check(place)
    assert done.returncode == 0 and f"{len(rows) - 1} rows equal to the last bit" in done.stdout, done.stderr
    # The comparison can fail: one bit of the tachometer is enough. Nothing is undefined on the way there.
    before, smoothing, after = re.split(r"(\.tachometer = \{[^}]*\.smoothing = 0x1\.\w+)(?=p)", text)
    (place / "oarc.c").write_text(before + smoothing[:-1] + ("0" if smoothing[-1] != "0" else "1") + after)
    done = check(place, SANITIZED)
    assert done.returncode != 0 and "rows differ" in done.stdout, done.stderr


CURVE = {
    "linearisation.enabled": "true",
    "linearisation.voltage": "[-10.0, -0.5, 0.32, 0.9, 10.0]",
    "linearisation.position": "[-8.9, -0.02, 0.02, 0.7, 10.4]",
    "linearisation.gain": "0.97",
}


@compiles
@grid("law, watch", ["pid", "dcarc"], [[], ["--watch"]], strength=1)
def test_the_inverse_of_a_curve_behind_a_law(run, tmp_path, law, watch):
    sets = [word for name, value in CURVE.items() for word in ("--set", f"{name}={value}")]
    status, _, err = run("export", "--controller", law, *watch, *sets, "--output", "made")
    assert (status, err) == (0, "")
    done = check(tmp_path / "made")
    assert done.returncode == 0 and "equal to the last bit" in done.stdout, done.stderr
    # The comparison can fail: one bit of a slope is enough. Nothing is undefined on the way there.
    text = (tmp_path / "made" / f"{law}.c").read_text()
    before, line, after = re.split(r"(\.inverse = \{[^}]*\}|\.line = \{[^}]*\})", text, maxsplit=1)
    changed_line = re.sub(r"0x1\.(\w+)p", lambda found: f"0x1.{'1' * len(found[1])}p", line)
    assert changed_line != line
    (tmp_path / "made" / f"{law}.c").write_text(before + changed_line + after)
    done = check(tmp_path / "made", SANITIZED)
    assert "rows differ" in done.stdout, done.stderr
