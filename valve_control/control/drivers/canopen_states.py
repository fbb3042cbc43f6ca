# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""State machine of a CiA 408 device: states in the status word, control words from one to the next.

Bits 0 to 3 are D (disabled), H (hold), M (device mode active) and R (ready) in the status word, R being reset
in the control word (Moog, firmware manuals RKP-D B99224-DV007 and ACV B99224-DV018, there marked as CiA 408).
"""

LOCAL = 0x10  # status word: the device listens to its own control word
DISABLED, HOLD, ACTIVE = 0b001, 0b011, 0b111  # control words
RESET = 0b1000
STATES = {
    0b0000: "NOT READY or FAULT INIT",
    0b1000: "INIT",
    0b1001: "DISABLED",
    0b1011: "HOLD",
    0b1111: "ACTIVE",
    0b0001: "FAULT DISABLED",
    0b0011: "FAULT HOLD",
    0b0111: "FAULT REACTION",
}


def state(status: int) -> str:
    """Name of the state that ``status`` tells."""
    return STATES.get(status & 0xF, f"unknown state {status & 0xF:04b}")


def active(status: int) -> bool:
    """Whether the set point moves the spool."""
    return status & 0xF == 0b1111


def fault(status: int) -> bool:
    """Whether the device has a fault, or is not ready."""
    return not status & RESET


def towards_active(status: int) -> int:
    """Control word for the next state on the way from ``status`` to ACTIVE, one state at a time."""
    return {0b1000: DISABLED, 0b1001: HOLD}.get(status & 0xF, ACTIVE) if not fault(status) else DISABLED


def reset(status: int, edge: bool) -> int:
    """Control word that resets a fault: first without, then with the ``edge`` of bit 3; states stay."""
    return status & HOLD | (RESET if edge else 0)
