# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes a valve that was identified, or given: text, JSON, ROS 2 parameter file, Bode plot."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control.control.analysis.figures import Line, Plot, draw_columns
from valve_control.control.laws.registry import ADAPTIVE
from valve_control.control.parameters import build
from valve_control.control.parameters.ros_file import as_yaml
from valve_control.control.parameters.table import NODES
from valve_control.control.plant.transfer_functions import TransferFunction
from valve_control.design.identification import bode, characteristic
from valve_control.design.identification.bode import Corners, Root
from valve_control.design.identification.bode_fit import Fit
from valve_control.design.identification.characteristic import Characteristic, known_part
from valve_control.design.identification.first_gains import KnownValve, rounded
from valve_control.design.identification.response import LEAST_COHERENCE, Response
from valve_control.parameter import Values, defaults, updated

STABLE = "Stable with 0.67 to 1.5 times the gain, 0.8 to 1.25 times the speed, one more sample of delay."
NEAR = 1.1  # times the highest excited frequency, and over the lowest, up to which a test tells something


class Identification(NamedTuple):
    """A valve with gains for a first run, and the test that it comes from."""

    source: str
    known: KnownValve
    gains: Values  # of the controller
    notes: tuple[str, ...]
    measured: Response | None = None  # None: not tested
    fits: tuple[Fit, ...] = ()  # the last one stands for the valve
    curve: Characteristic | None = None  # None: not tested, or to one side alone


def polynomial(coefficients: tuple[float, ...]) -> str:
    """A polynomial in s, such as s² + 58.77 s + 1657."""
    text = ""
    for power, c in zip(reversed(range(len(coefficients))), coefficients, strict=True):
        s = ("", "s")[power] if power < 2 else f"s{'⁰¹²³⁴⁵⁶⁷⁸⁹'[power]}"
        size = s if s and abs(c) == 1.0 else f"{abs(c):.7g} {s}".rstrip()
        text += f" {'-' if c < 0.0 else '+'} {size}" if text else f"{'-' if c < 0.0 else ''}{size}"
    return text


def hertz(frequency: float | None) -> str:
    """A frequency as text for a table, or that there is none."""
    return "none" if frequency is None else f"{frequency:.2f} Hz"


def roots_text(roots: list[Root], measured: Response | None = None) -> str:
    """Poles or zeros in Hz, with damping, and with a word about those beyond a ``measured`` response."""
    texts = [
        f"{r.frequency:.2f} Hz"
        + (f" (damping {r.damping:.3f})" if r.pair else "")
        + ("" if measured is None or _excited(r.frequency, measured) else " (not excited by the test)")
        for r in roots
    ]
    return ", ".join(texts) or "none"


def model_text(model: TransferFunction) -> str:
    """A transfer function in s."""
    return f"({polynomial(model.numerator)}) / ({polynomial(model.denominator)})"


def corners_text(corners: Corners) -> str:
    """Frequencies of -3 dB and -90°."""
    return f"-3 dB at {hertz(corners.minus_3db)}, -90° at {hertz(corners.minus_90)}"


def _excited(frequency: float, measured: Response) -> bool:
    """Whether the test tells of this ``frequency`` [Hz]: it lies within those of ``measured``, or near by."""
    return bool(measured.frequency[0] / NEAR <= frequency <= NEAR * measured.frequency[-1])


def _corners(fit: Fit, measured: Response) -> Corners:
    """Corners of a ``fit`` that the test tells."""
    return Corners(*(None if c is None or not _excited(c, measured) else c for c in fit.corners))


def _coefficients(fit: Fit, line: str) -> list[str]:
    """Name, value, bound and bound [%] of each coefficient as ``line`` has them; without bounds up to ±."""
    with np.errstate(divide="ignore"):
        share = 100.0 * fit.bounds / np.abs(fit.values)
    line = line if fit.bounded else line.partition(" ±")[0]
    values = map(known_part, fit.values.tolist(), 0.1 * fit.bounds * fit.bounded)
    return [line.format(*row) for row in zip(fit.names, values, fit.bounds, share, strict=True)]


def fit_text(fit: Fit, measured: Response) -> str:
    """One fit to ``measured`` as the terminal shows it."""
    share = f", of which the model {100 * fit.model_error:.2g} %" if fit.model_error else ", all of it noise"
    width = f" ± {fit.gain_bound:.2g}" if fit.bounded else ""
    late = f" with a dead time of {1e3 * fit.delay:.3f} ms" if "delay" in fit.names else ""
    poles, zeros = (roots_text(bode.roots(part), measured) for part in (fit.model[1], fit.model[0]))
    lines = [
        f"order {fit.order}: {model_text(fit.model)}{late}",
        *_coefficients(fit, "  {0:6} {1:14.7g} ± {2:10.3g}  ({3:.2g} %)"),
        f"  static gain {fit.model.static_gain:.5f}{width} V/V; fit error {100 * fit.error:.3g} % rms{share}",
        f"  poles {poles}; zeros {zeros}",
        f"  {corners_text(_corners(fit, measured))}",
    ]
    return "\n".join(lines)


def text(found: Identification) -> str:
    """The whole identification as the terminal shows it."""
    known, rubbing, m = found.known, found.known.friction, found.measured
    if m is None:
        corners = corners_text(bode.model_corners(known.model, known.delay))
        lines = [found.source, model_text(known.model), f"  {corners}", f"  box of the first gains: {STABLE}"]
    else:
        relative = 100.0 * m.deviation / np.abs(m.value)
        lines = [
            found.source,
            f"measured: {m.method}, {len(m.frequency)} frequencies from {m.frequency[0]:.4g} to "
            f"{m.frequency[-1]:.4g} Hz, uncertainty {np.min(relative):.2g} to {np.max(relative):.2g} %, "
            f"coherence {np.min(m.coherence):.3f} to {np.max(m.coherence):.3f}",
            *(fit_text(fit, m) for fit in found.fits),
        ]
    for label, values in zip(("initial", "min    ", "max    "), known.theta, strict=True):
        lines.append(f"{'for arc and oarc:' if label == 'initial' else '':17} theta_{label} {values}")
    if m is not None:
        steps = f"steps of {1e3 * known.lvdt.resolution:.3g} mV" if known.lvdt.resolution else "no steps"
        lines.append(f"LVDT: noise {1e3 * round(known.lvdt.noise, 8):.3g} mV, {steps}")
    if rubbing is not None and m is not None:
        way = f"{1e3 * rubbing.presliding:.3g} mV" if rubbing.presliding else "not to be told"
        lines.append(
            f"friction: Coulomb {known_part(rubbing.coulomb):g} V, presliding {way}, offset "
            f"{known_part(rubbing.offset):g} V (triangle, {rubbing.strokes} strokes)"
        )
    lines += [] if found.curve is None else [characteristic.text(found.curve)]
    return "\n".join([*lines, *(f"note: {note}" for note in found.notes)])


def parameters(found: Identification) -> dict[str, Values]:
    """Parameters for the nodes: the valve's model, a compensator for it, the adaptive laws' estimates."""
    known, rubbing = found.known, found.known.friction
    numerator, denominator = map(list, known.model)
    valve: Values = {
        "valve": "custom",
        "numerator": numerator,
        "denominator": denominator,
        "gain_scale": 1.0,
    }
    valve |= {"flow_force": 0.0, "lvdt.noise": known.lvdt.noise, "lvdt.resolution": known.lvdt.resolution}
    if known.delay > 0.0:
        valve["lvdt.delay"] = known.delay
    if rubbing is not None:
        valve |= {"friction.coulomb": rubbing.coulomb, "friction.static_ratio": 1.0}
        valve |= {"disturbance.offset": rubbing.offset}
        valve |= {"friction.presliding": rubbing.presliding} if rubbing.strokes else {}
    controller: Values = {
        "compensator.design": "designed",
        "compensator.model": "custom",
        "compensator.numerator": numerator,
        "compensator.denominator": denominator,
        "open_loop.static_gain": known.model.static_gain,
        **{name: value for law in ADAPTIVE for name, value in known.theta.parameters(law).items()},
        **found.gains,
    }
    tree = {"valve_simulator": rounded(valve), "controller": rounded(controller)}
    if known.period != defaults(NODES["controller"])["sample_period"]:
        tree[""] = rounded({"sample_period": known.period})  # of all nodes
    return tree


def check_parameters(tree: dict[str, Values]) -> None:
    """Raise ParameterError unless controller and simulator accept these parameters."""
    for node, make in (("valve_simulator", build.valve_params), ("controller", build.law_params)):
        changes = {**tree.get("", {}), **tree.get(node, {})}
        make(updated(NODES[node], defaults(NODES[node]), changes))


def yaml_text(found: Identification) -> str:
    """A ROS 2 parameter file of ``parameters``."""
    comments = [f"Given: {found.source}"]
    if found.fits:
        best = found.fits[-1]
        bounds = "with 95 % bounds:" if best.bounded else "(the test does not tell their bounds):"
        comments = [
            f"Identified from: {found.source}",
            f"Order {best.order}, fit error {100 * best.error:.3g} % rms; coefficients {bounds}",
            *_coefficients(best, "  {0} = {1:.7g} ± {2:.2g}"),
        ]
    sections = {f"/**/{node}" if node else "/**": values for node, values in parameters(found).items()}
    return as_yaml(sections, [*comments, STABLE])


def linearisation_text(found: Identification) -> str:
    """A ROS 2 parameter file of the inverse of the static curve, for the model of ``parameters``.

    Raises ParameterError if there is none.
    """
    assert found.curve is not None
    values = characteristic.parameters(found.curve, found.known.model.static_gain, found.known.u_max)
    return as_yaml(
        {"/**/controller": rounded(values)},
        [
            f"Inverse of the static curve, from: {found.source}",
            *characteristic.text(found.curve).splitlines(),
            "linearisation.gain is the static gain of the model in the file of --output; load both.",
        ],
    )


def model_dict(model: TransferFunction) -> dict[str, Any]:
    """A transfer function for JSON."""
    return {"numerator": list(model.numerator), "denominator": list(model.denominator)}


def corners_dict(corners: Corners) -> dict[str, float | None]:
    """Frequencies of -3 dB and -90° for JSON."""
    return {f"{name}_hz": frequency for name, frequency in corners._asdict().items()}


def fit_dict(fit: Fit, measured: Response) -> dict[str, Any]:
    """One fit to ``measured`` for JSON; a corner that the test did not excite is None."""
    *bounds, gain_bound = (
        [*fit.bounds.tolist(), fit.gain_bound] if fit.bounded else [None] * (len(fit.names) + 1)
    )
    rows = zip(fit.names, fit.values.tolist(), bounds, strict=True)
    return {
        "order": fit.order,
        **model_dict(fit.model),
        "delay_s": fit.delay,
        "coefficients": {name: {"value": value, "bound": bound} for name, value, bound in rows},
        "static_gain": {"value": fit.model.static_gain, "bound": gain_bound},
        "poles": [root._asdict() for root in bode.roots(fit.model.denominator)],
        "zeros": [root._asdict() for root in bode.roots(fit.model.numerator)],
        "error": fit.error,
        "model_error": fit.model_error,
        **corners_dict(_corners(fit, measured)),
    }


def as_dict(found: Identification) -> dict[str, Any]:
    """The whole identification for JSON."""
    known, m = found.known, found.measured
    about: dict[str, Any] = {"source": found.source, "sample_period": known.period, "u_max": known.u_max}
    if m is None:
        about["model"] = {
            **model_dict(known.model),
            "delay_s": known.delay,
            "static_gain": known.model.static_gain,
            **corners_dict(bode.model_corners(known.model, known.delay)),
        }
    else:
        about["response"] = {"method": m.method, **m.as_dict()}
        about["fits"] = [fit_dict(fit, m) for fit in found.fits]
        about["best_order"] = found.fits[-1].order
    about["theta"] = dict(zip(("initial", "min", "max"), known.theta, strict=True))
    parts = {"lvdt": known.lvdt, "friction": known.friction, "characteristic": found.curve}
    about |= {name: plain(part) for name, part in parts.items() if part is not None}
    if found.curve is not None:
        about["characteristic"]["half_of_hysteresis"] = about["characteristic"].pop("shares")
    return {**about, "gains": found.gains, "notes": list(found.notes)}


def plain(value: Any) -> Any:
    """``value`` with a dict in place of each record in it, for JSON."""
    return {n: plain(part) for n, part in value._asdict().items()} if hasattr(value, "_asdict") else value


def draw_bode(paths: Sequence[Path], found: Identification, figure: Any = None) -> None:
    """Draw measured response, coherence and fits; ``paths`` and ``figure``: as for ``draw_columns``."""
    m = found.measured
    assert m is not None
    frequency, plots = np.geomspace(m.frequency[0], m.frequency[-1], 500), []
    for title, read in (("position over voltage [dB]", bode.decibels), ("phase [°]", bode.degrees)):
        lines = []
        for fit in found.fits:
            value = bode.held_response(fit.model, frequency, m.period, fit.delay)
            late = f" + {1e3 * fit.delay:.2g} ms dead time" if "delay" in fit.names else ""
            label = f"order {fit.order}{late}, error {100 * fit.error:.2g} %"
            lines.append(Line(label, frequency, read(value)))
        lines.append(Line("measured", m.frequency, read(m.value), "black", "o"))
        plots.append(Plot(title, lines))
    least = Line("limit for a sweep", m.frequency, np.full(len(m.frequency), LEAST_COHERENCE), "gray", "--")
    plots.append(Plot("coherence", [Line("", m.frequency, m.coherence, "gray"), least]))
    draw_columns(paths, {"": plots}, "frequency [Hz]", found.source, logarithmic_x=True, figure=figure)
