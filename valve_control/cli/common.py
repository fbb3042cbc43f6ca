"""What the sub-commands share: parser, checks, outputs."""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from valve_control import outputs
from valve_control.parameters.table import ParameterError


class Parser(argparse.ArgumentParser):
    """Prints one sentence, not the usage, when an argument is wrong."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def check_outputs(printable: Sequence[str | None], files: Sequence[str | None] = ()) -> None:
    """Refuse outputs that cannot be written, before the work begins; ``printable`` may be -."""
    taken: set[Path] = set()
    for path, may_print in [*((p, True) for p in printable), *((p, False) for p in files)]:
        if path is None or (path == "-" and may_print):
            continue
        if path == "-":
            raise ParameterError("only --json takes - for standard output; give a file")
        whole = Path(path).resolve()
        if not whole.parent.is_dir():
            raise ParameterError(f"{path} cannot be written: there is no folder {whole.parent}")
        if whole.is_dir():
            raise ParameterError(f"{path} cannot be written: it is a folder")
        if whole in taken and not (whole.exists() and not whole.is_file()):
            raise ParameterError(f"{path} is given for two outputs; each needs a file of its own")
        taken.add(whole)


class Progress:
    """A line of progress on standard error every few seconds, with the time left."""

    def __init__(self, total: int, things: str) -> None:
        self._total = total
        self._things = things
        self._first = -1
        self._began = self._said = 0.0

    def __call__(self, done: int, more: str = "") -> None:
        """Say that ``done`` are done, and ``more``; what is done at the first call cost no time."""
        now = time.monotonic()
        if self._first < 0:
            self._first, self._began, self._said = done, now, now
        elif now - self._said >= 5.0 and self._first < done < self._total:
            self._said = now
            left = (now - self._began) * (self._total - done) / (done - self._first)
            print(f"{done} of {self._total} {self._things}{more}, {left:.0f} s left", file=sys.stderr)


def say(arguments: argparse.Namespace, text: str) -> None:
    print(text, file=sys.stderr if arguments.json == "-" else sys.stdout)


def write_json(arguments: argparse.Namespace, result: Any) -> None:
    """Write or print ``result`` as --json asks for it."""
    if arguments.json is None:
        return
    text = outputs.as_json(result)
    if arguments.json == "-":
        print(text, end="")
        return
    outputs.write(arguments.json, text)
    say(arguments, f"wrote {arguments.json}")
