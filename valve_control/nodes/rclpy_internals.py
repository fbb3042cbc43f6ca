# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Collects in one place what the nodes use of rclpy and rcl beyond the public interface.

rclpy's executor looks at every entity of a node at each wake-up, and its services hold the interpreter while
they wait for a client. The loop (loop.py) and the reception of services (services.py) therefore use what is
below them. test/nodes/test_rclpy_internals.py names what is missing if another version of rclpy changed it.
"""

import ctypes
from collections.abc import Callable
from typing import Any

from rclpy._rclpy_pybind11 import RCLError as RCLError
from rclpy._rclpy_pybind11 import WaitSet as WaitSet

OK = 0  # RCL_RET_OK


class RequestId(ctypes.Structure):
    """rmw_request_id_t: who sent a request, and with which number; with spare room."""

    _fields_ = (("bytes", ctypes.c_uint8 * 64),)


class FirstList(ctypes.Structure):
    """The sequence with which a request begins."""

    _fields_ = (("data", ctypes.c_void_p), ("size", ctypes.c_size_t), ("capacity", ctypes.c_size_t))


class MessageFunctions:
    """The C functions of a message class, which rclpy itself calls too; a node uses the class already."""

    def __init__(self, message_class: Any) -> None:
        kind = type(message_class)
        self.create = ctypes.CFUNCTYPE(ctypes.c_void_p)(_address(kind._CREATE_ROS_MESSAGE))
        self.destroy = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_address(kind._DESTROY_ROS_MESSAGE))
        self.to_python = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)(_address(kind._CONVERT_TO_PY))
        self.from_python = ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)(
            _address(kind._CONVERT_FROM_PY)
        )


def rcl() -> ctypes.CDLL:
    """The C library rcl; Python's lock is released while its functions run."""
    library = ctypes.CDLL("librcl.so")
    for function in (library.rcl_take_request, library.rcl_send_response):
        function.argtypes = [ctypes.c_void_p, ctypes.POINTER(RequestId), ctypes.c_void_p]
        function.restype = ctypes.c_int
    return library


def rcutils() -> ctypes.CDLL:
    """The C library rcutils, which keeps rcl's error messages."""
    return ctypes.CDLL("librcutils.so")


def override(node: Any, name: str) -> Any:
    """Value that the command line gave the parameter ``name`` of ``node``, None if it gave none."""
    return node._parameter_overrides.get(name)


def call_timer(timer: Any) -> None:
    """Run the callback of a timer that is ready; its next period begins."""
    with timer.handle:
        timer.handle.call_timer()
    timer.callback()


def sender(publisher: Any) -> Callable[[bytes], None]:
    """Function that publishes a serialized message, for as long as ``publisher`` is not destroyed.

    rclpy's own ``publish`` takes half as long again, since it looks at the message's type.
    """
    send: Callable[[bytes], None] = publisher.handle.publish_raw
    return send


def _address(capsule: Any) -> int:
    name = ctypes.pythonapi.PyCapsule_GetName
    name.restype, name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype, pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return int(pointer(capsule, name(capsule)))
