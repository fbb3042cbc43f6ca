# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates one law on many valves drawn from a box: plants, drifts, noises, periods, delays (robustness).

Valve number i is point i of a scrambled Sobol sequence and has its own seed, so that it is the same in a
study of any length and can be run again alone. Results are stored in chunks, each a file that is either whole
or made again: a study that was stopped goes on where it was, unless the package has changed since.
"""

import hashlib
import io
import json
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy.stats

from valve_control import outputs, parameter
from valve_control.arrays import Floats
from valve_control.control.analysis.figures import COLOURS, Line, Plot, draw_columns
from valve_control.control.commands import arrays
from valve_control.control.compiling import LANES, sources_digest
from valve_control.control.laws import command_lead, linearisation
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import build
from valve_control.control.parameters.table import NODES
from valve_control.control.plant import registry
from valve_control.control.simulation import batch, delivery, measures, offline
from valve_control.parameter import ParameterError, Values, lookup, updated, word

Settings = Mapping[str, Values]  # by node
Told = Callable[[int], None]  # valves done
CHUNK = 1024  # most valves of a file
STEPS = 100_000_000  # most samples of a file, all valves together: some seconds of work
MOST_VALVES = 2**30  # points of scipy's Sobol sequence
MOST_SEED = int(lookup(NODES["valve_simulator"], "seed").high)
LIMIT = 0.15  # V  e_F beyond which a loop at rest is unstable: few lie between 0.1 V and the limit cycles
FOLLOWING = 2.0  # times the following error of the valve that nothing was varied on, which motion adds to it
AT_REST = 1e-6  # V by which the command of a loop at rest moves
PARTS = ("points", "period", "rows")  # of a file: quantities, sample periods [s] and results of its valves
PERCENTS = (1, 5, 25, 50, 75, 95, 99)


class Quantity(NamedTuple):
    """One parameter that differs from valve to valve, uniformly between ``low`` and ``high``."""

    name: str  # of the valve's parameter; gain and speed are factors of the model
    low: float
    high: float
    unit: str


BOX = (
    Quantity("gain", 0.8, 1.25, "-"),
    Quantity("speed", 0.8, 1.25, "-"),
    Quantity("flow_force", -0.3, 0.3, "V/V"),
    Quantity("disturbance.offset", -1.0, 1.0, "V"),
    Quantity("friction.coulomb", 0.0, 2.0, "V"),
    Quantity("friction.static_ratio", 1.0, 2.0, "-"),
    Quantity("drift.gain", -0.01, 0.02, "1/s"),
    Quantity("drift.stiffness", -0.02, 0.02, "V/V/s"),
    Quantity("lvdt.noise", 0.0, 0.010, "V"),
    Quantity("lvdt.delay", 0.0, 0.002, "s"),
)
PERIODS = (0.0005, 0.001, 0.002)  # s


class Study(NamedTuple):
    """One robustness study: settings of the nodes, number of valves, seed and box."""

    settings: Settings
    valves: int
    seed: int  # of the Sobol sequence; valve i has noise seed seed + i
    box: Sequence[Quantity] = BOX
    periods: Sequence[float] = PERIODS  # s


class StudyResult(NamedTuple):
    """Results of a study; row i is valve number i."""

    points: Floats  # N×quantities
    period: Floats  # s
    results: measures.Results

    def unstable(self, limit: float) -> npt.NDArray[np.bool_]:
        """Which loops did not stay finite, or err by more than ``limit`` [V] in the last two seconds."""
        return ~(self.results.finite & (self.results.e_F <= limit))


def check_numbers(study: Study, first: int, count: int) -> None:
    """Raise ParameterError unless the study has ``count`` valves from number ``first`` on."""
    if not 0 <= study.seed <= MOST_SEED:
        raise ParameterError(f"the seed of a study is {study.seed}; it must lie between 0 and {MOST_SEED}")
    if first < 0 or count < 1:
        raise ParameterError(f"{count} valves from number {first} on cannot be run; numbers begin at 0")
    last, most = first + count - 1, min(MOST_VALVES - 1, MOST_SEED - study.seed)
    if last > most:
        raise ParameterError(f"there is no valve {last}; with the seed {study.seed} the last one is {most}")


def check_drift(study: Study) -> None:
    """Raise ParameterError if a valve of the study may lose its whole gain within the run."""
    duration = parameter.number(study.settings["command_source"], "duration")
    for q in study.box:
        if q.name == "drift.gain" and 1.0 + q.low * duration <= 0.0:
            raise ParameterError(
                f"with a drift.gain of {q.low:g} {q.unit} nothing is left of a valve's gain after "
                f"{-1.0 / q.low:g} s, and the duration is {duration:g} s; keep the gain with --fix drift.gain"
            )


def draw(study: Study, first: int, count: int) -> tuple[Floats, Floats]:
    """Quantities (count×quantities) and sample periods [s] of ``count`` valves from number ``first`` on.

    Scrambled Sobol sequence (Sobol 1967, Owen 1998). Raises ParameterError for numbers that it has not.
    """
    check_numbers(study, first, count)
    sobol = scipy.stats.qmc.Sobol(len(study.box) + 1, rng=np.random.default_rng(study.seed))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # chunks are powers of two, a last part need not be
        unit = sobol.fast_forward(first).random(count) if first else sobol.random(count)
    low = np.array([q.low for q in study.box])
    high = np.array([q.high for q in study.box])
    choice = np.minimum((unit[:, -1] * len(study.periods)).astype(int), len(study.periods) - 1)
    return low + unit[:, :-1] * (high - low), np.asarray(study.periods, dtype=float)[choice]


def valve_of(study: Study, number: int, point: Floats, period: float) -> Values:
    """Simulator's parameters of valve ``number``. Raises ParameterError."""
    named = {q.name: float(value) for q, value in zip(study.box, point, strict=True)}
    base = study.settings["valve_simulator"]
    gain, speed = named.pop("gain", 1.0), named.pop("speed", 1.0)
    changes: dict[str, Any] = {
        **named,
        **registry.chosen(base).scaled(base, gain, speed),
        "sample_period": period,
        "seed": study.seed + number,
    }
    return updated(NODES["valve_simulator"], base, changes)


def sampled(study: Study, node: str, period: float) -> Values:
    """Parameters of ``node`` with another sample ``period`` [s]. Raises ParameterError."""
    return updated(NODES[node], study.settings[node], {"sample_period": period})


def settings_of_number(study: Study, number: int) -> dict[str, Values]:
    """All parameters of valve ``number``, to run it again. Raises ParameterError."""
    points, periods = draw(study, number, 1)
    period = float(periods[0])
    return {
        "controller": sampled(study, "controller", period),
        "valve_simulator": valve_of(study, number, points[0], period),
        "command_source": sampled(study, "command_source", period),
    }


def fitting_limit(study: Study) -> float:
    """e_F [V] beyond which a loop counts as unstable, for the motion of ``study``.

    A loop that moves in the last two seconds has a following error too, which the valves of the box share
    within a factor of two or so; beyond the size of the motion it would be better not to move. Raises
    ParameterError.
    """
    period = sorted(study.periods)[len(study.periods) // 2]
    command = build.commands(sampled(study, "command_source", period))
    last = command[-max(1, round(2.0 / period)) :]
    size = 0.5 * float(np.ptp(last))
    if size <= AT_REST:
        return LIMIT
    controller = sampled(study, "controller", period)
    plant = sampled(study, "valve_simulator", period)
    run = offline.simulate(controller, plant, command)
    following = FOLLOWING * run.indices.e_F
    return LIMIT + (min(following, size) if np.isfinite(following) else size)


def run_chunk(study: Study, first: int, count: int, threads: int | None = None) -> StudyResult:
    """Simulate ``count`` valves from number ``first`` on. Raises ParameterError."""
    points, periods = draw(study, first, count)
    every = np.full((count, len(measures.Results._fields)), np.nan)
    for period in np.unique(periods):
        chosen = np.flatnonzero(periods == period)
        valves = [valve_of(study, first + int(i), points[i], float(period)) for i in chosen]
        controller = sampled(study, "controller", float(period))
        offline.check_agreement(controller, valves[0])
        command = build.commands(sampled(study, "command_source", float(period)))
        limit = parameter.number(controller, "command_limit")
        command = np.clip(command, -limit, limit)
        law = word(controller, "controller")
        law_params = build.law_params(controller)
        lead = command_lead.build(controller, LAWS[law].reshapes(law_params))
        made = batch.simulate(
            batch.Batch(
                law,
                linearisation.behind(controller, law_params),
                batch.records([build.valve_params(values) for values in valves]),
                study.seed + first + chosen,
                command,
                led=delivery.led(lead, controller, command, None),
            ),
            threads,
        )
        every[chosen] = np.stack(made, axis=1)
    return StudyResult(points, periods, _results(every))


def _results(rows: Any) -> measures.Results:
    return measures.Results._make([*rows.T[:-1], rows.T[-1] == 1.0])


def _digest(study: Study) -> str:
    """Hash of everything that determines the results. Raises ParameterError for a command file."""
    source = study.settings["command_source"]
    array = arrays.read(word(source, "command_file")).tobytes() if source["scenario"] == "array" else b""
    described = {
        "settings": {node: dict(values) for node, values in study.settings.items()},
        "seed": study.seed,
        "box": [list(q) for q in study.box],
        "periods": list(study.periods),
        "command_array": hashlib.sha256(array).hexdigest(),
        "sources": sources_digest(),
    }
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()


def folder_name(study: Study) -> str:
    """Name of the study's folder, the same for any number of valves. Raises ParameterError."""
    return f"study-{word(study.settings['controller'], 'controller')}-{_digest(study)[:8]}"


def run(study: Study, folder: Path, told: Told, threads: int | None = None) -> StudyResult:
    """Simulate the valves whose results ``folder`` lacks, chunk by chunk; returns all results.

    ``told`` is called once before the work, and after each chunk. Ctrl-C loses the chunk that is running, no
    more. Raises ParameterError, also for the folder of another study, and OSError if it cannot be written.
    """
    check_numbers(study, 0, study.valves)
    build.commands(sampled(study, "command_source", max(study.periods)))
    folder.mkdir(parents=True, exist_ok=True)
    samples = parameter.number(study.settings["command_source"], "duration") / min(study.periods)
    valves = max(LANES, int(STEPS / samples))
    digest, chunk = _digest(study), min(CHUNK, 1 << (valves.bit_length() - 1))  # a power of two, as Sobol's
    paths = {first: folder / f"valves_{first:08d}.npz" for first in range(0, study.valves, chunk)}
    parts = {first: part for first, path in paths.items() if (part := _read(path, digest)) is not None}
    told(sum(min(chunk, study.valves - first) for first in parts))
    for first in sorted(paths.keys() - parts.keys()):
        found = run_chunk(study, first, chunk, threads)
        rows: Floats = np.stack(found.results, axis=1)
        parts[first], stream = (found.points, found.period, rows), io.BytesIO()
        np.savez(stream, points=found.points, period=found.period, rows=rows, study=np.array(digest))
        outputs.write(str(paths[first]), stream.getvalue())
        told(sum(min(chunk, study.valves - first) for first in parts))
    each = zip(*(parts[first] for first in paths), strict=True)
    points, period, rows = (np.concatenate(part)[: study.valves] for part in each)
    return StudyResult(points, period, _results(rows))


def _read(path: Path, digest: str) -> tuple[Floats, ...] | None:
    """PARTS of a file of the study with this ``digest``; None: missing or damaged. Raises ParameterError."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            parts, other = tuple(stored[name] for name in PARTS), str(stored["study"])
    except (OSError, EOFError, KeyError, ValueError, zipfile.BadZipFile):
        return None
    if other != digest:
        raise ParameterError(
            f"{path.parent} holds a study with other parameters, or of another version of this package; "
            "choose another folder"
        )
    return parts


def summary(found: StudyResult, limit: float = LIMIT, count: int = 10) -> dict[str, Any]:
    """Percentiles of the indices, share of unstable loops by ``limit`` [V], and worst valves, for JSON."""
    finite, unstable = found.results.finite, found.unstable(limit)
    names = [name for name in measures.Results._fields if name != "finite" and np.any(finite)]

    def percentiles(name: str) -> dict[str, float]:
        values = np.percentile(getattr(found.results, name)[finite], PERCENTS).tolist()
        return dict(zip(map(str, PERCENTS), values, strict=True))

    def worst(name: str) -> list[int]:  # those that did not stay finite come first
        values = np.where(finite, getattr(found.results, name), np.inf)
        return [int(i) for i in np.argsort(-values, kind="stable")[:count]]

    by_period = {f"{p:g}": float(np.mean(unstable[found.period == p])) for p in np.unique(found.period)}
    return {
        "valves": len(finite),
        "limit": limit,
        "unstable": float(np.mean(unstable)),
        "unstable_by_period": by_period,
        "percentiles": {name: percentiles(name) for name in names},
        "worst": {name: worst(name) for name in ("e_rms", "e_M", "e_F")},
    }


def draw_errors(path: Path, found: StudyResult, title: str) -> None:
    """Draw the distributions of the errors, a colour for each sample period. Raises OSError."""
    plots = []
    for name in ("e_rms", "e_M", "e_F"):
        lines = []
        for i, period in enumerate(np.unique(found.period)):
            values = np.sort(getattr(found.results, name)[(found.period == period) & found.results.finite])
            share = 100.0 * (np.arange(len(values)) + 1.0) / max(1, len(values))
            lines.append(Line(f"sampled every {1e3 * period:g} ms", values, share, COLOURS[i % len(COLOURS)]))
        plots.append(Plot(f"{name}: valves [%]", lines))
    draw_columns([path], {"": plots}, "at most [V]", title, logarithmic_x=True)
