"""Checks the arguments of launch files and turns them into ROS arguments; called by the files in launch/."""

import math
from pathlib import Path

from valve_control.laws.registry import LAWS, REFUSED
from valve_control.parameter import ParameterError, lookup, one_of
from valve_control.parameters import files
from valve_control.parameters.table import NODES


def sample_period(rate: str) -> float:
    """Sample period [s] of a ``rate`` [Hz]. Raises ParameterError."""
    parameter = lookup(NODES["controller"], "sample_period")
    low, high = 1.0 / parameter.high, 1.0 / parameter.low
    hertz = _number("rate", rate)
    if not low <= hertz <= high:
        raise ParameterError(f"rate is {rate} Hz; it must lie between {low:g} and {high:g} Hz")
    return 1.0 / hertz


def duration(seconds: str) -> float:
    """Length of the command [s]. Raises ParameterError."""
    value = lookup(NODES["command_source"], "duration").check(_number("duration", seconds))
    assert isinstance(value, float)
    return value


def law_option(controller: str) -> str:
    """ROS option that makes ``controller`` the law: for a file of gains, or for the name of a law.

    Raises ParameterError.
    """
    return "-p" if _gains(controller) is None else "--params-file"


def law_value(controller: str) -> str:
    """What belongs to ``law_option``: a path, or ``controller:=NAME``. Raises ParameterError."""
    gains = _gains(controller)
    return f"controller:={controller}" if gains is None else str(gains)


def _gains(controller: str) -> Path | None:
    """File in config/ with the gains of ``controller``; None for a law that runs with its defaults."""
    names = {path.stem: path for path in sorted(files.config_folder().glob("*.yaml")) if _of_law(path)}
    if controller not in names and controller not in LAWS:
        known = one_of(dict.fromkeys([*LAWS, *names]))
        raise ParameterError("; ".join([f"controller is '{controller}'; it must be {known}", *REFUSED]))
    return names.get(controller)


def _of_law(path: Path) -> bool:
    """Whether a parameter file is for controllers alone."""
    return {section.node for section in files.sections(str(path))} == {"controller"}


def _number(name: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ParameterError(f"{name} is '{text}'; it must be a number")
    return number
