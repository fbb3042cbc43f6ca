# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Runs the nodes of a process in one loop: LVDT samples first, everything else in the time between them.

The standard executor looks at every entity of a node, some twenty services and timers, at each wake-up. Here
a wait set holds only the subscriptions on which a node works. Services get their turn right after a sample;
timers and discovery too, now and then, one node at a time.
"""

import argparse
import gc
import linecache
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from valve_control.nodes.adapter import PolledSubscription
from valve_control.nodes.rclpy_internals import WaitSet, call_timer
from valve_control.nodes.services import Reception, Unwatched
from valve_control.parameter import ParameterError

CHORES = 0.05  # s between two looks at a node's timers beside samples ...
IDLE_CHORES = 0.01  # s  ... and while there are none; at most twice that
CALM = 0.01  # s without a sample, after which services need not wait for the next
SWITCH = 1e-4  # s after which another thread gives way to the loop
STALL = 0.01  # s; the loop wakes on time unless its process stood still
# Between two looks of the executor at a node that has only timers and polled subscriptions, without samples:
# a look takes 2 to 6 ms beside them, and only tells of another quality of service.
EVENTS = 0.25  # s

_stopped: list[int] = []  # signals that have come


def stood_still(due: float, now: float) -> bool:
    """Whether this process stood still until ``now`` [s], so that it did not look when it was ``due`` [s]."""
    return now - due > STALL


class Failure(RuntimeError):
    """Ends the run with exit status 1; the message is one sentence for the user."""


class Worker(Node):
    """Node that does its main work in ``work``, not in callbacks."""

    pieces: Iterator[object] = iter(())  # of what is not urgent; the loop does one after a sample

    def inputs(self) -> Sequence[PolledSubscription]:
        """Subscriptions whose messages make the loop call ``work``."""
        return ()

    def fileno(self) -> int:
        """File that makes the loop call ``work`` when it is readable, -1 for none."""
        return -1

    def due(self) -> float:
        """Time (`time.monotonic`) at which ``work`` is called even if no message has come."""
        return float("inf")

    def work(self) -> bool:
        """Do what has to be done now; returns whether anything was done.

        Called only when a message has come on one of ``inputs``, ``fileno`` is readable or ``due`` is over.
        """
        return False

    def report(self) -> None:
        """Publish what is not urgent.

        Called when all nodes of the process have worked, of those that did something, and after a callback.
        """

    def finish(self) -> None:
        """Publish the last messages before the node is destroyed."""

    def later(self, pieces: Iterator[object]) -> None:
        """Do ``pieces`` after those that wait."""
        self.pieces = chain(self.pieces, pieces)

    def say(self) -> None:
        """Do all ``pieces``."""
        for _ in self.pieces:
            pass

    def deliver(self) -> None:
        """Wait briefly until the last messages have arrived."""


def _finished(nodes: Sequence[Any]) -> bool:
    """Let all nodes say their last, and wait until it is delivered; whether none of them raised an error."""
    whole = True
    for act in ("finish", "say", "deliver"):
        for node in nodes:
            try:
                getattr(node, act)()
            except Exception as error:  # the other valves must hear their 0 V whatever this one does
                print(f"valve_control: {node.get_name()}: {first_line(error)}", file=sys.stderr)
                whole = False
    return whole


def stray_words(arguments: Sequence[str]) -> list[str]:
    """Words that stand not between --ros-args and --; rcl would take some of them for remappings."""
    found, inside = [], False
    for word in arguments:
        if word == "--ros-args" or (inside and word == "--"):
            inside = word == "--ros-args"
        elif not inside:
            found.append(word)
    return found


def run(make: Callable[[], Sequence[Any]]) -> int:
    """Run the nodes that ``make`` creates until SIGINT or SIGTERM; returns the exit status."""

    def stop(number: int, frame: Any) -> None:
        _stopped.append(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    parser = argparse.ArgumentParser(
        prog=f"ros2 run valve_control {Path(sys.argv[0]).stem}",
        usage="%(prog)s [--ros-args] [-p NAME:=VALUE] [--params-file FILE] [-r __ns:=/NAME]",
        description=make.__globals__["__doc__"],
        epilog="valve-control parameters lists the parameters of all nodes.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    try:
        parser.parse_args(stray_words(sys.argv[1:]))
        remove_ros_args(sys.argv)  # refuses, and writes no line of the log as init does
        rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy has no public type for bad --ros-args
        print(f"{sys.argv[0]}: {first_line(error)}", file=sys.stderr)
        return 2
    status = 0
    nodes: Sequence[Any] = ()
    chores: list[Chores] = []
    reception: Reception | None = None
    try:
        nodes = make()
        reception = Reception(nodes)
        chores += [Chores(node) for node in nodes]
        # rclpy looks up the source of each line that logs, the first of a file in 15 ms.
        for name, module in list(sys.modules.items()):
            if name == "__main__" or name.startswith(("valve_control.nodes", "rclpy.impl")):
                linecache.getlines(getattr(module, "__file__", None) or "")  # __main__ of a fork has none
        # A collection of everything that the imports brought takes tens of milliseconds, many samples.
        gc.collect()
        gc.freeze()
        sys.setswitchinterval(SWITCH)
        _loop(nodes, chores, reception)
    except ParameterError as error:
        print(f"valve_control: {error}", file=sys.stderr)
        status = 2
    except Failure as error:
        print(f"valve_control: {error}", file=sys.stderr)
        status = 1
    finally:
        if not _finished(nodes):
            status = 1
        if reception is not None:
            reception.close()
        for chore in chores:
            chore.end()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    for number in (signal.SIGINT, signal.SIGTERM):  # nothing is left to end; the status is decided
        signal.signal(number, signal.SIG_IGN)
    return status


class Chores:
    """Runs a node's timers itself, all else that is not polled with the standard executor, one at a time."""

    def __init__(self, node: Any) -> None:
        self.node = node
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._resumed = False
        self._look_at = 0.0  # s

    def one(self, calm: bool) -> bool:
        """Run one callback that is ready; returns whether there was one."""
        for timer in self.node.timers:
            if timer.is_ready():
                call_timer(timer)
                return True
        now = time.monotonic()
        answered = any(True for _ in self.node.clients)  # or messages, which the executor may hand out
        unwatched = all(isinstance(one.callback_group, Unwatched) for one in self.node.subscriptions)
        if unwatched and not answered and not (calm and now >= self._look_at):
            return False
        self._look_at = now + EVENTS
        return self._executed()

    def _executed(self) -> bool:
        try:
            handler, _, _ = self._executor.wait_for_ready_callbacks(0.0)
        except TimeoutException:
            # After its last callback the executor ends its look with a time-out, and has not looked anew.
            resumed, self._resumed = self._resumed, False
            return resumed and self._executed()
        self._resumed = True
        handler()
        handler.result()
        return True

    def end(self) -> None:
        """Shut the executor down."""
        self._executor.shutdown(timeout_sec=0.0)


class Inputs:
    """Waits for what the nodes of a process take: messages, or a device's file."""

    def __init__(self, nodes: Sequence[Any]) -> None:
        self._nodes = nodes
        self._context = rclpy.get_default_context()
        self._wait_set: Any = None
        self._size = -1

    def wait(self, wake: float) -> list[Any]:
        """Nodes that did something with what came until ``wake`` [s]."""
        inputs = [(node, subscription.handle) for node in self._nodes for subscription in node.inputs()]
        if inputs:
            return self._wait_for_messages(inputs, wake)
        files = {file: node for node in self._nodes if (file := node.fileno()) >= 0}
        pause = max(0.0, wake - time.monotonic())
        if files:
            return [files[file] for file in select.select(files, [], [], pause)[0] if files[file].work()]
        time.sleep(pause)
        return []

    def _wait_for_messages(self, inputs: Sequence[tuple[Any, Any]], wake: float) -> list[Any]:
        if len(inputs) != self._size:
            self._size = len(inputs)
            self._wait_set = WaitSet(self._size, 0, 0, 0, 0, 0, self._context.handle)
        self._wait_set.clear_entities()
        for _, handle in inputs:
            self._wait_set.add_subscription(handle)
        self._wait_set.wait(max(0, int((wake - time.monotonic()) * 1e9)))
        return [
            node
            for i, (node, _) in enumerate(inputs)
            if self._wait_set.is_ready("subscription", i) and node.work()
        ]


class Turns:
    """Gives the chores of one node after another their turn, now and then."""

    def __init__(self, nodes: Sequence[Any], chores: Sequence[Chores]) -> None:
        self._nodes, self._chores = nodes, chores
        self._rest = IDLE_CHORES / len(nodes)
        self._looked = time.monotonic()
        self._turn = 0

    @property
    def due(self) -> float:
        """Time [s] of the next turn."""
        return self._looked + self._rest

    def take(self, now: float, worked: bool, calm: bool) -> bool:
        """Run a callback if it is time for one; whether there was one, since more may wait.

        After a sample (``worked``) it is time earlier; ``calm``: without samples turns follow sooner.
        """
        if now < self.due and not (worked and now >= self._looked):
            return False
        if self._chores[self._turn].one(calm):
            self._looked = now
            self._nodes[self._turn].report()
            return True
        self._rest = (IDLE_CHORES if calm else CHORES) / len(self._nodes)
        self._looked = time.monotonic() + self._rest
        self._turn = (self._turn + 1) % len(self._nodes)
        return False


def _loop(nodes: Sequence[Any], chores: Sequence[Chores], reception: Reception) -> None:
    inputs, turns = Inputs(nodes), Turns(nodes, chores)
    sampled = time.monotonic()
    while not _stopped:
        now = time.monotonic()
        calm = now > sampled + CALM
        dues = [node.due() for node in nodes]
        worked = inputs.wait(now if calm and reception.waiting else min(turns.due, *dues))
        now = time.monotonic()
        worked += [
            node
            for node, due in zip(nodes, dues, strict=True)
            if (node.due() if node in worked else due) <= now and node.work()
        ]
        for node in worked:
            node.report()
        if worked:
            sampled = now
        if worked and any(next(node.pieces, node) is not node for node in nodes):  # one piece was done
            continue
        if calm:
            for node in nodes:
                node.say()
        took_turn = turns.take(now, bool(worked), calm)
        if not took_turn and reception.waiting and (worked or calm):
            reception.serve().report()


def first_line(error: Exception) -> str:
    """First line of an error's text."""
    return (str(error).splitlines() or [type(error).__name__])[0]
