# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Holds what the sub-commands share: parser, checks of outputs and processes, progress, JSON."""

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from valve_control import interrupts, outputs, priority
from valve_control.control.compiling import LawError
from valve_control.control.laws.registry import LEFT_OUT
from valve_control.parameter import ParameterError
from valve_control.recordings.bags.errors import BagError

MOST_PER_CORE = 4  # processes or threads
MOST_SEED, MOST_VALVES = 2_000_000_000, 100_000  # of a search
SOON, EVERY = 2.0, 5.0  # s  to the first line of progress, and from one to the next


class Parser(argparse.ArgumentParser):
    """Argument parser that prints one sentence, not the usage, when an argument is wrong."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        for name, sentence in LEFT_OUT.items():
            if f"invalid choice: '{name}'" in message:
                self.exit(2, f"{self.prog}: {sentence}\n")
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


INPUTS = ("params_file", "command", "source", "table", "bag", "bags", "config")  # options that name files


def option_of(name: str) -> str:
    """The option that sets the attribute ``name`` of the arguments."""
    return {"start": "--from", "end": "--to"}.get(name, "--" + name.replace("_", "-"))


def repeated(group: Any, option: str, metavar: str, text: str) -> None:
    """Add an ``option`` that may be given several times, whose help is ``text``."""
    group.add_argument(option, action="append", default=[], metavar=metavar, help=f"{text}; again for more")


def parameter_options(group: Any, parameters: str) -> None:
    """Add --set for ``parameters``, as its help calls them, and --params-file."""
    repeated(group, "--set", "NAME=VALUE", parameters)
    repeated(group, "--params-file", "FILE", "ROS 2 parameter file; later ones win, --set wins over files")


def check_outputs(
    arguments: argparse.Namespace, files: Sequence[str | None] = (), figures: Sequence[str | None] = ()
) -> None:
    """Refuse outputs that cannot be written, before the work begins; ``--json`` may be ``-``."""
    wanted = [path for path in (*files, *figures) if path is not None]
    if "-" in wanted:
        raise ParameterError("only --json takes - for standard output; give a file")
    if arguments.json == "-" and sys.__stdout__ is None:
        raise ParameterError("--json - needs standard output, which is closed")
    if arguments.json not in (None, "-"):
        wanted.append(arguments.json)
    inputs: list[str] = []
    for name in INPUTS:
        given = getattr(arguments, name, None) or []
        inputs += [given] if isinstance(given, str) else given
    outputs.check(wanted, inputs)
    for path in figures:
        outputs.check_figure(path)


def check_processes(name: str, count: int) -> None:
    """Raise ParameterError for more processes or threads than this machine could use."""
    cores = os.cpu_count() or 1
    if not 1 <= count <= MOST_PER_CORE * cores:
        raise ParameterError(
            f"--{name} is {count}; it must lie between 1 and {MOST_PER_CORE * cores}, {MOST_PER_CORE} for "
            f"each of the {cores} cores of this machine"
        )


def give_way(arguments: argparse.Namespace) -> None:
    """Let this process run while no other wants the core, and leave one of all cores to a loop that runs."""
    priority.yield_cores()
    if getattr(arguments, "threads", 0) == os.cpu_count() and priority.loop_runs():
        arguments.threads = priority.spare_cores()


def check_search(seed: int, valves: int, unseen: int, budget: int) -> None:
    """Raise ParameterError for numbers of a search and its verification that cannot be.

    The seed leaves room for what is added to it: other seeds for valves that are not seen, noise and motions.
    """
    for name, given, least, most in (
        ("seed", seed, 0, MOST_SEED),
        ("valves", valves, 1, MOST_VALVES),
        ("unseen", unseen, 1, MOST_VALVES),
    ):
        if not least <= given <= most:
            raise ParameterError(f"--{name} is {given}; it must lie between {least} and {most}")
    if budget < 1:
        raise ParameterError(f"--budget is {budget}; it must be at least 1")


def fix_option(group: Any) -> None:
    """Add the option that takes quantities out of the box of a search or study."""
    repeated(group, "--fix", "NAME", "quantity of the box that stays constant")


def clock_option(group: Any) -> None:
    """Add --clock."""
    group.add_argument(
        "--clock",
        choices=("log", "publish"),
        help="clock of the times: log_time (of recording) or publish_time (of sending; the default where it "
        "is fit for all signals)",
    )


def output_group(options: argparse.ArgumentParser, **files: str) -> Any:
    """Add the options that name files to write, --json and ``files`` with their help."""
    group = options.add_argument_group("output")
    group.add_argument("--json", metavar="FILE", help="results as JSON; - for standard output alone")
    for name, text in files.items():
        group.add_argument(f"--{name}", metavar="FILE", help=text)
    return group


def bag_options(group: Any, sources: str = "as for analyze", of: bool = True) -> None:
    """Add what is used of a bag: --map with help on its ``sources``, --of, --from, --to and --clock."""
    repeated(group, "--map", "PART=/TOPIC.FIELD", sources)
    if of:
        group.add_argument("--of", metavar="VALVE", help="valve to read, if the bag has several")
    for option, name, word in (("--from", "start", "begin"), ("--to", "end", "end")):
        text = f"{word} S seconds after the beginning of the bag"
        group.add_argument(option, dest=name, type=float, metavar="S", help=text)
    clock_option(group)


class Progress:
    """Prints a line of progress on standard error after SOON, then every EVERY, with the time left."""

    def __init__(self, total: int, things: str) -> None:
        self._total = total
        self._things = things
        self._first = -1
        self._began = self._next = 0.0

    def __call__(self, done: int, more: str = "") -> None:
        """Report that ``done`` are done, and print ``more``; what was done at the first call took no time."""
        now = time.monotonic()
        if self._first < 0:
            self._first, self._began, self._next = done, now, now + SOON
        elif now >= self._next and self._first < done < self._total:
            self._next = now + EVERY
            left = (now - self._began) * (self._total - done) / (done - self._first)
            print(f"{done} of {self._total} {self._things}{more}, {left:.0f} s left", file=sys.stderr)


def say(arguments: argparse.Namespace, text: str) -> None:
    print(text, file=sys.stderr if arguments.json == "-" else sys.stdout)


def wrote(arguments: argparse.Namespace, path: object, more: str = "") -> None:
    """Say that the file or folder ``path`` is there."""
    say(arguments, f"wrote {path}{more}")


def deliver(arguments: argparse.Namespace, path: str, content: str | bytes) -> None:
    """Write ``content`` to the file ``path``, whole or not at all, and say so. Raises OSError."""
    outputs.write(path, content)
    wrote(arguments, path)


def tell_notes(notes: Sequence[str]) -> None:
    for note in notes:
        print(f"note: {note}", file=sys.stderr)


def write_json(arguments: argparse.Namespace, result: Any) -> None:
    """Write ``result`` to the file that --json names, or print it."""
    if arguments.json is None:
        return
    text = outputs.as_json(result)
    if arguments.json == "-":
        print(text, end="")
        return
    deliver(arguments, arguments.json, text)


def ended(program: str, task: str, work: Callable[[], int | None]) -> int:
    """Do ``work`` and return the exit status; every expected error becomes one sentence of ``program``."""
    try:
        status = int(work() or 0)
        sys.stdout.flush()
        return status
    except (ParameterError, BagError, LawError) as error:
        print(f"{program}: {error}", file=sys.stderr)
        return 1 if isinstance(error, LawError) else 2
    except ModuleNotFoundError as error:
        print(
            f"{program}: {task} needs the Python package {error.name} (pip install {error.name})",
            file=sys.stderr,
        )
        return 2
    except BrokenPipeError:
        _leave_output()
        return 1
    except OSError as error:
        print(
            f"{program}: {error.filename or 'output'} cannot be written: {error.strerror or error}",
            file=sys.stderr,
        )
        _leave_output()
        return 1
    except MemoryError:
        print(f"{program}: {task} needs more memory than there is", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"{program}: {task} was stopped", file=sys.stderr)
        return interrupts.STATUS


def _leave_output() -> None:
    """Discard what standard output could not take, so that Python does not try again at its exit."""
    try:
        sys.stdout.flush()
    except OSError:
        with contextlib.suppress(OSError):
            sys.stdout.close()
