# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Places of a law's functions in steps for any law; ``binding.places_of`` names what fills them."""

from typing import Any

from valve_control.control.laws.signals import Start


def law_initial(p: Any, start: Start) -> Any:
    """Place of the law's ``initial``."""
    raise NotImplementedError


def law_step(p: Any, s: Any, command: float, measurement: float, offset: float) -> Any:
    """Place of the law's ``step``."""
    raise NotImplementedError


def law_hold(p: Any, s: Any, command: float, measurement: float, voltage: float) -> Any:
    """Place of the law's ``hold``."""
    raise NotImplementedError
