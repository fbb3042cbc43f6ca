# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the `valve-control` command."""

import os
import sys
from collections.abc import Sequence

from valve_control import interrupts


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status.

    0; 1 if an output failed or gains are not accepted; 2 for bad input; 130 for Ctrl-C. Without ``argv``
    it is the command of this process, which SIGINT then ends quietly at any moment, of the imports too.
    """
    if argv is not None:
        from valve_control.cli import command

        return command.run(argv)
    return interrupts.run(_command)


def _command() -> int:
    for name in ("stdout", "stderr"):  # a stream may be closed, or without letters such as Θ
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        getattr(sys, name).reconfigure(errors="replace")
    from valve_control.cli import command

    return command.run(sys.argv[1:], alone=True)
