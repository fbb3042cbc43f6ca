# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes a valve that was identified, or given: text, JSON, ROS 2 parameter file, Bode plot."""

from typing import Any, NamedTuple

import numpy as np

from valve_control import outputs
from valve_control.control.analysis.figures import COLOURS, bode_axes
from valve_control.control.laws.registry import ADAPTIVE
from valve_control.control.parameters import build
from valve_control.control.parameters.ros_file import as_yaml
from valve_control.control.parameters.table import NODES
from valve_control.control.plant.models import TransferFunction
from valve_control.design.identification import bode, characteristic, rational
from valve_control.design.identification.bode import Corners, Root
from valve_control.design.identification.characteristic import Characteristic, known_part
from valve_control.design.identification.first_gains import KnownValve, rounded
from valve_control.design.identification.rational import Fit
from valve_control.design.identification.response import Response
from valve_control.parameter import Values, defaults, updated

STABLE = "Stable with 0.67 to 1.5 times the gain, 0.8 to 1.25 times the speed, one more sample of delay."
UNBOUNDED = Corners(None, None)
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
    simulated: Values = {}  # of the simulator, what it has beside the model and in its place


def polynomial(coefficients: tuple[float, ...]) -> str:
    """A polynomial in s, such as s² + 58.77 s + 1657."""
    text = ""
    for power, c in zip(reversed(range(len(coefficients))), coefficients, strict=True):
        s = ("", "s")[power] if power < 2 else f"s{'⁰¹²³⁴⁵⁶⁷⁸⁹'[power]}"
        size = s if s and abs(c) == 1.0 else f"{abs(c):.7g} {s}".rstrip()
        text += f" {'-' if c < 0.0 else '+'} {size}" if text else f"{'-' if c < 0.0 else ''}{size}"
    return text


def hertz(frequency: float | None, bound: float | None = None) -> str:
    """A frequency as text for a table, with its ``bound`` if there is one, or that there is none."""
    if frequency is None:
        return "none"
    return (
        f"{frequency:.2f} Hz" if bound is None else f"{known_part(frequency, 0.1 * bound):g} ± {bound:.2g} Hz"
    )


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


def corners_text(corners: Corners, bounds: Corners = UNBOUNDED) -> str:
    """Frequencies of -3 dB and -90°, with their ``bounds``."""
    return f"-3 dB at {hertz(corners[0], bounds[0])}, -90° at {hertz(corners[1], bounds[1])}"


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
    late = f" with a delay of {1e3 * fit.delay:.3f} ms" if "delay" in fit.names else ""
    poles, zeros = (roots_text(bode.roots(part), measured) for part in (fit.model[1], fit.model[0]))
    lines = [
        f"order {fit.order}: {model_text(fit.model)}{late}",
        *_coefficients(fit, "  {0:6} {1:14.7g} ± {2:10.3g}  ({3:.2g} %)"),
        f"  static gain {fit.model.static_gain:.5f}{width} V/V; fit error {100 * fit.error:.3g} % rms{share}",
        f"  poles {poles}; zeros {zeros}",
        f"  {corners_text(_corners(fit, measured), fit.corner_bounds if fit.bounded else UNBOUNDED)}",
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
        corners = corners_text(rational.measured_corners(m, known.model.static_gain))
        lines = [
            found.source,
            f"measured: {m.method}, {len(m.frequency)} frequencies from {m.frequency[0]:.4g} to "
            f"{m.frequency[-1]:.4g} Hz, uncertainty {np.min(relative):.2g} to {np.max(relative):.2g} %, "
            f"coherence {np.min(m.coherence):.3f} to {np.max(m.coherence):.3f}; {corners}",
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
    valve: Values = found.simulated or {
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


def corners_dict(corners: Corners, what: str = "") -> dict[str, float | None]:
    """Frequencies of -3 dB and -90°, or ``what`` of them this is, for JSON."""
    return {f"{name}{what}_hz": frequency for name, frequency in corners._asdict().items()}


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
        **corners_dict(fit.corner_bounds if fit.bounded else UNBOUNDED, "_bound"),
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
        about["response"] = {
            "method": m.method,
            **m.as_dict(),
            **corners_dict(rational.measured_corners(m, known.model.static_gain)),
        }
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
    return (
        {name: plain(part) for name, part in value._asdict().items()} if hasattr(value, "_asdict") else value
    )


def bode_figure(found: Identification, path: str) -> bytes:
    """Draw the measured response with 95 % error bars and the fits, as the file ``path``."""
    measured = found.measured
    assert measured is not None
    figure, top, bottom = bode_axes(found.source, "position over voltage [dB]")
    share = 1.96 * measured.deviation / np.abs(measured.value)
    bar = np.vstack([-20.0 * np.log10(np.maximum(1.0 - share, 0.05)), 20.0 * np.log10(1.0 + share)])
    turn = np.degrees(np.minimum(share, np.pi))
    label = f"measured ({measured.method})"
    for axes, read, bars in ((top, bode.decibels, bar), (bottom, bode.degrees, turn)):
        axes.errorbar(
            measured.frequency, read(measured.value), yerr=bars,
            fmt="o", ms=4, color="black", lw=1.0, capsize=2, label=label,
        )  # fmt: skip
    share_axis = top.twinx()
    share_axis.plot(measured.frequency, measured.coherence, ".--", ms=3, lw=0.8, color="gray")
    share_axis.set(ylabel="coherence (gray)", ylim=(0.0, 1.05))
    frequency = np.geomspace(measured.frequency[0], measured.frequency[-1], 500)
    for fit, colour in zip(found.fits, COLOURS, strict=False):
        value = bode.held_response(fit.model, frequency, measured.period, fit.delay)
        label = f"order {fit.order}, error {100 * fit.error:.2g} %"
        top.semilogx(frequency, bode.decibels(value), color=colour, label=label)
        bottom.semilogx(frequency, bode.degrees(value), color=colour, label=label)
    top.legend(loc="lower left")
    figure.tight_layout()
    return outputs.figure_bytes(figure, path)
