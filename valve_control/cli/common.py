# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Holds what the sub-commands share: parser, options, checks of outputs, progress, JSON."""

import argparse
import contextlib
import difflib
import io
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from valve_control import interrupts, outputs
from valve_control.control.compiling import LawError
from valve_control.control.laws.registry import LAWS, LEFT_OUT
from valve_control.control.parameters import files
from valve_control.control.parameters.table import NODES
from valve_control.design import priority
from valve_control.parameter import ParameterError, Table
from valve_control.recordings.bags.errors import BagError

if TYPE_CHECKING:
    from valve_control.recordings.recording import Recording

MOST_SEED, MOST_VALVES = 2_000_000_000, 100_000  # of a search, with room for what is added to its seed
CORES = os.cpu_count() or 1
MOST_THREADS = 4 * CORES  # or processes
SOON, EVERY = 2.0, 5.0  # s  to the first look at the progress, and from one to the next
INPUTS = ("params_file", "command", "source", "table", "bag", "config")  # options that name files
OUTPUTS = {"json": "json", "npz": "npz", "csv": "csv", "html": "html", "output": "yaml", "figure": "svg"}
WITH_BAG = ("start", "end", "of", "clock", "map")  # options of ``bag_options``
SETTINGS = ("controller", "upper_level", "valve", "scenario", "sample_period", "duration", "seed")


class Parser(argparse.ArgumentParser):
    """Argument parser that prints one sentence, not the usage, when an argument is wrong."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def within(least: float, most: float) -> Callable[[str], float]:
    """Type of an option for numbers from ``least`` to ``most``, whole ones if ``least`` is."""
    kind = type(least)

    def number(word: str) -> float:
        with contextlib.suppress(ValueError):
            if least <= (value := kind(word)) <= most:
                return value
        whole = "whole " if kind is int else ""
        raise argparse.ArgumentTypeError(f"{word} is no {whole}number from {least:g} to {most:g}")

    return number


def _law(name: str) -> str:
    """Type of an option for a law, which says why one is left out, or which is nearest."""
    if name in LEFT_OUT:
        raise argparse.ArgumentTypeError(LEFT_OUT[name])
    if name not in LAWS:
        near = [f"did you mean '{law}'?" for law in difflib.get_close_matches(name.lower(), LAWS)]
        own = f"there are {', '.join(LAWS)} (one of your own: docs/tutorials/your_law.md)"
        raise argparse.ArgumentTypeError(f"there is no law '{name}'; {[*near, own][0]}")
    return name


def laws(names: str) -> list[str]:
    """Type of an option for laws with commas between them."""
    return list(dict.fromkeys(_law(name.strip()) for name in names.split(",")))


def law_option(group: Any, text: str = "control law (default: that of the files, else arc)") -> None:
    """Add --controller, with the help ``text``."""
    group.add_argument("--controller", type=_law, choices=LAWS, help=text)


def option_of(name: str) -> str:
    """The option that sets the attribute ``name`` of the arguments."""
    names = {"start": "--from", "end": "--to", "upper_level": "--upper", "bag": "BAG"}
    return names.get(name, "--" + name.replace("_", "-"))


def refuse(arguments: argparse.Namespace, names: Iterable[str], who: str) -> None:
    """Raise ParameterError if one of the options ``names`` is there, which ``who`` takes not."""
    for name in names:
        value = getattr(arguments, name)
        if not (value is None or value is False or value == []):
            raise ParameterError(f"{who} takes no {option_of(name)}")


Row = tuple[str, Callable[[str], float], float | str | None, str, str]


def numbers(group: Any, *rows: Row) -> None:
    """Add an option for one number for each of ``rows``: its name, type, usual value, metavar and help."""
    for name, kind, usual, metavar, text in rows:
        group.add_argument(f"--{name}", type=kind, default=usual, metavar=metavar, help=text)


SEED: Row = ("seed", within(0, MOST_SEED), 1, "N", "seed of the search (%(default)s)")
CHATTER = 0.25  # limit of c_u, where none is asked for and gains can be found that keep it
VALVES, BUDGET = within(1, MOST_VALVES), within(1, 10**12)  # of a search
THREADS: Row = (
    "threads", within(1, MOST_THREADS), CORES, "N", "number of threads (one a core; at most four a core)"
)  # fmt: skip


def repeated(group: Any, option: str, metavar: str, text: str) -> None:
    """Add an ``option`` that may be given several times, whose help is ``text``."""
    group.add_argument(option, action="append", default=[], metavar=metavar, help=f"{text}; can be repeated")


def parameter_options(group: Any, parameters: str) -> None:
    """Add --set for ``parameters``, as its help calls them, and --params-file."""
    repeated(group, "--set", "NAME=VALUE", parameters)
    repeated(group, "--params-file", "FILE", "ROS 2 parameter file; later ones win, --set wins over files")


def names_of_files(arguments: argparse.Namespace, usual: str = "default parameters") -> str:
    """Names of the parameter files, for the title of a figure; ``usual``: of no file."""
    return ", ".join(Path(file).name for file in arguments.params_file) or usual


def changes_of(
    arguments: argparse.Namespace,
    nodes: Mapping[str, Table] = NODES,
    more: Mapping[str, Any] | None = None,
    law: str = "",
    recorded: bool = False,
) -> dict[str, dict[str, Any]]:
    """Changed values by node: of parameter files, options of SETTINGS, ``more`` and --set; later ones win.

    ``law``, ``recorded``: as for ``files.given``. Notes about the files are printed, for a ``law`` among
    several none. Raises ParameterError.
    """
    options = {**{name: getattr(arguments, name, None) for name in SETTINGS}, **(more or {})}
    direct = {
        node: {p.name: options[p.name] for p in table if p.name in options} for node, table in nodes.items()
    }
    notes: list[str] = []
    changes = files.given(arguments.params_file, direct, arguments.set, notes, nodes, law, recorded)
    tell_notes([] if law else notes)
    return changes


def check_figure(path: str | None) -> None:
    """Raise ParameterError unless ``path`` names a PNG or SVG file."""
    if path is not None and Path(path).suffix.lower() not in (".png", ".svg"):
        raise ParameterError(f"--figure {path} must end in .png or .svg")


def check_outputs(arguments: argparse.Namespace, *more: str) -> argparse.Namespace:
    """Refuse outputs that cannot be written, of OUTPUTS and ``more``; returns the ``arguments``."""
    wanted = {name: getattr(arguments, name, None) for name in OUTPUTS}
    if wanted["json"] == "-":
        if sys.__stdout__ is None:
            raise ParameterError("--json - needs standard output, which is closed")
        wanted["json"] = None
    paths = [path for path in (*wanted.values(), *more) if path is not None]
    if "-" in paths:
        raise ParameterError("only --json takes - for standard output; give a file")
    inputs: list[str] = []
    for name in INPUTS:
        given = getattr(arguments, name, None) or []
        inputs += [given] if isinstance(given, str) else given
    outputs.check(paths, inputs)
    check_figure(wanted["figure"])
    return arguments


def give_way(arguments: argparse.Namespace) -> None:
    """Let this process run while no other wants the core, and leave one of all cores to a loop that runs."""
    priority.yield_cores()
    if getattr(arguments, "threads", 0) == CORES and priority.loop_runs():
        arguments.threads = priority.spare_cores()


def output_group(options: argparse.ArgumentParser, **files: str) -> Any:
    """Add the options that name files to write, --json and ``files`` with their help."""
    group = options.add_argument_group("output")
    group.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    for name, text in files.items():
        group.add_argument(f"--{name}", metavar="FILE", help=text)
    return group


def bag_options(group: Any, sources: str = "as for analyze: PART=COLUMN*0.001", of: bool = True) -> None:
    """Add what is used of a bag: --map with help on its ``sources``, --of, --from, --to and --clock."""
    repeated(group, "--map", "PART=/TOPIC.FIELD", sources)
    if of:
        group.add_argument("--of", metavar="VALVE", help="valve to read, if the bag has several")
    for option, name, word in (("--from", "start", "begin"), ("--to", "end", "end")):
        text = f"{word} S seconds after the beginning of the bag or log"
        group.add_argument(option, dest=name, type=float, metavar="S", help=text)
    group.add_argument(
        "--clock",
        choices=("log", "publish"),
        help="clock of the times: log_time (of recording) or publish_time (of sending; the default where it "
        "is fit for all signals)",
    )


def load(arguments: argparse.Namespace, path: str, **how: Any) -> "Recording":
    """The bag or log ``path``; ``how``: as for ``recording.load``. Raises ParameterError and BagError."""
    from valve_control.recordings import recording

    part = {name: getattr(arguments, name) for name in ("start", "end", "clock")} | how
    if None not in (part["start"], part["end"]) and part["end"] <= part["start"]:
        raise ParameterError(f"--to {part['end']:g} lies not after --from {part['start']:g}")
    return recording.load(path, arguments.map, **part)


def valve_of(arguments: argparse.Namespace, path: str, valves: Mapping[str, Any]) -> Any:
    """The valve of a bag that --of names, or its only one. Raises BagError."""
    from valve_control.recordings import recording

    if not valves:
        raise BagError(f"{path} has no topic of a valve")
    return recording.chosen(path, valves, arguments.of)


def progress(total: int, things: str, pieces: bool = True) -> Any:
    """Bar of progress on standard error, for work in ``pieces`` that takes longer than SOON."""
    from tqdm import tqdm

    style = {"delay": SOON, "mininterval": EVERY, "leave": False, "ascii": True}
    return tqdm(total=total, unit=f" {things}", disable=not pieces, **style)


def say(arguments: argparse.Namespace, text: str) -> None:
    print(text, file=sys.stderr if arguments.json == "-" else sys.stdout)


def wrote(arguments: argparse.Namespace, path: object, more: str = "") -> None:
    """Say that the file or folder ``path`` is there."""
    say(arguments, f"wrote {path}{more}")


def deliver(arguments: argparse.Namespace, path: str, content: str | bytes) -> None:
    """Write ``content`` to the file ``path``, whole or not at all, and say so. Raises OSError."""
    outputs.write(path, content)
    wrote(arguments, path)


def csv_text(columns: Mapping[str, Any], form: str) -> str:
    """CSV text of ``columns`` (arrays of one length, by name), numbers in the ``form`` such as %.10g."""
    import numpy as np

    stream = io.StringIO()
    rows = np.column_stack(list(columns.values()))
    np.savetxt(stream, rows, delimiter=",", header=",".join(columns), comments="", fmt=form)
    return stream.getvalue()


def tell_notes(notes: Sequence[str]) -> None:
    for note in notes:
        print(f"note: {note}", file=sys.stderr)


def write_json(arguments: argparse.Namespace, result: Any) -> None:
    """Write ``result`` to the file that --json names, or print it."""
    if arguments.json == "-":
        print(outputs.as_json(result), end="")
    elif arguments.json is not None:
        deliver(arguments, arguments.json, outputs.as_json(result))


def ended(program: str, task: str, work: Callable[[], int | None]) -> int:
    """Do ``work`` and return the exit status; every expected error becomes one sentence of ``program``."""
    try:
        status = int(work() or 0)
        sys.stdout.flush()
        return status
    except (ParameterError, BagError) as error:
        text, status = str(error), 2
    except LawError as error:
        text, status = str(error), 1
    except ModuleNotFoundError as error:
        text, status = f"{task} needs the Python package {error.name} (pip install {error.name})", 2
    except BrokenPipeError:
        text, status = "", 1
    except OSError as error:
        text, status = f"{error.filename or 'output'} cannot be written: {error.strerror or error}", 1
    except MemoryError:
        text, status = f"{task} needs more memory than there is", 1
    except KeyboardInterrupt:
        text, status = f"{task} was stopped", interrupts.STATUS
    if text:
        print(f"{program}: {text}", file=sys.stderr)
    try:
        sys.stdout.flush()
    except OSError:  # Python would try again at its exit
        with contextlib.suppress(OSError):
            sys.stdout.close()
    return status
