# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Controls a proportional valve, after Bu and Yao; in Python begin with help(valve_control.simulate)."""

from typing import TYPE_CHECKING, Any

__version__ = "1.0.0"
__all__ = [
    "BagError",
    "ParameterError",
    "analyze",
    "compare",
    "identify",
    "load",
    "margins",
    "replay",
    "simulate",
    "tune",
]

if TYPE_CHECKING:
    from valve_control.api import analyze, compare, identify, load, margins, replay, simulate, tune
    from valve_control.parameter import ParameterError
    from valve_control.recordings.bags.errors import BagError


def __getattr__(name: str) -> Any:
    """The tasks, which are imported when they are first asked for: nodes need none of them."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from valve_control import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
