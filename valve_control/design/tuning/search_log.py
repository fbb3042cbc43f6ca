# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Logs what a search simulates in a file, so that one that was stopped goes on where it was.

A search is repeatable: for the same request it tries the same sets of gains in the same order. One that
begins anew therefore reads its first results from the log, and ends with the same bits on any number of
threads.
"""

import contextlib
import hashlib
import io
import json
import math
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from valve_control import outputs
from valve_control.arrays import Floats
from valve_control.parameter import ParameterError

FILE = "stopped_search.npz"
EVERY = 10.0  # s  from one time that it is written to the next; a shorter search leaves no file


def digest(value: Any) -> str:
    """Hash of all that ``value`` (mappings, sequences, arrays, numbers, texts) contains, to the last bit."""

    def plain(part: Any) -> Any:
        array = np.asarray(part)
        return [str(array.dtype), array.shape, array.tobytes().hex()]

    return hashlib.sha256(json.dumps(value, sort_keys=True, default=plain).encode()).hexdigest()


class SearchLog:
    """Results of one search, in their order; ``threads`` simulate those that come next (None: all cores)."""

    def __init__(self, folder: Path | None, request: str, threads: int | None = None) -> None:
        """Read the log of this ``request`` from ``folder``, if there is one; None: nothing is written.

        Raises ParameterError for the log of another request, or a damaged one.
        """
        self.threads = threads
        self._path = None if folder is None else folder / FILE
        self._request = request
        self._results: list[Floats] = []
        self._next = 0
        self._written = time.monotonic()
        self._exists = self._path is not None and self._path.exists()
        if self._exists:
            self._read()
        self.length = len(self._results)  # at the beginning

    @property
    def replays(self) -> bool:
        """Whether the next result comes from the log."""
        return self._next < self.length

    def result(self, simulate: Callable[[], Floats]) -> Floats:
        """The next result: of the log, or of ``simulate``."""
        self._next += 1
        if self._next > self.length:
            self._results.append(simulate())
            if time.monotonic() > self._written + EVERY:
                try:
                    self.write()
                except OSError as error:
                    print(f"note: a stopped search will be lost, {error}", file=sys.stderr)
                    self._written = math.inf
        return self._results[self._next - 1]

    def write(self) -> None:
        """Write all results. Raises OSError."""
        if self._path is None:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        stream = io.BytesIO()
        np.savez(stream, *self._results, request=np.array(self._request))
        outputs.write(str(self._path), stream.getvalue())
        self._exists, self._written = True, time.monotonic()

    def delete(self) -> None:
        """Delete the file: the search is complete. Raises OSError."""
        if self._path is not None and self._exists:
            self._path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):  # the folder holds something else
                self._path.parent.rmdir()

    def _read(self) -> None:
        try:
            with np.load(self._path, allow_pickle=False) as stored:  # type: ignore[arg-type]
                request = str(stored["request"])
                self._results = [stored[f"arr_{i}"] for i in range(len(stored.files) - 1)]
        except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise ParameterError(
                f"{self._path} is damaged; delete it, and the same command begins anew"
            ) from error
        if request != self._request:
            raise ParameterError(
                f"{self._path} is of a search with other parameters or of another version of this package; "
                "choose another folder"
            )
