# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The tasks as Python functions, for notebooks and scripts, with the names and defaults of the command line.

Parameters (of valve, gains, command) are names of files, what ``load`` returns, ``.parameters`` of a result,
or dicts by node (controller, valve_simulator, command_source): {"valve_simulator": {"lvdt.noise": 0.004}}.
Later ones win. A switch is True; None switches a limit off. ``command`` is an array with one number [V] per
sample, or a file. ``controller`` is the name of a law, or the ``LAW`` of your file.

The Result is a dict of numbers, in V, V/s and s if the name has no unit; print() shows a table. It also has:

    .arrays        signals by name, [samples]; .to_dataframe() has them as columns (of compare: rows of laws)
    .plot()        a figure of matplotlib, from simulate, compare, and identify with a test
    .law()         the law of simulate as a function: voltage [V] = law(command [V], reading [V])
    .parameters    those of the valve from identify, or the gains from tune; .parameters.save("gains.yaml")
    .passed        False if the gains of tune are not accepted; .parameters is then None
    .page          the report of analyze and replay in HTML
    .text          what print() shows

Progress and notes go to standard error. Wrong input raises ParameterError, a bag or log that cannot be read
BagError (both ValueErrors), a law that fails LawError (a RuntimeError), each with one sentence.
docs/tutorials/notebook.ipynb shows most tasks. export, study and commission are commands of valve-control.
"""

import argparse
import contextlib
import difflib
import functools
import html
import inspect
import io
import itertools
import json
import os
import re
import sys
import tempfile
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from valve_control import outputs
from valve_control.arrays import Floats
from valve_control.cli.command import Commands
from valve_control.cli.common import OUTPUTS, option_of
from valve_control.control.compiling import LawError as LawError
from valve_control.control.laws.law import Law
from valve_control.control.parameters import files
from valve_control.control.parameters.controller import add_law
from valve_control.control.parameters.ros_file import as_text, as_yaml
from valve_control.control.parameters.table import NODES
from valve_control.control.simulation import offline
from valve_control.parameter import ParameterError, Value, Values
from valve_control.recordings.bags.errors import BagError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

MANY = ("band", "data_sheet")  # options that take several words
EXPECTED = {  # values of options that take neither a word nor a number alone
    "command": "one array with a number [V] per sample, without the times, or a file",
    "controller": "the name of a law, or the LAW of your file (docs/tutorials/your_law.md)",
}
TABLES = {".csv", ".npy", ".mat", ".mcap", ".db3"}  # suffixes of files that are no parameters


class Named(dict[str, Any]):
    """A dict that lists its keys where one is missing."""

    def __missing__(self, name: str) -> NoReturn:
        raise KeyError(f"{name}; there are {', '.join(self)}")


@dataclass(frozen=True, repr=False)
class Parameters:
    """A ROS 2 parameter file: of a valve, of gains, or of both; ``parameters["lvdt.noise"]`` is a value."""

    text: str
    values: dict[str, Values]  # checked, by node: values["controller"]["arc.k1"]
    name: str = "parameters.yaml"  # for messages and titles

    def __repr__(self) -> str:
        return f"# {self.name}\n{self.text}"

    def __getitem__(self, name: str) -> Value:
        value: Value = Named({n: v for part in self.values.values() for n, v in part.items()})[name]
        return value

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file to ``path``, whole or not at all. Raises OSError."""
        outputs.write(os.fspath(path), self.text)


Source = Parameters | Mapping[str, Mapping[str, Any]] | str | os.PathLike[str]


@dataclass(eq=False, repr=False)
class Result(Named):
    """Numbers of a task, those of --json, with its arrays, parameters and figure."""

    text: str  #: that the command prints
    passed: bool  #: whether gains are accepted
    arrays: Mapping[str, Floats]  #: signals by name, [samples]; of several valves VALVE/NAME
    parameters: Parameters | None  #: of the fitted valve, or the accepted gains
    page: str | None  #: report of a bag in HTML
    _arguments: argparse.Namespace  # of the command

    def __repr__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        text = f"<pre>{html.escape(self.text)}</pre>"
        if self.page is None:
            return text
        return f'{text}<iframe srcdoc="{html.escape(self.page)}" width="100%" height="640"></iframe>'

    def to_dataframe(self) -> "DataFrame":
        """The arrays as columns of a pandas.DataFrame; of ``compare`` a row for each law.

        Raises ParameterError if the task gives no table, ModuleNotFoundError without pandas.
        """
        import pandas

        if "runs" in self:
            return pandas.DataFrame([{"law": run["controller"], **run["indices"]} for run in self["runs"]])
        if not self.arrays:
            raise ParameterError(f"{self._arguments.task} gives no table; its numbers are in the dict")
        return pandas.DataFrame({name: pandas.Series(column) for name, column in self.arrays.items()})

    def plot(self) -> "Figure":
        """The figure of the command, of matplotlib, to change and save; for axes of your own use ``arrays``.

        Raises ParameterError if the task has no figure.
        """
        if not hasattr(self._arguments, "draw"):
            raise ParameterError(f"{self._arguments.task} has no figure; simulate, compare or a test has one")
        import matplotlib.pyplot as plt

        figure: Figure = plt.figure()
        self._arguments.draw([], figure=figure)
        if "inline" in plt.get_backend():
            plt.close(figure)  # a notebook would show it a second time, below the cell
        return figure

    def law(self) -> Callable[[float, float], float]:
        """The law of a simulation, for a loop of your own: voltage [V] from command and reading [V].

        It is called once a sample, keeps its state, and begins at rest. Raises ParameterError.
        """
        if not hasattr(self._arguments, "settings"):
            raise ParameterError(f"{self._arguments.task} gives no law; a result of simulate does")
        return offline.law_function(self._arguments.settings["controller"])


class _Call(NamedTuple):
    """A task with its arguments: positional words, parameter files, and options by name."""

    task: str
    words: Sequence[str | os.PathLike[str]]
    parameters: Sequence[Source]
    options: Mapping[str, Any]

    def result(self, *wanted: str) -> Result:
        """Run the task; the result has what the ``wanted`` outputs hold."""
        for name in {*OUTPUTS, "help"} & self.options.keys():
            raise ParameterError(f"{name} is of the command line; the result of {self.task} has all outputs")
        for source in self.words:
            if not isinstance(source, (str, os.PathLike)):
                raise ParameterError(f"a {type(source).__name__} is no file; write it with to_csv")
        with tempfile.TemporaryDirectory() as folder:
            files = {name: f"{folder}/out/{self.task}.{OUTPUTS[name]}" for name in ("json", *wanted)}
            Path(folder, "out").mkdir()
            text, errors = io.StringIO(), _Without(f"{folder}/")
            with contextlib.redirect_stdout(text), contextlib.redirect_stderr(errors):
                try:
                    line = [self.task, *map(str, self.words), *self._options(Path(folder))]
                    words = [*line, *(f"--{name}={file}" for name, file in files.items())]
                    arguments = _parsed(words, [word.replace(f"{folder}/", "") for word in line])
                    status = int(arguments.run(arguments) or 0)
                except (ParameterError, BagError) as error:
                    raise type(error)(_in_python(str(error), f"{folder}/")) from None
            lines = [row for row in text.getvalue().splitlines() if folder not in row]
            contents = {name: dict(_contents(Path(file))) for name, file in files.items()}
        numbers = contents["json"][""]
        for law in numbers.get("laws", {}).values():
            law.pop("file")  # it is gone
        arrays = contents.get("npz", {}).get("") or {
            f"{valve.lstrip('_')}/{name}" if valve else name: column
            for valve, table in contents.get("csv", {}).items()
            for name, column in table.items()
        }
        response = numbers.get("response", {}).items()
        arrays |= {name: np.array(row, float) for name, row in response if isinstance(row, list)}
        parameters, page = (contents.get(name, {}).get("") for name in ("output", "html"))
        result = Result("\n".join(lines), status == 0, Named(arrays), parameters, page, arguments)
        result.update(numbers)
        return result

    def _options(self, folder: Path) -> list[str]:
        files = [*self.parameters, *_several(self.options.get("params_file", []))]
        for file in files:
            if isinstance(file, Result) or not isinstance(file, (Parameters, Mapping, str, os.PathLike)):
                raise ParameterError(
                    f"a {type(file).__name__} is no parameters; give files, dicts, or the .parameters of a "
                    "result, which are None if gains did not pass (a motion is command=, a test is bag=, a "
                    "transfer function {'valve_simulator': {'valve': 'custom', 'numerator': [...], "
                    "'denominator': [...]}})"
                )
            if isinstance(file, (str, os.PathLike)) and Path(file).suffix.lower() in TABLES:
                raise ParameterError(f"{file} is a table; give it as bag= (a test) or command= (a motion)")
        options = {**self.options, "params_file": files}
        words, actions = list[str](), _commands().parsers[self.task]._option_string_actions
        for name, value in options.items():
            option = option_of(name)
            if name in self.options and option not in actions:
                known = [action.dest for action in actions.values()]
                near = [n for n in known if n.startswith(name)] or difflib.get_close_matches(name, known)
                meant = f"did you mean '{near[0]}'?" if near else f"help(valve_control.{self.task}) lists all"
                raise ParameterError(f"{self.task} has no option {name}; {meant}")
            one = isinstance(actions.get(option), argparse._StoreAction) and name not in MANY
            count = len(_several(value))
            if (one and count > 1) or (count == 0 and (one or name == "command")):
                expected = EXPECTED.get(name, "one")
                raise ParameterError(f"{name} has {count} entries; {self.task} takes {expected}")
            switch = isinstance(actions.get(option), argparse._StoreTrueAction)
            if switch and value not in (True, False, None):
                raise ParameterError(f"{name} is a switch: True or False")
            if isinstance(value, Mapping):
                value = _settings(value)
            if value is None or value is False:
                words += [f"{option}=none"] if actions[option].default else []
            elif value is True:
                words.append(option)
            elif name in MANY:
                value = value.split() if isinstance(value, str) else np.atleast_1d(value)
                words += [option, *map(str, value)]
            else:
                words += [f"{option}={_word(one, folder, name)}" for one in _several(value)]
        return words


def _in_python(text: str, folder: str = "\0") -> str:
    """A text of the command without the name of a ``folder``, and with keywords in place of options."""
    names = {"from": "start", "to": "end"}
    rest = r"^valve-control \w+: (argument )?| \(see valve-control.*|; can be repeated"
    text = re.sub(rf"command file {folder}(command\w*)\.npy", r"\1", text).replace(folder, "")
    text = re.sub(rest, "", text)
    option = "'valve-control [^']*'|--([a-z-]*[a-z])"  # a command in quotes stays
    return re.sub(option, lambda w: names.get(w[1], w[1].replace("-", "_")) if w[1] else w[0], text)


class _Without(io.TextIOBase):
    """Standard error without the name of a folder."""

    def __init__(self, folder: str) -> None:
        self._folder, self._stream = folder, sys.stderr

    def write(self, text: str) -> int:
        """Write ``text``."""
        return self._stream.write(_in_python(text, self._folder))


def _several(value: Any) -> list[Any]:
    """The entries of a list or tuple, or a single value."""
    return [*value] if type(value) in (list, tuple) and not _is_motion(value) else [value]


def _is_motion(value: Any) -> bool:
    """Whether ``value`` is an array, of numpy or pandas, or numbers in a list or tuple."""
    if type(value) in (list, tuple):
        return len(value) > 0 and isinstance(value[0], (int, float, np.number))
    return hasattr(value, "__array__") and np.ndim(value) > 0


def _word(value: Any, folder: Path, name: str) -> str:
    """``value`` of an option; a motion or parameters as the name of a file in ``folder``."""
    if _is_motion(value):
        motion = np.asarray(value)
        if motion.ndim != 1 or len(motion) == 0 or motion.dtype.kind not in "iuf":
            raise ParameterError(
                f"an array of {motion.dtype} with the shape {motion.shape} is no motion; "
                "give one real number [V] per sample"
            )
        path = _new(folder / f"{name}.npy")
        np.save(path, np.asarray(motion, dtype=float), allow_pickle=False)
        return str(path)
    if inspect.ismodule(value):
        raise ParameterError(f"{name} is a module; give the descriptor: {value.__name__}.LAW")
    if isinstance(value, Law):
        add_law(value)
        return value.name
    if isinstance(value, Mapping):
        if not all(node in NODES and isinstance(values, Mapping) for node, values in value.items()):
            example = "{'valve_simulator': {'damping': 0.7}}"
            raise ParameterError(
                f"parameters are a dict by node: {example}; the nodes are {', '.join(NODES)}"
            )
        sections = {}
        for node, values in value.items():
            checked = [files.parse_setting(text, {node: NODES[node]}) for text in _settings(values)]
            sections[f"/**/{node}"] = {parameter: by_node[node] for parameter, by_node in checked}
        value = Parameters(as_yaml(sections), {})
    if isinstance(value, Parameters):
        path = _new(folder / value.name)
        value.save(path)
        return str(path)
    if not isinstance(value, (str, os.PathLike, *(() if name in EXPECTED else (int, float, np.number)))):
        expected = EXPECTED.get(name, "a word or a number")
        raise ParameterError(f"{name} is a {type(value).__name__}; give {expected}")
    return str(value)


def _settings(values: Mapping[str, Any]) -> list[str]:
    """``values`` as NAME=VALUE."""
    return [f"{n}={v if isinstance(v, str) else as_text(v)}" for n, v in outputs.plain({**values}).items()]


def _new(path: Path) -> Path:
    """``path``, with a number if it exists."""
    paths = (path.with_stem(f"{path.stem}_{i}") for i in itertools.count(2))
    return next(p for p in itertools.chain([path], paths) if not p.exists())


_commands = functools.cache(Commands)


def _parsed(words: Sequence[str], line: Sequence[str]) -> argparse.Namespace:
    """The command's arguments. Raises ParameterError with the sentence of the command."""
    with contextlib.redirect_stderr(io.StringIO()) as text:
        try:
            return _commands().top.parse_args(words, argparse.Namespace(line=list(line)))
        except SystemExit:
            raise ParameterError(text.getvalue().strip()) from None


def _contents(file: Path) -> Iterator[tuple[str, Any]]:
    """What ``file`` holds, and the files of single valves beside it, by the end of their names."""
    for path in sorted(file.parent.glob(f"{file.stem}*{file.suffix}")):
        end, kind = path.stem.removeprefix(file.stem), path.suffix
        if kind == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                yield end, dict(arrays)
        elif kind == ".yaml":
            yield end, load(path)
        else:
            text = path.read_text(encoding="utf-8")
            if kind == ".csv":
                table = np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1, ndmin=2)
                yield end, dict(zip(text.partition("\n")[0].split(","), table.T, strict=True))
            else:
                yield end, json.loads(text) if kind == ".json" else text


def load(path: str | os.PathLike[str]) -> Parameters:
    """The ROS 2 parameter file ``path``, checked; Parameters have .values by node, .text and .save(path).

    Example: ``load("valve.yaml")["lvdt.noise"]``. The values are for reading: to change one, give a task
    ``set={"lvdt.noise": 0.01}``, or a dict by node after the file.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise ParameterError(f"a {type(path).__name__} is no file; a task takes a dict as it is")
    file = Path(os.path.expanduser(path))
    return Parameters(values=files.load(str(file)), text=file.read_text(encoding="utf-8"), name=file.name)


def simulate(*parameters: "Source", **options: Any) -> Result:
    """Run one controller on one simulated valve.

    Example: ``simulate("valve.yaml", controller="pid", command=motion, set={"pid.kp": 2.0}).plot()``
    Numbers: indices, of the reading: e_M (largest error), e_F (in the last two seconds), e_rms, u_rms [V],
    c_u (chatter) [-]; true_error, of the position: e_M, e_rms; saturated (share); steps: the worst; warning.
    Arrays: time [s], command, position (the true one), measurement, voltage [V], and the terms of the law.
    """
    return _Call("simulate", (), parameters, options).result("npz")


def compare(*parameters: "Source", **options: Any) -> Result:
    """Simulate all controllers, or some, on one valve.

    Example: ``compare("valve.yaml", controller="pid,dcarc", command=motion).to_dataframe()``
    Numbers: runs: those of simulate, for each law.
    """
    return _Call("compare", (), parameters, options).result()


def identify(*parameters: "Source", bag: str | os.PathLike[str] | None = None, **options: Any) -> Result:
    """Fit transfer functions to a test: of ``bag`` (a bag or log), or of the simulated valve.

    Example: ``identify(bag="test.csv", map={"spool_position": "lvdt", "valve_voltage": "u"}).parameters``
    Numbers: fits: numerator, denominator, delay_s of each order; lvdt; gains; friction, characteristic.
    Arrays: frequency_hz [Hz], real, imaginary [V/V] of the response, its deviation, coherence.
    """
    return _Call("identify", () if bag is None else (bag,), parameters, options).result("output")


def tune(*parameters: "Source", controller: str | Law | None = None, **options: Any) -> Result:
    """Search the gains of one law for a valve and its spread, and verify them on other valves.

    ``controller``: the law, default that of the parameters; call ``tune`` once for each law.
    Example: ``tune("valve.yaml", controller="dcarc", command=[motion], overshoot=None).parameters``
    Numbers: laws["dcarc"]: chosen (gains), front, verified (e_rms, c_u), margins, accepted, limits, notes.
    """
    if isinstance(controller, str) and ("," in controller or controller == "all"):
        raise ParameterError(f"controller is {controller}; tune takes one law, call it for each")
    return _Call("tune", (), parameters, {"controller": controller, **options}).result("output")


def margins(*parameters: "Source", **options: Any) -> Result:
    """Gain, phase and delay margin of given gains on a valve or, with ``box=True``, on a box of valves.

    Example: ``margins("valve.yaml", "gains.yaml", controller="pid")["margins"]["this valve"]["phase_deg"]``
    Numbers: margins: gain_db, reduction_db (None: without end), phase_deg, delay_s, sensitivity_db, swing_v.
    Arrays: frequency_hz [Hz], real and imaginary part of the open loop's response around this valve.
    """
    return _Call("margins", (), parameters, options).result()


def analyze(bag: str | os.PathLike[str], **options: Any) -> Result:
    """Sample rates, indices, estimates and spectra of a ``bag`` or log.

    Example: ``analyze("log.csv", map={"spool_command": "wanted", "spool_position": "lvdt*0.001"}).arrays``
    Numbers: bag, and by name valves: indices, segments (motions), timing, latency_s, changes.
    Arrays: time_s [s], stamp_ns [ns], command_V, measurement_V, error_V, voltage_V [V].
    """
    return _Call("analyze", (bag,), (), options).result("csv", "html")


def replay(bag: str | os.PathLike[str], *parameters: "Source", **options: Any) -> Result:
    """Feed the recorded command and readings of ``bag`` to a controller, and compare its voltage.

    Example: ``replay("monday", set={"arc.k1": 150.0})["difference_rms_V"]``
    Arrays: time_s [s], command_V, measurement_V, recorded_voltage_V, shadow_voltage_V [V].
    """
    return _Call("replay", (bag,), parameters, options).result("csv", "html")


def _describe_options() -> None:
    """Give each task its keywords, and their help from the command line, for help() and notebooks."""
    formatter, hidden = argparse.HelpFormatter(""), {"help", "params_file", *OUTPUTS}
    about = (__doc__ or "").partition("\n\n")[2]
    Result.__doc__ = f"{Result.__doc__}\n\n{about}"
    for task in (simulate, compare, identify, tune, margins, analyze, replay):
        own = inspect.signature(task).parameters
        keywords = [one for one in own.values() if one.kind is not one.VAR_KEYWORD]
        rows = [f"{inspect.cleandoc(task.__doc__ or '')}\n\nOptions, all of them keywords:"]
        for action in _commands().parsers[task.__name__]._actions:
            if action.dest in hidden | own.keys():
                continue
            usual = float(action.default) if isinstance(action.default, str) else action.default
            usual = None if usual == [] else usual
            keywords.append(inspect.Parameter(action.dest, inspect.Parameter.KEYWORD_ONLY, default=usual))
            value = "" if action.choices else formatter._format_args(action, "")
            value = f"True or {value[1:-1]}" if action.nargs == "?" else "dict" if "=" in value else value
            value = value.replace("FILE", "array or file") if action.dest in EXPECTED else value
            value += ", or a list" if isinstance(action, argparse._AppendAction) and value != "dict" else ""
            text = f"{action.dest}{value and f' ({value})'}: {_in_python(formatter._expand_help(action))}"
            text += f"; one of {', '.join(map(str, action.choices))}" if action.choices else ""
            rows.append(textwrap.fill(text, 100, initial_indent="    ", subsequent_indent="        "))
        task.__doc__ = "\n".join([*rows, "", about])
        vars(task)["__signature__"] = inspect.Signature(keywords, return_annotation=Result)


_describe_options()
