"""The loop in which nodes run: samples first, everything else in the time between them.

The standard executor looks at every entity of a node, some twenty services and timers, at each wake-up. Here
a wait set holds only the subscriptions on which a node works; parameters, services, timers and discovery get
their turn right after a sample, now and then, one node at a time.
"""

import gc
import signal
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy._rclpy_pybind11 import WaitSet
from rclpy.executors import SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from valve_control.nodes.adapter import PolledSubscription
from valve_control.parameters.table import ParameterError

CHORES = 0.05  # s between two looks at a node's services, parameters and timers beside samples ...
IDLE_CHORES = 0.01  # s  ... and while there are none; at most twice that


_stopped: list[int] = []  # signals that have come


def stopping() -> bool:
    """Whether SIGINT or SIGTERM has come."""
    return bool(_stopped)


class Failure(RuntimeError):
    """What ends the run with exit status 1; the message is one sentence for the user."""


class Worker(Node):
    """Node with work of its own beside callbacks."""

    def inputs(self) -> Sequence[PolledSubscription]:
        """Subscriptions whose messages call for ``work``."""
        return ()

    def due(self) -> float:
        """Time (`time.monotonic`) at which ``work`` is called though nothing has come."""
        return float("inf")

    def work(self) -> bool:
        """Do what is to do now; whether something was done.

        Called only when a message has come on one of ``inputs``, or ``due`` has passed.
        """
        return False

    def report(self) -> None:
        """Publish what nobody waits for.

        Called when all nodes of the process have worked, of those that did something, and after a callback.
        """

    def finish(self) -> None:
        """Last words before the node is destroyed."""

    def deliver(self) -> None:
        """Wait until they have arrived, for a moment."""


def run(make: Callable[[], Sequence[Any]]) -> int:
    """Work with the nodes that ``make`` gives until SIGINT or SIGTERM; returns the exit status."""

    def stop(number: int, frame: Any) -> None:
        _stopped.append(number)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy has no public type for bad --ros-args
        print(f"{sys.argv[0]}: {first_line(error)}", file=sys.stderr)
        return 2
    status = 0
    nodes: Sequence[Any] = ()
    executors: list[SingleThreadedExecutor] = []
    try:
        nodes = make()
        for node in nodes:
            executors.append(SingleThreadedExecutor())
            executors[-1].add_node(node)
        # A collection of everything that the imports brought takes tens of milliseconds, many samples.
        gc.collect()
        gc.freeze()
        _loop(nodes, executors)
    except ParameterError as error:
        print(f"valve_control: {error}", file=sys.stderr)
        status = 2
    except Failure as error:
        print(f"valve_control: {error}", file=sys.stderr)
        status = 1
    finally:
        for act in ("finish", "deliver"):
            for node in nodes:
                try:
                    getattr(node, act)()
                except Exception as error:  # the other valves must hear their 0 V whatever this one does
                    print(f"valve_control: {node.get_name()}: {first_line(error)}", file=sys.stderr)
                    status = 1
        for executor in executors:
            executor.shutdown(timeout_sec=0.0)
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return status


def _loop(nodes: Sequence[Any], executors: Sequence[SingleThreadedExecutor]) -> None:
    context = rclpy.get_default_context()
    rest = IDLE_CHORES / len(nodes)
    busy = False
    chores = time.monotonic()
    turn = 0
    wait_set: Any = None
    size = -1
    while not _stopped:
        inputs = [(node, subscription.handle) for node in nodes for subscription in node.inputs()]
        if len(inputs) != size:
            size = len(inputs)
            wait_set = WaitSet(size, 0, 0, 0, 0, 0, context.handle)
        wake = min(chores + rest, *(node.due() for node in nodes))
        pause = wake - time.monotonic()
        worked: list[Any] = []
        if inputs:
            wait_set.clear_entities()
            for _, handle in inputs:
                wait_set.add_subscription(handle)
            wait_set.wait(max(0, int(pause * 1e9)))
            worked += [
                node
                for i, (node, _) in enumerate(inputs)
                if wait_set.is_ready("subscription", i) and node.work()
            ]
        elif pause > 0.0:
            time.sleep(pause)
        now = time.monotonic()
        worked += [node for node in nodes if node.due() <= now and node.work()]
        for node in worked:
            node.report()
        busy = busy or bool(worked)
        if now >= chores + rest or (worked and now >= chores):
            chores = now
            # After something was done more may wait: look again after the next sample.
            if _chore(executors[turn]):
                nodes[turn].report()
            else:
                rest = (CHORES if busy else IDLE_CHORES) / len(nodes)
                busy = False
                chores = time.monotonic() + rest
                turn = (turn + 1) % len(executors)


def _chore(executor: SingleThreadedExecutor) -> bool:
    """Run one callback that is ready; whether there was one."""
    try:
        handler, _, _ = executor.wait_for_ready_callbacks(0.0)
    except TimeoutException:
        return False
    handler()
    handler.result()
    return True


def first_line(error: Exception) -> str:
    """The first line of an error's text."""
    return (str(error).splitlines() or [type(error).__name__])[0]
