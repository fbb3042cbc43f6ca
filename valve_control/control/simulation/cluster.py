# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Gives work to the workers of a dask.distributed scheduler instead of this machine's threads.

A part of the work is a function of this package and its arguments; it gives the same bits wherever it runs.
What a worker had that is lost is given to another one. Without workers for a while it is done here.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from valve_control.control.compiling import sources_digest
from valve_control.parameter import ParameterError

T = TypeVar("T")
MEET = 8.0  # s  in which the scheduler has to answer
ALONE = 15.0  # s  without a worker, after which a part is done here
LOOK = 0.2  # s


class ClusterError(ParameterError):
    """The cluster cannot go on: what it was to do is not done."""


class Cluster:
    """A scheduler with its workers."""

    def __init__(self, client: Any, address: str, alone: float = ALONE) -> None:
        self._client = client
        self._address = address
        self._alone = alone
        self._ready = threading.Event()
        self.lost = 0  # parts that had to be given out again, or were done here

    @property
    def slots(self) -> int:
        """Parts that the workers can do at once, at least 1. Raises ClusterError if it is lost."""
        return max(1, self._threads())

    def _threads(self) -> int:
        try:
            return int(sum(self._client.nthreads().values()))
        except OSError as error:
            raise self._gone() from error

    def _gone(self) -> ClusterError:
        return ClusterError(f"the cluster {self._address} is lost")

    def completed(
        self, function: Callable[..., T], parts: Sequence[tuple[Any, ...]]
    ) -> Iterator[tuple[int, T]]:
        """Number and result of each of ``parts``, the arguments of ``function``, as they become ready.

        Raises ClusterError if the scheduler is lost, and what ``function`` raises.
        """
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker

        waiting = {self._given(function, part): i for i, part in enumerate(parts)}
        since = time.monotonic()
        try:
            while waiting:
                self._ready.wait(LOOK)
                self._ready.clear()
                ready = [future for future in waiting if future.done()]
                for future in ready:
                    i = waiting.pop(future)
                    try:
                        result = future.result()
                    except (KilledWorker, FutureCancelledError):
                        if self._client.status != "running":
                            raise self._gone() from None
                        self.lost += 1
                        waiting[self._given(function, parts[i])] = i
                        continue
                    yield i, result
                if self._client.status != "running":
                    raise self._gone()
                now = time.monotonic()
                if ready or self._threads():
                    since = now
                elif now > since + self._alone:
                    future, i = next(iter(waiting.items()))
                    del waiting[future]
                    future.cancel()
                    self.lost += 1
                    yield i, function(*parts[i])
        finally:
            with suppress(Exception):  # the scheduler may be gone
                self._client.cancel(list(waiting))

    def _given(self, function: Callable[..., T], part: tuple[Any, ...]) -> Any:
        future = self._client.submit(_same_sources, sources_digest(), function, part, pure=False)
        future.add_done_callback(lambda done: self._ready.set())
        return future


def _same_sources(digest: str, function: Callable[..., T], part: tuple[Any, ...]) -> T:
    """Result of ``function`` on a worker. Raises ClusterError if the worker has another package."""
    if sources_digest() != digest:
        raise ClusterError(
            "a worker of the cluster has another version of this package; install this one there"
        )
    return function(*part)


@contextmanager
def connected(address: str) -> Iterator[Cluster]:
    """The cluster whose scheduler has ``address``, such as tcp://127.0.0.1:8786. Raises ParameterError."""
    try:
        from distributed import Client
    except ImportError as error:
        raise ParameterError(
            "--cluster needs dask.distributed; pip install 'valve_control[cluster]' brings it"
        ) from error
    for name in ("distributed", "tornado"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=MEET, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:  # TypeError: tls:// and ucx:// that are not set up
        raise ParameterError(
            f"--cluster {address}: no scheduler answers there ({str(error).splitlines()[0]})"
        ) from error
    try:
        yield Cluster(client, address)
    finally:
        with suppress(Exception):
            client.close(timeout=2)
