# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Serves ROS services so that no client can hold up the control loop.

A server waits up to 0.1 s for a client that it does not see, such as one that has left, and rclpy holds the
interpreter all the while: the loop stands still. So requests come in and answers go out in threads of their
own, through the C functions of rcl, which leave the interpreter to the loop. The callbacks run in the loop
between two samples, one parameter at a time, so that nothing in a node needs a lock.
"""

import ctypes
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.callback_groups import CallbackGroup
from rclpy.guard_condition import GuardCondition
from rclpy.parameter import Parameter
from rclpy.service import Service

from valve_control.nodes import rclpy_internals
from valve_control.nodes.rclpy_internals import OK, FirstList, MessageFunctions, RequestId, WaitSet

MOST_ENTRIES = 500  # of the list in a request; what is longer is not looked at
MOST_WAITING = 64  # requests; more wait in the middleware
SENDERS = 4  # threads, each of which a client that has left holds up for 0.1 s


class Unwatched(CallbackGroup):
    """Callback group that the executor ignores; its entities are polled instead."""

    def can_execute(self, entity: Any) -> bool:
        """False, always."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """False, always."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing: no execution was begun."""


class _Server:
    """One service, handled with rcl's own functions."""

    def __init__(self, node: Any, service: Service) -> None:
        self.node = node
        self.service = service
        self.request = MessageFunctions(service.srv_type.Request)
        self.response = MessageFunctions(service.srv_type.Response)
        # Requests that begin with anything else have a size of their own.
        first = next(iter(service.srv_type.Request.get_fields_and_field_types().values()), "")
        self.has_list = first.startswith("sequence<")
        self.pointer = ctypes.c_void_p(service.handle.pointer)


class _Request(NamedTuple):
    """One request that waits for its answer."""

    server: _Server
    sender: RequestId
    message: int  # the C message
    size: int  # of its list


class Reception:
    """Receives the requests of all services of ``nodes``; each call of ``serve`` answers a part of one."""

    def __init__(self, nodes: Sequence[Any]) -> None:
        self._rcl = rclpy_internals.rcl()
        self._rcutils = rclpy_internals.rcutils()
        self._servers = [_Server(node, service) for node in nodes for service in node.services]
        for server in self._servers:
            server.service.callback_group = Unwatched()
            server.service.handle.__enter__()  # not destroyed before `close`
        self._waiting: deque[_Request] = deque()
        self._parts: Iterator[None] | None = None
        self._serving: Any = None  # node of the parts
        self._room = threading.Semaphore(MOST_WAITING)
        self._closed = False
        self._bell = GuardCondition(None, None)
        self._senders = ThreadPoolExecutor(SENDERS, "send_response")
        self._senders.submit(int)  # the first task starts a thread, which takes some periods
        self._taker = threading.Thread(target=self._take, name="take_request", daemon=True)
        self._taker.start()

    @property
    def waiting(self) -> bool:
        """Whether a request waits."""
        return self._parts is not None or bool(self._waiting)

    def serve(self) -> Any:
        """Do the next part of the oldest request; returns its node. Call it only if one is ``waiting``."""
        if self._parts is None:
            request = self._waiting.popleft()
            self._room.release()
            self._serving = request.server.node
            self._parts = self._answered(request)
        if next(self._parts, self) is self:
            self._parts = None
        return self._serving

    def close(self) -> None:
        """Send the answers that are ready; accept no more requests."""
        self._closed = True
        self._bell.trigger()
        self._room.release()
        self._taker.join()
        self._senders.shutdown(wait=True)
        for server in self._servers:
            server.service.handle.__exit__(None, None, None)

    # Threads: nothing here touches a node

    def _take(self) -> None:
        context = rclpy.get_default_context()
        wait_set = WaitSet(0, 1, 0, 0, len(self._servers), 0, context.handle)
        while not self._closed:
            wait_set.clear_entities()
            wait_set.add_guard_condition(self._bell.handle)
            for server in self._servers:
                wait_set.add_service(server.service.handle)
            wait_set.wait(-1)
            for i, server in enumerate(self._servers):
                if wait_set.is_ready("service", i) and not self._closed:
                    self._room.acquire()
                    self._take_one(server)

    def _take_one(self, server: _Server) -> None:
        sender = RequestId()
        message = server.request.create()
        if self._rcl.rcl_take_request(server.pointer, ctypes.byref(sender), message) != OK:
            self._rcutils.rcutils_reset_error()
            server.request.destroy(message)
            self._room.release()
            return
        size = FirstList.from_address(message).size if server.has_list else 0
        self._waiting.append(_Request(server, sender, message, size))

    def _send(self, server: _Server, sender: RequestId, message: int) -> None:
        # A client that has left is no error; there is nobody to tell.
        self._rcl.rcl_send_response(server.pointer, ctypes.byref(sender), message)
        self._rcutils.rcutils_reset_error()
        server.response.destroy(message)

    # In the loop

    def _answered(self, request: _Request) -> Iterator[None]:
        server, service = request.server, request.server.service
        message = server.response.create()  # an empty answer, unless there is another
        if request.size > MOST_ENTRIES:
            server.request.destroy(request.message)
            server.node.get_logger().warning(
                f"{service.service_name}: a request with {request.size} entries refused; "
                f"{MOST_ENTRIES} is the most"
            )
        else:
            asked = server.request.to_python(request.message)
            server.request.destroy(request.message)
            yield  # a sample's turn: each part takes milliseconds
            response = service.srv_type.Response()
            try:
                if service.srv_type is SetParameters:
                    yield from _set_one_by_one(server.node, asked, response)
                else:
                    response = service.callback(asked, response)
                yield
                server.response.from_python(response, message)
            except Exception as error:  # whatever a client sends must not end the loop
                server.node.get_logger().error(f"{service.service_name}: {error}")
                server.response.destroy(message)  # fields before the one that fails are set
                message = server.response.create()
        self._senders.submit(self._send, server, request.sender, message)


def _set_one_by_one(node: Any, request: Any, response: Any) -> Iterator[None]:
    """Set parameters as rclpy does, with a pause after each: a whole file of them takes many periods."""
    for i, message in enumerate(request.parameters):
        if i > 0:
            yield
        try:
            result = node.set_parameters_atomically([Parameter.from_parameter_msg(message)])
        except Exception as error:  # of rclpy's parameters: not declared, of no known type ...
            result = SetParametersResult(successful=False, reason=str(error))
        response.results.append(result)
