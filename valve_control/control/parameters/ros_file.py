# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads and writes parameter files of ROS 2, and values in the types that ROS gives them."""

import math
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from valve_control import outputs
from valve_control.parameter import Parameter, ParameterError, Value, Values

LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# What PyYAML raises: also for a date that does not exist, a tag that does not fit its value, deep nesting.
WRONG = (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError, RecursionError)


class _RosLoader(LOADER):  # type: ignore[misc]  # one of two classes
    """Reads numbers as rcl does: 1:30, 1_000 and 0b11, which are numbers of YAML 1.1, are words."""


_NUMBERS = {
    "tag:yaml.org,2002:int": re.compile(r"[-+]?(0[0-7]*|[1-9][0-9]*|0x[0-9a-fA-F]+)$"),
    "tag:yaml.org,2002:float": re.compile(
        r"[-+]?[0-9]+\.[0-9]*([eE][-+][0-9]+)?$|[-+]?\.[0-9]+([eE][-+][0-9]+)?$"
        r"|[-+]?\.(inf|Inf|INF)$|\.(nan|NaN|NAN)$"
    ),
}
_RosLoader.yaml_implicit_resolvers = {
    first: [(tag, _NUMBERS.get(tag, pattern)) for tag, pattern in known]
    for first, known in LOADER.yaml_implicit_resolvers.items()
}


def parsed(text: str) -> Any:
    """Content of the YAML ``text`` as rcl reads it. Raises ValueError with the reason in one line."""
    try:
        return yaml.load(text, _RosLoader)
    except WRONG as error:
        raise ValueError(" ".join(str(error).split())) from error


def is_of_ros(name: str) -> bool:
    """Whether ``name`` is a parameter that ROS itself gives to every node."""
    return name in ("use_sim_time", "start_type_description_service") or name.startswith("qos_overrides.")


def config_folder() -> Path:
    """Folder of the package's own parameter files: of the source tree, or where the package is installed."""
    package = Path(__file__).resolve().parents[2]
    if (package.parent / "config" / "d3fxe.yaml").is_file():
        return package.parent / "config"
    shares = (above / "share" / "valve_control" / "config" for above in package.parents)
    return next((folder for folder in shares if folder.is_dir()), package.parent / "config")


def _flat(path: str, tree: dict[Any, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        new = _flat(path, value, f"{name}.") if isinstance(value, dict) else {name: value}
        if twice := flat.keys() & new.keys():
            raise ParameterError(
                f"parameter file {path} gives {min(twice)} twice, with dots and by indentation"
            )
        flat |= new
    return flat


def _number(value: Any) -> Any:
    """Turn a word into a number if it is one: YAML 1.1 reads 1.44e6 as a word, ROS as a number.

    1_000, which Python takes for a number too, stays a word as in ROS.
    """
    if isinstance(value, str) and "_" not in value:
        try:
            return float(value)
        except ValueError:
            return value
    return value


def from_yaml(parameter: Parameter, value: Any) -> Value:
    """Value of a YAML file in the type that ROS would give it. Raises ParameterError."""
    if isinstance(parameter.default, float):
        value = _number(value)
    elif parameter.type_name == "list of doubles" and isinstance(value, list):
        value = [_number(v) for v in value]
    return parameter.check(value)


def from_text(parameter: Parameter, text: str) -> Value:
    """Value of a word of a command line in the type that ROS would give it. Raises ParameterError."""
    if isinstance(parameter.default, str):
        return parameter.check(text)
    try:
        value = parsed(text)
    except ValueError as error:
        raise ParameterError(f"'{text}' of {parameter.name} is not a value") from error
    return from_yaml(parameter, value)


def save(path: Path, node: str, values: Values) -> None:
    """Write ``values`` of ``node`` (its full name) as a ROS 2 parameter file. Raises OSError."""
    outputs.write(str(path), as_yaml({node: values}))


def as_yaml(sections: Mapping[str, Values], comments: Sequence[str] = ()) -> str:
    """Text of a ROS 2 parameter file; ``sections``: values by full name of a node, or by a pattern."""
    trees: dict[str, Any] = {}
    for node, values in sections.items():
        tree: dict[str, Any] = {}
        for name in _one_by_one(values):
            value = values[name]
            *groups, last = name.split(".")
            branch = tree
            for group in groups:
                branch = branch.setdefault(group, {})
            branch[last] = _written(value)
        trees[node] = {"ros__parameters": tree}
    head = "".join(f"# {line}\n" for comment in comments for line in comment.splitlines())
    return head + yaml.dump(trees, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=110)


def _one_by_one(values: Values) -> list[str]:
    """Names in an order in which a node with its defaults can take them one after the other.

    A model is complete before it is chosen, and never has more zeros than its poles allow.
    """
    ranks = {"denominator": 0, "numerator": 1}
    groups = list(dict.fromkeys(name.rpartition(".")[0] for name in values))

    def place(name: str) -> tuple[int, int]:
        group, _, last = name.rpartition(".")
        return groups.index(group), ranks.get(last, 2)

    return sorted(values, key=place)


class _Dumper(yaml.SafeDumper):
    """Writes YAML as the parser of ROS 2 takes it: no anchors; quoted words, so that "2" and "y" stay so."""

    def ignore_aliases(self, data: Any) -> bool:
        """True: what occurs twice is written twice."""
        return True

    def represent_float(self, data: float) -> yaml.ScalarNode:
        """Write a subnormal number, which the parser takes for a word, as 0.0."""
        subnormal = 0.0 < abs(data) < sys.float_info.min
        return super().represent_float(math.copysign(0.0, data) if subnormal else data)


class _Word(str):
    """A value that is a string, written in quotes; names are not."""


_Dumper.add_representer(float, _Dumper.represent_float)

_Dumper.add_representer(
    _Word, lambda dumper, word: dumper.represent_scalar("tag:yaml.org,2002:str", word, style='"')
)


def _written(value: Value) -> Any:
    if isinstance(value, list):
        return [_Word(v) if isinstance(v, str) else v for v in value]
    return _Word(value) if isinstance(value, str) else value


class Section(NamedTuple):
    """What a parameter file has for one node, or for all whose full names match a pattern."""

    pattern: str  # such as /controller, /**/controller or /**
    values: dict[str, Any]  # by the parameters' full names, not yet checked

    @property
    def node(self) -> str:
        """The node's name without namespace; it has an asterisk if it stands for several."""
        return self.pattern.rsplit("/", 1)[-1]


def sections(path: str) -> list[Section]:
    """Sections of a ROS 2 parameter file in their order. Raises ParameterError."""
    try:
        tree = parsed(Path(os.path.expanduser(path)).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(
            f"parameter file {path} cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from error
    except ValueError as error:
        raise ParameterError(f"parameter file {path} is not YAML: {error}") from error
    if not isinstance(tree, dict) or not tree:
        raise ParameterError(f"parameter file {path} must hold 'node: ros__parameters: …' sections")
    try:
        return list(_sections(path, tree, ""))
    except RecursionError as error:
        raise ParameterError(f"parameter file {path} has an alias of a part within that part") from error


def _sections(path: str, tree: dict[Any, Any], above: str) -> Iterator[Section]:
    for key, content in tree.items():
        pattern = f"{above}/{str(key).lstrip('/')}"
        if not isinstance(content, dict):
            raise ParameterError(f"section '{pattern}' of {path} has no 'ros__parameters:' below it")
        if "ros__parameters" not in content:
            yield from _sections(path, content, pattern)
            continue
        values = content["ros__parameters"]
        if not isinstance(values, dict):
            raise ParameterError(f"section '{pattern}' of {path} has no parameters below 'ros__parameters:'")
        yield Section(pattern, _flat(path, values))


def as_text(value: Value) -> str:
    """``value`` as YAML would have it; a word that YAML takes for a number or a switch is in quotes."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(str(v) for v in value) + "]"
    if not isinstance(value, str):
        return str(value)
    try:
        return value if isinstance(parsed(value), str) else f'"{value}"'
    except ValueError:
        return f'"{value}"'
