# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The folder that is handed over: sources, a recorded run, what compares them, Makefile and README."""

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from valve_control.export import compiler, samples, sources
from valve_control.export.settable import Settable
from valve_control.export.sources import FLAGS, Sources
from valve_control.export.unit import Unit
from valve_control.parameter import ParameterError

WARNINGS = "-Wall -Wextra -Wconversion -Wpedantic -Werror"


def refuse_taken(path: str) -> Path:
    """The folder or file ``path``, which must be new. Raises ParameterError."""
    if not path:
        raise ParameterError("--output has an empty name; give one that is not taken yet")
    folder = Path(os.path.abspath(path))
    if folder.exists() or folder.is_symlink():
        raise ParameterError(f"{path} exists; give a name that is not taken yet")
    if not folder.parent.is_dir():
        raise ParameterError(f"{path} cannot be made: there is no folder {folder.parent}")
    if not os.access(folder.parent, os.W_OK):
        raise ParameterError(f"{path} cannot be made: permission denied")
    return folder


def write(folder: Path, files: Mapping[str, str]) -> None:
    """Make ``folder`` with all ``files``, or nothing. Raises OSError and ParameterError."""
    try:
        folder.mkdir()
    except FileExistsError as error:
        raise ParameterError(f"{folder.name} was made by another program meanwhile") from error
    try:
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
    except BaseException:  # Ctrl-C too
        shutil.rmtree(folder, ignore_errors=True)
        raise


def files(unit: Unit, single: bool = False, found: Settable | None = None) -> dict[str, str]:
    """Contents of the folder by file name; ``single`` and ``found`` as of ``sources.make``.

    Raises ParameterError.
    """
    made = sources.make(unit, single, found)
    rows = samples.run(unit, made.words)
    if not rows:
        raise ParameterError(f"{unit.name} produces NaN or infinity in its first sample")
    table = {
        f"{unit.name}.h": made.header,
        f"{unit.name}.c": made.source,
        "check.csv": samples.as_csv(rows),
        "Makefile": makefile(unit.name),
    }
    largest = 0.0
    if single:
        largest = measured(unit, table, check(unit, made, 0.0, single))
    table["check.c"] = check(unit, made, largest, single)
    table["README.md"] = readme(unit, made, len(rows), largest, single)
    return table


def measured(unit: Unit, table: dict[str, str], program: str) -> float:
    """Largest difference [V] of float from the recorded result, rounded up. Raises ParameterError."""
    with tempfile.TemporaryDirectory(prefix="valve_control-export-") as name:
        folder = Path(name)
        for file, text in {**table, "check.c": program}.items():
            (folder / file).write_text(text, encoding="utf-8")
        compiler.build([folder / "check.c", folder / f"{unit.name}.c"], folder / "check", [])
        said = compiler.run([str(folder / "check"), str(folder / "check.csv"), "--difference"])
    return float(f"{1.05 * float(said):.1e}")


def makefile(name: str) -> str:
    """Makefile with the targets check and clean."""
    return f"""# make check compiles and compares with check.csv; CC=clang and other CFLAGS may be given.
CFLAGS = {FLAGS} {WARNINGS}

check: check_{name}
\t./check_{name} check.csv

check_{name}: check.c {name}.c {name}.h Makefile
\t$(CC) $(CFLAGS) -o $@ check.c {name}.c -lm

{name}.o: {name}.c {name}.h Makefile
\t$(CC) $(CFLAGS) -c -o $@ {name}.c

size: {name}.o
\tsize {name}.o

clean:
\trm -f check_{name} {name}.o

.PHONY: check size clean
"""


def check(unit: Unit, made: Sources, largest: float, single: bool) -> str:
    """C program that reads check.csv and compares; ``largest``: difference [V] that float may have."""
    name = unit.name
    real = "float" if single else "double"
    paths = sources.state_numbers(unit)
    numbers = ", ".join(paths)
    memory = f"    static {real} memory[{name.upper()}_MEMORY];\n" if made.memory else ""
    if unit.inner is not None:
        begin, calls = f"    {name}_watch_init(&state);\n", _WATCH_CALLS
        again = f"{name}_watch_sample(&{name}_exported, &state, row->given[0], 0)"
    elif unit.is_law:
        begin, calls = "", _LAW_CALLS
        again = f"{name}_step(&{name}_exported, &state, row->given[0], row->given[1], row->given[2], 0)"
    else:
        begin = f"    {name}_init(&state{', memory' if made.memory else ''});\n"
        calls = _PLANT_CALLS
        again = f"({name}_step(&{name}_exported, &state, row->given[0]), {paths[-1]})"
    equal = (
        "fabs((double)found - row->result) <= LARGEST"
        if single
        else "same(found, row->result) && digest(numbers, sizeof numbers / sizeof numbers[0]) == row->state"
    )
    text = _CHECK
    for word, value in {
        "@CALLS@": calls,
        "@NAME@": name,
        "@REAL@": real,
        "@LARGEST@": largest.hex(),
        "@NUMBERS@": numbers,
        "@MEMORY@": memory,
        "@KIND@": f"{name}_watch" if unit.inner is not None else name,
        "@BEGIN@": begin,
        "@AGAIN@": again.replace("row->given", f"({real})row->given" if single else "row->given"),
        "@EQUAL@": equal,
        "@WITHIN@": 'within %.3g V", count, LARGEST' if single else 'equal to the last bit", count',
        "@CAST@": "(float)" if single else "",
        "@DIGEST@": "" if single else _DIGEST,
        "@STATE@": "" if single else f"        const double numbers[] = {{{numbers}}};\n",
    }.items():
        text = text.replace(word, value)
    return text


_LAW_CALLS = """        if (row->event[0] == 'i') {
            const @START@ start = {@CAST@row->given[0], @CAST@row->given[1], @CAST@row->given[2],
                                   @CAST@row->given[3], @CAST@row->given[4]};
            @NAME@_init(&@NAME@_exported, &state, &start);
        } else if (row->event[0] == 'h') {
            @NAME@_hold(&@NAME@_exported, &state, @CAST@row->given[0], @CAST@row->given[1],
                        @CAST@row->given[2]);
        } else {
            found = @NAME@_step(&@NAME@_exported, &state, @CAST@row->given[0], @CAST@row->given[1],
                                @CAST@row->given[2], 0);
        }
""".replace("@START@", "@NAME@_signals_start_t")

_WATCH_CALLS = """        if (strncmp(row->event, "command", sizeof row->event) == 0)
            @NAME@_watch_command(&@NAME@_exported, &state, row->given[0]);
        else if (strncmp(row->event, "at", sizeof row->event) == 0)
            @NAME@_watch_command_at(&@NAME@_exported, &state, row->given[0], row->given[1], row->given[2]);
        else if (strncmp(row->event, "point", sizeof row->event) == 0)
            found = @NAME@_watch_trajectory(&@NAME@_exported, &state, row->given[0], row->given[1],
                                            row->given[2], row->given[3], row->given[4]);
        else if (strncmp(row->event, "unpoint", sizeof row->event) == 0)
            @NAME@_watch_trajectory_gone(&state);
        else if (strncmp(row->event, "gone", sizeof row->event) == 0)
            @NAME@_watch_command_gone(&state);
        else if (strncmp(row->event, "reset", sizeof row->event) == 0)
            @NAME@_watch_reset(&@NAME@_exported, &state);
        else if (strncmp(row->event, "silence", sizeof row->event) == 0)
            found = @NAME@_watch_silence(&@NAME@_exported, &state, row->given[0]);
        else
            found = @NAME@_watch_sample(&@NAME@_exported, &state, row->given[0], (int64_t)row->given[1]);
"""

_PLANT_CALLS = """        found = @NAME@_read(&@NAME@_exported, &state, @CAST@row->given[1]);
        @NAME@_step(&@NAME@_exported, &state, @CAST@row->given[0]);
"""

_DIGEST = """
static int same(double a, double b)
{
    return memcmp(&a, &b, sizeof a) == 0;
}

/* FNV-1a over words of doubles. */
static uint64_t digest(const double *numbers, size_t count)
{
    uint64_t value = 0xcbf29ce484222325u;
    for (size_t i = 0; i < count; i++) {
        uint64_t word;
        memcpy(&word, numbers + i, sizeof word);
        value = (value ^ word) * 0x100000001b3u;
    }
    return value;
}
"""

_CHECK = """/* Compares @NAME@.c with the run of its Python that is recorded in a CSV file. */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "@NAME@.h"

#define LARGEST @LARGEST@
#define ROWS 100000
#define TIMED 2000000

typedef struct {
    char event[8];
    double given[5], result;
    uint64_t state;
} row_t;

static row_t rows[ROWS];

static size_t read_rows(const char *path)
{
    char line[1000];
    size_t count = 0;
    FILE *file = fopen(path, "r");
    if (!file || !fgets(line, sizeof line, file)) {
        fprintf(stderr, "%s cannot be read\\n", path);
        exit(2);
    }
    while (count < ROWS && fgets(line, sizeof line, file)) {
        row_t *row = rows + count++;
        char *at = strchr(line, ',');
        size_t length = at ? (size_t)(at - line) : 0;
        memset(row->event, 0, sizeof row->event);
        memcpy(row->event, line, length < sizeof row->event ? length : sizeof row->event);
        for (int i = 0; i < 6 && at; i++) {
            double value = strtod(at + 1, &at);
            if (i < 5)
                row->given[i] = value;
            else
                row->result = value;
        }
        if (!at || *at != ',') {
            fprintf(stderr, "%s: row %zu is not complete\\n", path, count);
            exit(2);
        }
        row->state = strtoull(at + 1, 0, 16);
    }
    fclose(file);
    return count;
}
@DIGEST@
int main(int argc, char **argv)
{
@MEMORY@    @KIND@_state_t state;
    double largest = 0.0;
    size_t wrong = 0, count = read_rows(argc > 1 ? argv[1] : "check.csv");
    memset(&state, 0, sizeof state);
@BEGIN@    for (size_t k = 0; k < count; k++) {
        const row_t *row = rows + k;
        @REAL@ found = 0;
@CALLS@@STATE@        if (fabs((double)found - row->result) > largest)
            largest = fabs((double)found - row->result);
        if (!(@EQUAL@) && ++wrong == 1 && argc < 3)
            printf("row %zu: %.17g here, %.17g recorded\\n", k + 1, (double)found, row->result);
    }
    if (argc > 2) {
        printf("%.17g\\n", largest);
        return 0;
    }
    if (wrong || count == 0) {
        printf("@NAME@: %zu of %zu rows differ\\n", wrong, count);
        return 1;
    }
    double sum = 0.0;
    size_t steps = 0;
    clock_t began = clock();
    for (size_t k = 0; k < TIMED; k++) {
        const row_t *row = rows + k % count;
        if (row->event[0] == 's' && row->event[1] != 'i') { /* a step or a sample, no silence */
            sum += (double)@AGAIN@;
            ++steps;
        }
    }
    double ns = 1e9 * (double)(clock() - began) / CLOCKS_PER_SEC / (double)steps;
    volatile double kept = sum;
    (void)kept;
    printf("@NAME@: %zu rows @WITHIN@);
    printf("; %.0f ns a step, state %zu bytes, parameters %zu bytes\\n", ns, sizeof(@KIND@_state_t),
           sizeof(@KIND@_params_t));
    return 0;
}
"""


def readme(unit: Unit, made: Sources, rows: int, largest: float, single: bool) -> str:
    """README.md of the folder."""
    name = unit.name
    settable = ", ".join(dict.fromkeys(setter.parameter.name for setter in made.setters)) or "none"
    others = "".join(f"\n- {other}: {reason}" for other, reason in made.others.items()) or " none"
    bits = f"within {largest:g} V in float" if single else "bit for bit"
    if unit.inner is not None:
        given = f"&{name}_exported, &state"
        order = (
            f"`{name}_watch_init(&state)` once, `{name}_watch_command({given}, command)` with each command, "
            f"`{name}_watch_sample({given}, reading, 0)` each sample; {name}.h explains all functions."
        )
        trust = "The watch bridges and refuses readings, limits commands, switches to 0 V, as the supervisor."
    elif unit.is_law:
        order = f"`{name}_init` once, then each sample `{name}_step`, or `{name}_hold` without a reading."
        trust = "The law trusts its inputs: give it finite numbers, and 0 V if its voltage is not finite."
    else:
        order = f"`{name}_init` once, then each sample `{name}_read` and `{name}_step`."
        trust = "Its parameters are those of the simulator."
    return f"""# {name}: {unit.text}, for a sample period of {unit.period:g} s
`make check` compiles and compares with {rows} recorded calls of the Python (check.csv), {bits}.
{order}
State and parameters are structs of yours, `{name}_exported` those of this export. No allocation, only math.h.
Several instances are several structs. Functions with different structs may run at the same time.
{trust}
Compile with `{FLAGS}`; fast-math or fused operations change the last bits.
Parameters that `{name}_set_...` sets while it runs: {settable}.
Parameters that need a new export:{others}

Made by `valve-control export`; do not edit, export again.
"""
