# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Reads parameters from ROS 2 YAML files and from --set for the command line, and writes such files."""

import difflib
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from valve_control import inputs, outputs
from valve_control.control.parameters.table import NODE_ONLY, NODES, OTHERS, is_of_ros
from valve_control.parameter import Parameter, ParameterError, Table, Value, Values, lookup, word

OF_ALL = {"sample_period", "u_max", "command_limit"}  # of the machine: a file of one law has them for all


def config_folder() -> Path:
    """Folder of the package's own parameter files: of the source tree, or where the package is installed."""
    package = Path(__file__).resolve().parents[2]
    if (package.parent / "config" / "d3fxe.yaml").is_file():
        return package.parent / "config"
    shares = (above / "share" / "valve_control" / "config" for above in package.parents)
    return next((folder for folder in shares if folder.is_dir()), package.parent / "config")


def _flat(tree: dict[Any, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            flat.update(_flat(value, f"{name}."))
        else:
            flat[name] = value
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
        value = inputs.from_yaml(text)
    except ValueError as error:
        raise ParameterError(f"'{text}' of {parameter.name} is not a value") from error
    return from_yaml(parameter, value)


def save(path: Path, node: str, values: Values) -> None:
    """Write ``values`` of ``node`` (its full name) as a ROS 2 parameter file. Raises OSError."""
    outputs.write(str(path), as_yaml({node: values}))


def as_yaml(sections: Mapping[str, Values], comments: Sequence[str] = ()) -> str:
    """Text of a ROS 2 parameter file; ``sections``: values by full name of a node, or by a pattern.

    Its head says so if the file is one that `ros2 param load` cannot load.
    """
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
    comments = [*comments, *_not_by_param_load(sections)]
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


def _not_by_param_load(sections: Mapping[str, Values]) -> list[str]:
    """Comment on a file that `ros2 param load` cannot load, and why; none for others."""
    words = [name for values in sections.values() for name, value in values.items() if _turns(value)]
    if len(sections) > 1:
        reason = "it gives a node the sections of all nodes"
    elif words:
        reason = f"it changes {', '.join(words)}"
    else:
        return []
    return [f"ros2 param load cannot load this file: {reason}. Use --params-file or ~/load_parameters."]


def _turns(value: Value) -> bool:
    """Whether `ros2 param load` makes something else of ``value``: it reads each value of a file twice.

    The second time as the text that Python has for it, which is 2 for "2", a number. Of 1.0e-05 it makes the
    word 1e-05, which the nodes take for the number.
    """
    try:
        again = inputs.from_yaml(str(value), of_python=True)
    except ValueError:
        return True
    again = "" if again is None else again
    if isinstance(value, float):
        again = _number(again)
    if isinstance(value, list) and isinstance(again, list):
        again = [_number(a) if isinstance(v, float) else a for a, v in zip(again, value, strict=False)]
        return again != value or [type(entry) for entry in again] != [type(entry) for entry in value]
    return again != value or type(again) is not type(value)


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
    inputs.check(path, "parameter file")
    file = inputs.expanded(path, "parameter file")
    try:
        tree = inputs.from_yaml(file.read_text(encoding="utf-8"))
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
        yield Section(pattern, _flat(values))


def load(path: str, notes: list[str] | None = None, nodes: Mapping[str, Table] = NODES) -> dict[str, Values]:
    """Checked values of a ROS 2 parameter file, by node name. Raises ParameterError.

    A section is named after one of ``nodes`` (`controller`, with or without a namespace before
    it) or is a wildcard (`/**`), whose parameters go to each node that has them. ``notes`` gets a sentence
    about the sections of other nodes; a file that has nothing else is refused.
    """
    result: dict[str, Values] = {name: {} for name in nodes}
    found = sections(path)
    others: list[str] = []
    for section in found:
        if "*" not in section.node and section.node not in nodes:
            others.append(section.pattern)
            continue
        targets = list(nodes) if "*" in section.node else [section.node]
        for name, value in section.values.items():
            if is_of_ros(name):
                continue
            try:
                _assign(result, {node: nodes[node] for node in targets}, name, value)
            except ParameterError as error:
                raise ParameterError(f"{path}: {error}") from error
    _tell_others(path, others, len(others) == len(found), notes, nodes)
    if notes is not None:
        notes += _several(path, found, nodes)
    return result


def _several(path: str, found: Sequence[Section], nodes: Mapping[str, Table]) -> Iterator[str]:
    """Sentences about nodes of which a file has sections in several namespaces."""
    for node in nodes:
        patterns = [section.pattern for section in found if section.node == node]
        if len(patterns) > 1:
            yield f"{path}: of {', '.join(patterns)} the last one counts where they differ"


def _tell_others(
    path: str, others: Sequence[str], alone: bool, notes: list[str] | None, nodes: Mapping[str, Table]
) -> None:
    """Raise ParameterError for sections that were meant for one of ``nodes``; note the others."""
    for section in others:
        name = section.split("/")[-1]
        near = difflib.get_close_matches(name, nodes, n=1, cutoff=0.7)
        if near and name not in (*NODES, *OTHERS):
            raise ParameterError(f"{path}: there is no node '{section}'; did you mean {near[0]}?")
    told = ", ".join(f"'{section}'" for section in others)
    if alone:
        raise ParameterError(f"{path} has parameters for {told} alone; the nodes are {', '.join(nodes)}")
    if others and notes is not None:
        notes.append(f"{path}: the parameters of {told} are left out; the nodes are {', '.join(nodes)}")


def _assign(result: dict[str, Values], targets: Mapping[str, Table], name: str, value: Any) -> None:
    owners = [node for node, table in targets.items() if any(p.name == name for p in table)]
    if not owners:
        lookup(_joined(targets), name)
    for node in owners:
        result[node][name] = from_yaml(lookup(targets[node], name), value)


def _joined(nodes: Mapping[str, Table]) -> Table:
    return tuple(parameter for table in nodes.values() for parameter in table)


def given(
    paths: Sequence[str],
    direct: Mapping[str, Mapping[str, Any]],
    settings: Sequence[str],
    notes: list[str] | None = None,
    nodes: Mapping[str, Table] = NODES,
    law: str = "",
) -> dict[str, dict[str, Any]]:
    """Values by node from parameter files, options of their own (``direct``) and --set; later ones win.

    ``nodes``: which there are, with their parameters; ``notes`` gets what is to be told of the files;
    ``law``: the controller's values are for this law, so that files of other laws are left out.
    Raises ParameterError.
    """
    changes: dict[str, dict[str, Any]] = {node: {} for node in nodes}
    loaded = [load(path, notes, nodes) for path in paths]
    owners = of_laws([values.get("controller", {}) for values in loaded])
    for file, owner in zip(loaded, owners, strict=True):
        for node, values in file.items():
            others = node == "controller" and law and owner not in ("", law)
            changes[node].update({name: v for name, v in values.items() if not others or name in OF_ALL})
    for node, options in direct.items():
        changes[node].update({name: value for name, value in options.items() if value is not None})
    told: dict[str, str] = {}
    for text in settings:
        name, by_node = parse_setting(text, nodes)
        if name in NODE_ONLY or lookup(_joined(nodes), name).text.startswith(("node: ", "node, ")):
            raise ParameterError(f"--set {text} has no effect here, because running nodes alone read {name}")
        if told.setdefault(name, text) != text:
            raise ParameterError(f"--set {told[name]} and --set {text} contradict each other")
        for node, value in by_node.items():
            option = direct.get(node, {}).get(name)
            if option is not None and option != value:
                raise ParameterError(
                    f"--set {text} contradicts the option for {name}, {option}; give one of them"
                )
            changes[node][name] = value
    return changes


def without_effect(
    settings: Sequence[str], changes: Mapping[str, Values], nodes: Mapping[str, Table] = NODES
) -> list[str]:
    """Sentences about custom models in ``changes``, values by node, that nobody chooses.

    Raises ParameterError if one comes from --set (``settings``).
    """
    direct = {text.partition("=")[0].strip() for text in settings}
    notes: list[str] = []
    for node, values in changes.items():
        for name in values:
            prefix, dot, last = name.rpartition(".")
            choice = f"{prefix}.model" if dot else "valve"
            if last not in ("numerator", "denominator") or name not in {p.name for p in nodes[node]}:
                continue
            chosen = values.get(choice, lookup(nodes[node], choice).default)
            if chosen == "custom":
                continue
            sentence = f"{name} has no effect, because {choice} is {chosen}, not custom"
            if name in direct:
                raise ParameterError(f"{sentence}; give --set {choice}=custom too, or leave out --set {name}")
            if choice not in values:  # a node writes both
                notes.append(sentence)
    return notes


def refuse_others(settings: Sequence[str], nodes: Mapping[str, Table], why: str) -> None:
    """Raise ParameterError if one of the ``settings`` (--set) is of none of ``nodes``; ``why`` it is not."""
    for text in settings:
        name = text.partition("=")[0].strip()
        if not any(p.name == name for table in nodes.values() for p in table):
            raise ParameterError(f"{why}, so it takes no --set {name}")


def of_laws(files: Sequence[Values]) -> list[str]:
    """Law to which each file's values of the controller belong; "": to all laws.

    A file belongs to the law that it names as ``controller``. It belongs to all laws if it has parameters of
    others too and no other file names another law.
    """
    named = [word(values, "controller") if "controller" in values else "" for values in files]
    several = len(set(filter(None, named))) > 1
    return [
        law if several or not any(_law_of(name) not in ("", law) for name in values) else ""
        for law, values in zip(named, files, strict=True)
    ]


def _law_of(name: str) -> str:
    """Law whose parameter ``name`` is; "": of all laws."""
    head = name.partition(".")[0]
    return head if head in lookup(NODES["controller"], "controller").choices else ""


def parse_setting(text: str, nodes: Mapping[str, Table] = NODES) -> tuple[str, dict[str, Value]]:
    """``name=value`` of --set as (name, value by node); whole numbers may stand for doubles."""
    name, equals, word = text.partition("=")
    if not equals:
        raise ParameterError(f"--set takes name=value, not '{text}'")
    name = name.strip()
    parameter = lookup(_joined(nodes), name)
    value: Any
    if isinstance(parameter.default, str):
        value = word.strip()
    else:
        try:
            value = inputs.from_yaml(word)
        except ValueError as error:
            raise ParameterError(f"'{word}' of --set {name} is not a value") from error
        if isinstance(parameter.default, float) and type(value) is int:
            value = float(value)
        if isinstance(parameter.default, list) and isinstance(value, list):
            value = [float(v) if type(v) is int else v for v in value]
    by_node = {
        node: from_yaml(lookup(table, name), value)
        for node, table in nodes.items()
        if any(p.name == name for p in table)
    }
    return name, by_node
