# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Starts programs from the page, keeps what they print, and ends them with the page's process."""

import json
import math
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

LINES = 400
EVENTS = "VALVE_CONTROL_EVENTS"  # file descriptor on which a command tells what it has done and written
PATIENCE = 10.0  # s  for a program to end after SIGINT, in which commission sets parameters back, and SIGTERM
CANCELLED = 130  # exit status of a command of this package after SIGINT


class Program:
    """A program that runs, or has ended. Its output is read in a thread of its own."""

    def __init__(self, title: str, arguments: Sequence[str], folder: Path, moves: bool = False) -> None:
        self.title = title
        self.moves = moves  # a valve
        self.lines: deque[str] = deque(maxlen=LINES)
        self.progress = ""  # the line that is being written, such as a progress bar
        self.wrote: list[str] = []  # files and folders, as commands of this package tell
        self.share = math.nan  # of the work that is done, likewise
        folder.mkdir(parents=True, exist_ok=True)
        events, given = os.pipe()
        self._child = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1", EVENTS: str(given)},
            pass_fds=[given],
        )
        os.close(given)
        self._listener = threading.Thread(target=self._listen, args=(events,), daemon=True)
        self._listener.start()
        self._reader = threading.Thread(target=self._read, name=f"output of {title}", daemon=True)
        self._reader.start()

    @property
    def running(self) -> bool:
        """Whether it has not ended."""
        return self._child.poll() is None

    @property
    def ended(self) -> bool:
        """Whether it has ended, and all that it told is here."""
        return not self.running and not self._listener.is_alive()

    @property
    def status(self) -> int | None:
        """Its exit status, None while it runs; negative: the signal that ended it."""
        return self._child.poll()

    @property
    def state(self) -> str:
        """In words."""
        status = self.status
        if status is None:
            return "running"
        if status in (CANCELLED, -signal.SIGINT):
            return "cancelled"
        if status < 0:
            return f"ended by signal {-status}"
        return "done" if status == 0 else f"ended with status {status}"

    def interrupt(self, number: int = signal.SIGINT) -> None:
        """Ask it to end."""
        if self.running:
            self._child.send_signal(number)

    def end(self) -> None:
        """End it, whatever it takes."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            self.interrupt(number)
            with suppress(subprocess.TimeoutExpired):
                self._child.wait(PATIENCE)
                break
        self._reader.join(PATIENCE)
        self._listener.join(PATIENCE)

    def _listen(self, events: int) -> None:
        with open(events, encoding="utf-8") as lines:
            for line in lines:
                told = json.loads(line)
                if "wrote" in told:
                    self.wrote.append(told["wrote"])
                elif told["total"] > 0.0:
                    self.share = min(1.0, told["done"] / told["total"])

    def _read(self) -> None:
        assert self._child.stdout is not None
        rest = b""
        while data := self._child.stdout.read1(65536):  # type: ignore[attr-defined]
            rest += data
            *whole, rest = rest.split(b"\n")
            for line in whole:
                self.lines.append(_last_writing(line))
            self.progress = _last_writing(rest)
        if rest:
            self.lines.append(_last_writing(rest))
        self.progress = ""


def _last_writing(line: bytes) -> str:
    """What stands in a line that was written over with carriage returns."""
    parts = [part for part in line.decode(errors="replace").split("\r") if part.strip()]
    return parts[-1].rstrip() if parts else ""


class Programs:
    """The programs that the page has started, by the place they have on it."""

    def __init__(self) -> None:
        self._running: dict[str, Program] = {}

    def start(
        self, place: str, title: str, arguments: Sequence[str], folder: Path, moves: bool = False
    ) -> str:
        """Start a program (``python -m`` and ``arguments``); one sentence if there is one at its place."""
        present = self._running.get(place)
        if present is not None and present.running:
            return f"{present.title} is still running; end it first"
        try:
            self._running[place] = Program(title, arguments, folder, moves)
        except OSError as error:
            return f"{title} cannot be started in {folder}: {error.strerror}"
        return ""

    def get(self, place: str) -> Program | None:
        """The last program that was started at a place."""
        return self._running.get(place)

    def end(self, place: str) -> None:
        """Ask the program at a place to end; one that does not is ended by force after a while."""
        program = self._running.get(place)
        if program is not None and program.running:
            threading.Thread(target=program.end, daemon=True).start()

    def end_moving(self) -> None:
        """Ask all programs that move a valve to end: what was stopped must not begin again by itself."""
        for place, program in self._running.items():
            if program.moves:
                self.end(place)

    def end_all(self) -> None:
        """End all programs and wait for it."""
        for program in self._running.values():
            program.interrupt()
        for program in self._running.values():
            program.end()
