"""Parameters from ROS 2 YAML files and from --set, for the command line."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from valve_control import outputs
from valve_control.parameters.table import (
    NODES,
    Parameter,
    ParameterError,
    Table,
    Value,
    Values,
    lookup,
)


def config_folder() -> Path:
    """Folder of the package's own parameter files: of the source tree, or where the package is installed."""
    package = Path(__file__).resolve().parents[1]
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
    """YAML 1.1 reads 1.44e6 as a word, ROS as a number."""
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value


def from_yaml(parameter: Parameter, value: Any) -> Value:
    """A value of a YAML file, of the type that ROS would give it. Raises ParameterError."""
    if isinstance(parameter.default, float):
        value = _number(value)
    elif parameter.type_name == "list of doubles" and isinstance(value, list):
        value = [_number(v) for v in value]
    return parameter.check(value)


def save(path: Path, node: str, values: Values) -> None:
    """Write ``values`` of ``node`` (its full name) as a ROS 2 parameter file. Raises OSError."""
    outputs.write(str(path), as_yaml({node: values}))


def as_yaml(sections: Mapping[str, Values], comments: Sequence[str] = ()) -> str:
    """Values by node (its full name, or a pattern) as the text of a ROS 2 parameter file."""
    trees: dict[str, Any] = {}
    for node, values in sections.items():
        tree: dict[str, Any] = {}
        for name, value in values.items():
            *groups, last = name.split(".")
            branch = tree
            for group in groups:
                branch = branch.setdefault(group, {})
            branch[last] = value
        trees[node] = {"ros__parameters": tree}
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    head = "".join(f"# {line}\n" for line in comments)
    return head + yaml.dump(trees, Dumper=dumper, sort_keys=False, default_flow_style=None, width=110)


def load(path: str) -> dict[str, Values]:
    """Checked values of a ROS 2 parameter file, by node name. Raises ParameterError.

    A section is named after a node of this package (`controller`, with or without a namespace before
    it) or is a wildcard (`/**`), whose parameters go to each node that has them.
    """
    try:
        tree = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(
            f"parameter file {path} cannot be read: {getattr(error, 'strerror', None) or error}"
        ) from error
    except yaml.YAMLError as error:
        raise ParameterError(f"parameter file {path} is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(tree, dict):
        raise ParameterError(f"parameter file {path} must hold 'node: ros__parameters: …' sections")
    result: dict[str, Values] = {name: {} for name in NODES}
    for section, content in tree.items():
        if not isinstance(content, dict) or not isinstance(content.get("ros__parameters"), dict):
            raise ParameterError(f"section '{section}' of {path} has no 'ros__parameters:' below it")
        node = str(section).split("/")[-1]
        if "*" not in node and node not in NODES:
            continue
        targets = list(NODES) if "*" in node else [node]
        for name, value in _flat(content["ros__parameters"]).items():
            if name in ("use_sim_time", "start_type_description_service"):
                continue
            try:
                _assign(result, targets, name, value)
            except ParameterError as error:
                raise ParameterError(f"{path}: {error}") from error
    return result


def _assign(result: dict[str, Values], targets: list[str], name: str, value: Any) -> None:
    owners = [node for node in targets if any(p.name == name for p in NODES[node])]
    if not owners:
        lookup(_joined(targets), name)
    for node in owners:
        result[node][name] = from_yaml(lookup(NODES[node], name), value)


def _joined(nodes: list[str]) -> Table:
    return tuple(parameter for node in nodes for parameter in NODES[node])


def given(
    paths: Sequence[str], direct: Mapping[str, Mapping[str, Any]], settings: Sequence[str]
) -> dict[str, dict[str, Any]]:
    """Values by node from parameter files, options of their own, and --set; later ones win.

    Raises ParameterError.
    """
    changes: dict[str, dict[str, Any]] = {node: {} for node in NODES}
    for path in paths:
        for node, values in load(path).items():
            changes[node].update(values)
    for node, options in direct.items():
        changes[node].update({name: value for name, value in options.items() if value is not None})
    for text in settings:
        name, by_node = parse_setting(text)
        for node, value in by_node.items():
            changes[node][name] = value
    return changes


def parse_setting(text: str) -> tuple[str, dict[str, Value]]:
    """``name=value`` of --set as (name, value by node); whole numbers may stand for doubles."""
    name, equals, word = text.partition("=")
    if not equals:
        raise ParameterError(f"--set takes name=value, not '{text}'")
    name = name.strip()
    parameter = lookup(_joined(list(NODES)), name)
    value: Any
    if isinstance(parameter.default, str):
        value = word.strip()
    else:
        try:
            value = yaml.safe_load(word)
        except yaml.YAMLError as error:
            raise ParameterError(f"'{word}' of --set {name} is not a value") from error
        if isinstance(parameter.default, float) and type(value) is int:
            value = float(value)
        if isinstance(parameter.default, list) and isinstance(value, list):
            value = [float(v) if type(v) is int else v for v in value]
    by_node = {
        node: from_yaml(lookup(table, name), value)
        for node, table in NODES.items()
        if any(p.name == name for p in table)
    }
    return name, by_node
