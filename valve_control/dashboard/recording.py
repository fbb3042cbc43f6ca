# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Starts the node `recorder` from the page, and ends it with the page's process."""

import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

PATIENCE = 10.0  # s  for the recorder to close its bag after SIGINT, and after SIGTERM


class Recording:
    """The recorder that the page has started last, if any. Its output is a file beside its bag."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._bag = folder
        self._child: subprocess.Popen[bytes] | None = None

    @property
    def running(self) -> bool:
        """Whether the recorder runs."""
        return self._child is not None and self._child.poll() is None

    @property
    def text(self) -> str:
        """State in words, with the last line of the recorder's output; "" before the first start."""
        if self._child is None:
            return ""
        if self._child.poll() == 0:
            return f"recorded {self._bag}"
        last = self._log.read_text(encoding="utf-8", errors="replace").strip().rpartition("\n")[2]
        state = "records into" if self.running else f"status {self._child.returncode}:"
        return f"{state} {self._bag}: {last.rpartition(']: ')[2]}"

    @property
    def _log(self) -> Path:
        return self._bag.with_suffix(".log")

    def start(self) -> None:
        """Record all valves into a new bag. Raises OSError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self._bag = self._folder / time.strftime("recording_%Y%m%d_%H%M%S")
        with self._log.open("wb") as output:
            self._child = subprocess.Popen(
                [
                    sys.executable, "-m", "valve_control.nodes.recorder", "--ros-args",
                    "-r", "__node:=page_recorder", "-p", f"bag:={self._bag}",
                ],
                stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True,
            )  # fmt: skip

    def interrupt(self) -> None:
        """Ask the recorder to close its bag and to end."""
        if self._child is not None and self.running:
            self._child.send_signal(signal.SIGINT)

    def end(self) -> None:
        """End the recorder, by force if it takes too long."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            if self._child is None or not self.running:
                return
            self._child.send_signal(number)
            with suppress(subprocess.TimeoutExpired):
                self._child.wait(PATIENCE)
