# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Compares laws, each with gains of its own, on random valves and four commands, at equal chatter.

With preview the commands are known ahead: those of laws that reshape are made so that the reference is
the wanted motion exactly, those of the others are moved ahead by a time that was tuned with the gains.
Without it, the law gets the wanted motion as its command, and the lag of the reshaping counts.
"""

import functools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control.arrays import Floats
from valve_control.control.commands.scenarios import command, strokes
from valve_control.control.laws import command_lead, linearisation
from valve_control.control.laws.registry import LAWS
from valve_control.control.parameters import files
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant import valve
from valve_control.control.plant.sensor import IDEAL
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, TransferFunction
from valve_control.control.simulation import batch, delivery
from valve_control.parameter import ParameterError, Value, Values, defaults, numbers, updated, word

PERIOD = 0.001  # s
DURATION = 6.0  # s
ADAPTED = 3.0  # s  from where on a law has learned
U_MAX = 10.0  # V
STRIBECK = 0.017  # V/s
NOISE, RESOLUTION = 0.0056, 0.0037  # V  of the LVDT
SWELL = 0.2  # s  in which a sine reaches its amplitude
BEGIN = 0.25  # s  of standstill
BOXES = ("narrow", "wide")
NO_LIMITS: dict[str, Value] = {"reshaping.max_rate": 1e5, "reshaping.max_accel": 1e7}
NOISE_SEED = 50_000
ORACLE = "oracle"


class Setup(NamedTuple):
    """A law with its gains."""

    name: str
    values: Values  # of the controller, where they are not the defaults
    preview: float  # s  by which the command of a law that does not reshape is moved ahead


class Errors(NamedTuple):
    """Measured on N valves: shapes (4, N)."""

    rms: Floats  # V  of the true position
    adapted: Floats  # V  the same from ADAPTED on
    chatter: Floats  # -  c_u


@functools.cache
def motions() -> dict[str, Floats]:
    """The four commands [V], with two samples more than a run."""
    t = np.arange(round(DURATION / PERIOD) + 2) * PERIOD - BEGIN
    swell = 0.5 - 0.5 * np.cos(math.pi * np.clip(t / SWELL, 0.0, 1.0))

    def sine(frequency: float) -> Floats:
        wave: Floats = np.sin(2.0 * math.pi * frequency * t)
        return wave

    def stroke(*shape: float) -> Floats:
        wanted = strokes(*shape)
        return np.array([command(wanted, float(time)) for time in t])

    return {
        "fast point to point": stroke(1.5, 40.0, 2500.0, 0.5),
        "sines 3, 9, 15 Hz": swell * (0.5 * sine(3.0) + 0.3 * sine(9.0) + 0.15 * sine(15.0)),
        "sine 10 Hz": swell * 0.6 * sine(10.0),
        "slow point to point": stroke(2.92, 8.0, 64.0, 5.81),
    }


def valves(count: int, seed: int, wide: bool) -> list[valve.Params]:
    """Random valves around model (3); ``wide``: speeds of poles and zeros and dead time vary too."""
    random = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        gain, coulomb = random.uniform(0.7, 1.4), random.uniform(0.0, 1.6)
        static, presliding = random.uniform(1.0, 1.6), random.uniform(0.01, 0.04)
        flow, offset = random.uniform(-0.5, 0.5, 2)
        poles, zeros, delay = random.uniform(0.8, 1.25), random.uniform(0.8, 1.25), random.uniform(0.0, 1e-3)
        disturbance = valve.NO_DISTURBANCE._replace(
            coulomb=coulomb,
            static_ratio=static,
            stribeck_velocity=STRIBECK,
            velocity_scale=0.02,
            presliding=presliding,
            flow_force=float(flow),
            offset=float(offset),
        )
        if not wide:
            poles, zeros, delay = 1.0, 1.0, 0.0
        made.append(made_of(gain, poles, zeros, delay, disturbance))
    return made


def made_of(
    gain: float, poles: float, zeros: float, delay: float, disturbance: valve.Disturbance
) -> valve.Params:
    """Valve around model (3) with speeds of its ``poles`` and ``zeros``, and a dead time ``delay`` [s]."""
    model = FOURTH_ORDER
    if (poles, zeros) != (1.0, 1.0):
        denominator = tuple(c * poles**i for i, c in enumerate(model.denominator))
        numerator = [c * zeros**i for i, c in enumerate(model.numerator)]
        scale = model.static_gain * denominator[-1] / numerator[-1]
        model = TransferFunction(tuple(scale * c for c in numerator), denominator)
    lvdt = IDEAL._replace(noise=NOISE, resolution=RESOLUTION, delay=delay / PERIOD)
    return valve.design(model, PERIOD, U_MAX, gain, disturbance, lvdt)


def undisturbed() -> valve.Params:
    """Model (3) itself, without friction, flow force, offset and dead time, with the LVDT of the others."""
    return made_of(
        1.0,
        1.0,
        1.0,
        0.0,
        valve.NO_DISTURBANCE._replace(stribeck_velocity=STRIBECK, velocity_scale=0.02),
    )


def measured(
    setup: Setup | Sequence[Setup], plants: batch.Records, seed: int, previewed: bool = True
) -> Errors:
    """One set of gains on all ``plants`` and commands, or one setup of one law for each plant.

    Raises ParameterError for gains that are none.
    """
    given = [setup] if isinstance(setup, Setup) else list(setup)
    values = [updated(CONTROLLER, defaults(CONTROLLER), {**NO_LIMITS, **one.values}) for one in given]
    (name,) = {word(v, "controller") for v in values}
    law = LAWS[name]
    params = [law.build(v) for v in values]
    lead = command_lead.build(values[0], law.reshapes(params[0]))
    found = []
    for i, wanted in enumerate(motions().values()):
        aim = wanted[:-2]
        sent = aim
        if previewed and law.reshapes(params[0]):
            sent = delivery.unreshaped(params[0].reshaping, wanted)
        elif previewed:
            times = np.arange(len(wanted)) * PERIOD
            sent = np.interp(times[:-2] + given[0].preview, times, wanted)
        traces = np.empty((len(plants), len(aim), 3))
        seeds = seed + 1000 * i + np.arange(len(plants))
        led = None if previewed else command_lead.applied(lead, sent)
        loops = [linearisation.behind(v, p) for v, p in zip(values, params, strict=True)]
        rows = loops[0] if len(loops) == 1 else batch.records(loops)
        batch.simulate(batch.Batch(name, rows, plants, seeds, sent, led=led), 1, traces)
        error = traces[:, :, 0] - aim
        late = error[:, round(ADAPTED / PERIOD) :]
        voltage = traces[:, :, 2]
        steps = np.sqrt(np.mean(np.diff(voltage, axis=1) ** 2, axis=1))
        found.append(
            (
                np.sqrt(np.mean(error**2, axis=1)),
                np.sqrt(np.mean(late**2, axis=1)),
                steps / np.sqrt(np.mean(voltage**2, axis=1)),
            )
        )
    return Errors(*(np.array(column) for column in zip(*found, strict=True)))


def geometric(values: Floats) -> float:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(values))))


def summary(errors: Errors) -> dict[str, Any]:
    """Numbers in mV, by command."""
    names = list(motions())

    def by_command(values: Floats) -> dict[str, float]:
        return {
            **{name: round(1e3 * float(v), 2) for name, v in zip(names, values, strict=True)},
            "geometric mean": round(1e3 * geometric(values), 2),
        }

    return {
        "median": by_command(np.median(errors.rms, axis=1)),
        "95th percentile": by_command(np.percentile(errors.rms, 95, axis=1)),
        f"median from {ADAPTED:g} s on": by_command(np.median(errors.adapted, axis=1)),
        "largest": by_command(np.max(errors.rms, axis=1)),
        "c_u": round(float(np.mean(errors.chatter)), 4),
    }


def setups(folder: Path, box: str, limit: float) -> list[Setup]:
    """Tuned gains in ``folder``: files BOX_LIMIT_NAME.yaml, with ``preview_s`` in a JSON file beside them.

    Raises ParameterError if there are none, or one cannot be read.
    """
    stem = f"{box}_{limit:g}_"
    found = []
    for path in sorted(folder.glob(f"{stem}*.yaml")):
        beside = path.with_suffix(".json")
        preview = 0.0
        if beside.is_file():
            try:
                preview = float(json.loads(beside.read_text(encoding="utf-8"))["preview_s"])
            except (ValueError, KeyError, TypeError) as error:
                raise ParameterError(f"{beside} has no preview_s, a number of seconds") from error
        values = files.load(str(path))["controller"]
        if "controller" not in values:
            raise ParameterError(f"{path} names no controller")
        found.append(Setup(path.stem.removeprefix(stem), values, preview))
    if not found:
        tuned = sorted({"_".join(p.stem.split("_")[:2]) for p in folder.glob("*_*_*.yaml")})
        raise ParameterError(
            f"no gains are tuned for the {box} box at c_u <= {limit:g}; {folder} has "
            f"{', '.join(tuned) or 'none'}"
        )
    return found


def oracle(given: Sequence[Setup]) -> Setup | None:
    """``dcarc`` of ``given`` without adaptation, or None."""
    for setup in given:
        if setup.values["controller"] == "dcarc":
            spread = [0.0] * len(numbers(defaults(CONTROLLER), "dcarc.theta_spread"))
            return Setup(ORACLE, {**setup.values, "dcarc.theta_spread": spread, "dcarc.delay": 0.0}, 0.0)
    return None


def compare(given: Sequence[Setup], count: int, seed: int, wide: bool) -> dict[str, dict[str, Errors]]:
    """Errors of each setup on ``count`` valves, by "with preview" and "command alone", then by name.

    The oracle, where there is a ``dcarc``, runs on undisturbed valves of the model. Raises ParameterError.
    """
    plants = batch.records(valves(count, seed, wide))
    ideal = batch.records([undisturbed()] * count)
    best = oracle(given)
    found: dict[str, dict[str, Errors]] = {}
    for text, previewed in (("with preview", True), ("command alone", False)):
        found[text] = {setup.name: measured(setup, plants, NOISE_SEED, previewed) for setup in given}
        if best is not None:
            found[text][ORACLE] = measured(best, ideal, NOISE_SEED, previewed)
    return found


def table(found: Mapping[str, Mapping[str, Errors]]) -> str:
    """Medians of the true e_rms [mV] by command, geometric mean of medians and 95th percentiles, and c_u."""
    heads = [
        name.replace("point to point", "p-p").replace("sines 3, 9, 15 Hz", "3 sines") for name in motions()
    ]
    lines = []
    for text, by_name in found.items():
        lines.append(f"{text:15}" + "".join(f"{h:>11}" for h in [*heads, "geo. mean", "95 %", "c_u"]))
        for name, errors in sorted(by_name.items(), key=lambda pair: -_size(pair[1])):
            told = summary(errors)
            cells = "".join(f"{value:11.2f}" for value in told["median"].values())
            lines.append(
                f"{name:15}{cells}{told['95th percentile']['geometric mean']:11.2f}{told['c_u']:11.3f}"
            )
    return "\n".join(lines)


def _size(errors: Errors) -> float:
    return geometric(np.median(errors.rms, axis=1))
