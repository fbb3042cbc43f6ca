# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Keeps what a search has simulated in a file, so that one that was stopped goes on where it was.

A search is repeatable: for the same request it tries the same sets of gains in the same order. One that
begins anew therefore gets what is kept instead of simulating it, and ends with the same bits, wherever the
rest is done.
"""

import contextlib
import hashlib
import io
import json
import math
import sys
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from valve_control import outputs
from valve_control.arrays import Floats
from valve_control.control.simulation.cluster import Cluster
from valve_control.parameter import ParameterError

REQUEST, OUTCOMES = "stopped_search.json", "stopped_search.npz"
AGAIN = "delete it, and the same command begins anew"
EVERY = 10.0  # s  from one time that it is written to the next; what is over sooner leaves no file


def digest(value: Any) -> str:
    """Hash of all that ``value`` (mappings, sequences, arrays, numbers, texts) contains, to the last bit."""
    found = hashlib.sha256()

    def add(part: Any) -> None:
        if isinstance(part, Mapping):
            found.update(b"{")
            for name in sorted(part):
                add(name)
                add(part[name])
            found.update(b"}")
        elif isinstance(part, np.ndarray) and part.ndim:
            found.update(f"{part.dtype}{part.shape}".encode() + np.ascontiguousarray(part).tobytes())
        elif isinstance(part, (list, tuple)):
            found.update(b"[")
            for entry in part:
                add(entry)
            found.update(b"]")
        elif isinstance(part, (float, np.floating)):
            found.update(f"{float(part).hex()};".encode())
        else:
            found.update(f"{part!r};".encode())

    add(value)
    return found.hexdigest()


class Kept:
    """What one search has simulated so far.

    ``workers``: what the rest is done by.
    """

    def __init__(
        self, folder: Path | None, request: Mapping[str, Any], workers: int | Cluster | None
    ) -> None:
        """Read what ``folder`` (None: nothing is written) has of this ``request``.

        Raises ParameterError if what is there belongs to another one, or is damaged.
        """
        self._folder = folder
        self._request = json.dumps(request, indent=2, sort_keys=True) + "\n"
        self.workers = workers
        self._keys: list[str] = []
        self._made: list[Floats] = []
        self._asked = 0
        self._written = time.monotonic()
        self._ours = folder is not None and (folder / REQUEST).exists()  # whether the files are this search's
        if folder is not None and self._ours:
            self._read(folder)
        self.found = len(self._keys)  # parts that were there at the beginning

    @property
    def known(self) -> bool:
        """Whether what comes next is kept already."""
        return self._asked < self.found

    def outcomes(self, key: str, make: Callable[[], Floats]) -> Floats:
        """What is kept for ``key``, else what ``make`` gives; what is kept for another one is dropped."""
        if self.known and self._keys[self._asked] != key:
            del self._keys[self._asked :], self._made[self._asked :]
            self.found = self._asked
        if self.known:
            self._asked += 1
            return self._made[self._asked - 1]
        made = make()
        self._keys.append(key)
        self._made.append(made)
        self._asked += 1
        if time.monotonic() > self._written + EVERY:
            try:
                self.write()
            except OSError as error:
                print(f"note: the search is not kept any more, {error}", file=sys.stderr)
                self._written = math.inf  # at the end once more
        return made

    def write(self) -> None:
        """Write everything. Raises OSError."""
        if self._folder is None:
            return
        self._folder.mkdir(parents=True, exist_ok=True)
        self._ours = True
        stream = io.BytesIO()
        np.savez(
            stream,
            keys=np.array(self._keys, dtype="U64"),
            shapes=np.array([made.shape for made in self._made], dtype=np.int64).reshape(-1, 4),
            numbers=np.concatenate([np.zeros(0), *(made.ravel() for made in self._made)]),
        )
        outputs.write(str(self._folder / OUTCOMES), stream.getvalue())
        outputs.write(str(self._folder / REQUEST), self._request)
        self._written = time.monotonic()

    def forget(self) -> None:
        """Delete what is kept: the search came to its end. Raises OSError."""
        if self._folder is None or not self._ours:
            return
        for name in (REQUEST, OUTCOMES):
            (self._folder / name).unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # of a folder that holds something else
            self._folder.rmdir()

    def _read(self, folder: Path) -> None:
        path = folder / REQUEST
        try:
            same = json.loads(path.read_text(encoding="utf-8")) == json.loads(self._request)
        except ValueError as error:
            raise ParameterError(f"{path} is damaged; {AGAIN}") from error
        if not same:
            raise ParameterError(
                f"{folder} holds a search that was stopped, with other parameters or of another version "
                "of this package; choose another folder"
            )
        path = folder / OUTCOMES
        try:
            with np.load(path, allow_pickle=False) as stored:
                self._keys = [str(key) for key in stored["keys"]]
                self._made = _parts(stored["shapes"], stored["numbers"])
            if len(self._made) != len(self._keys):
                raise ValueError("number of parts")
        except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile) as error:
            raise ParameterError(f"{path} is damaged; {AGAIN}") from error


def _parts(shapes: Sequence[Any], numbers: Floats) -> list[Floats]:
    made, first = [], 0
    for shape in shapes:
        end = first + int(np.prod(shape))
        made.append(numbers[first:end].reshape(shape))
        first = end
    return made
