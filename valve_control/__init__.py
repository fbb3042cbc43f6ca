# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Controls a proportional valve. Begin with docs/tutorials/notebook.ipynb or help(valve_control.simulate).

simulate, compare   run one law, or all laws, on a simulated valve
identify, tune      fit a model of a valve to a test; search the gains of a law for it
margins             gain, phase and delay margin of given gains
analyze, replay     indices and spectra of a bag or log; its readings through a law
load                read a parameter file; commission, export, study: only as `valve-control` on the shell
"""

from typing import TYPE_CHECKING, Any

__version__ = "1.0.0"
__all__ = [
    "simulate", "compare", "identify", "tune", "margins", "analyze", "replay", "load",
    "BagError", "LawError", "ParameterError",
]  # fmt: skip

if TYPE_CHECKING:
    from valve_control.api import analyze, compare, identify, load, margins, replay, simulate, tune
    from valve_control.control.compiling import LawError
    from valve_control.parameter import ParameterError
    from valve_control.recordings.bags.errors import BagError


def __getattr__(name: str) -> Any:
    """The tasks, which are imported when they are first asked for: nodes need none of them."""
    if name not in __all__:
        raise AttributeError(f"no {name!r} in {__name__}; export, study, commission are shell commands")
    from valve_control import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
