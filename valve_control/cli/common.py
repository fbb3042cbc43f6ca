"""What the sub-commands share: parser, checks, outputs."""

import argparse
import sys
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
