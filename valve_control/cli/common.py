"""What the sub-commands share: parser, checks, outputs."""

import argparse
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from valve_control.parameters.table import ParameterError


class Parser(argparse.ArgumentParser):
    """Prints one sentence, not the usage, when an argument is wrong."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f"{self.prog}: {message} (see {self.prog} --help)\n")


def check_outputs(printable: Sequence[str | None], files: Sequence[str | None] = ()) -> None:
    """Refuse outputs that cannot be written, before the work begins; ``printable`` may be -."""
    for path in (*printable, *files):
        if path is None or (path == "-" and path in printable):
            continue
        if path == "-":
            raise ParameterError("only --json takes - for standard output; give a file")
        folder = Path(path).resolve().parent
        if not folder.is_dir():
            raise ParameterError(f"{path} cannot be written: there is no folder {folder}")
        if Path(path).is_dir():
            raise ParameterError(f"{path} cannot be written: it is a folder")


def say(arguments: argparse.Namespace, text: str) -> None:
    print(text, file=sys.stderr if arguments.json == "-" else sys.stdout)


def write_json(arguments: argparse.Namespace, result: Any) -> None:
    if arguments.json is None:
        return
    text = json.dumps(_finite(result), indent=2, ensure_ascii=False, allow_nan=False)
    if arguments.json == "-":
        print(text)
        return
    Path(arguments.json).write_text(text + "\n", encoding="utf-8")
    say(arguments, f"wrote {arguments.json}")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
