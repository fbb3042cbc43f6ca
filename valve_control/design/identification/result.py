# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Writes the result of an identification: tables, ROS 2 parameter file, JSON, CSV, Bode plot."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from valve_control import outputs
from valve_control.control.analysis.figures import COLOURS, bode_axes
from valve_control.control.laws.registry import ADAPTIVE
from valve_control.control.parameters import build
from valve_control.control.parameters.files import load
from valve_control.control.parameters.ros_file import as_yaml
from valve_control.control.parameters.table import NODES
from valve_control.control.plant.models import TransferFunction
from valve_control.design.identification import bode, characteristic, first_gains, rational
from valve_control.design.identification.bode import Corners, Root
from valve_control.design.identification.characteristic import Characteristic
from valve_control.design.identification.friction import Friction
from valve_control.design.identification.lvdt import Lvdt
from valve_control.design.identification.rational import Fit
from valve_control.design.identification.response import Response
from valve_control.design.identification.theta import Suggestion
from valve_control.parameter import ParameterError, Values, defaults, updated

STABLE = (
    "Gains of pid, arc, oarc, dcarc: for a first run, stable with 0.67 to 1.5 times the gain, 0.8 to",
    "1.25 times the speed and a sample period of dead time more.",
)
NEAR = 1.1  # times the highest excited frequency, and over the lowest, up to which a test tells something


class Identification(NamedTuple):
    """All results of an identification."""

    source: str
    measured: Response
    fits: tuple[Fit, ...]  # the last one stands for the valve
    theta: Suggestion
    lvdt: Lvdt
    gains: Values  # of the controller, for a first run
    u_max: float  # V
    notes: tuple[str, ...]
    friction: Friction | None = None  # None: not tested
    curve: Characteristic | None = None  # None: not tested, or to one side alone

    @property
    def best(self) -> Fit:
        """The fit that stands for the valve."""
        return self.fits[-1]


def polynomial(coefficients: tuple[float, ...]) -> str:
    """A polynomial in s, such as s² + 58.77 s + 1657."""
    powers = "⁰¹²³⁴⁵⁶⁷⁸⁹"
    text = ""
    for i, c in enumerate(coefficients):
        power = len(coefficients) - 1 - i
        s = "" if power == 0 else "s" if power == 1 else f"s{powers[power]}"
        size = s if s and abs(c) == 1.0 else f"{abs(c):.7g}{' ' if s else ''}{s}"
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


def corners_text(corners: Corners) -> str:
    """Frequencies of -3 dB and -90°."""
    return f"-3 dB at {hertz(corners.minus_3db)}, -90° at {hertz(corners.minus_90)}"


def _excited(frequency: float, measured: Response) -> bool:
    """Whether the test tells of this ``frequency`` [Hz]: it lies within those of ``measured``, or near by."""
    return bool(measured.frequency[0] / NEAR <= frequency <= NEAR * measured.frequency[-1])


def _corners(fit: Fit, measured: Response) -> Corners:
    """Corners of a ``fit`` that the test tells."""
    return Corners(*(None if c is None or not _excited(c, measured) else c for c in fit.corners))


def fit_text(made: Fit, measured: Response) -> str:
    """One fit to ``measured`` as the terminal shows it."""
    about = (
        f", of which the model {100 * made.model_error:.2g} %" if made.model_error else ", all of it noise"
    )
    width = f" ± {made.gain_bound:.2g}" if made.bounded else ""
    lines = [
        f"order {made.order}: ({polynomial(made.model.numerator)}) / ({polynomial(made.model.denominator)})"
        + (f" with a delay of {1e3 * made.delay:.3f} ms" if "delay" in made.names else "")
    ]
    for name, value, bound in zip(made.names, made.values, made.bounds, strict=True):
        share = 100.0 * bound / abs(value) if value else np.inf
        lines.append(
            f"  {name:6} {value:14.7g}" + (f" ± {bound:10.3g}  ({share:.2g} %)" if made.bounded else "")
        )
    lines += [
        f"  static gain {made.model.static_gain:.5f}{width} V/V; "
        f"fit error {100 * made.error:.3g} % rms{about}",
        f"  poles {roots_text(bode.roots(made.model.denominator), measured)}; "
        f"zeros {roots_text(bode.roots(made.model.numerator), measured)}",
        f"  {corners_text(_corners(made, measured))}",
    ]
    return "\n".join(lines)


def friction_text(found: Friction) -> str:
    """Friction as the terminal shows it."""
    told = f"presliding {1e3 * found.presliding:.3g} mV" if found.presliding else "presliding not to be told"
    return (
        f"friction: Coulomb {found.coulomb:.4g} V, {told}, offset {found.offset:.3g} V "
        f"(triangle, {found.strokes} strokes)"
    )


def theta_text(found: Suggestion) -> str:
    """Estimates and their bounds as the terminal shows them."""
    return (
        f"for arc and oarc: theta_initial {found.initial}\n"
        f"                  theta_min     {found.lower}\n"
        f"                  theta_max     {found.upper}"
    )


def text(found: Identification) -> str:
    """The whole identification as the terminal shows it."""
    m = found.measured
    corners = rational.measured_corners(m, found.best.model.static_gain)
    relative = m.deviation / np.abs(m.value)
    lines = [
        f"{found.source}",
        f"measured: {m.method}, {len(m.frequency)} frequencies from {m.frequency[0]:.4g} to "
        f"{m.frequency[-1]:.4g} Hz, uncertainty {100 * np.min(relative):.2g} to "
        f"{100 * np.max(relative):.2g} %, coherence {np.min(m.coherence):.3f} to {np.max(m.coherence):.3f}; "
        f"{corners_text(corners)}",
        *(fit_text(made, m) for made in found.fits),
        theta_text(found.theta),
        f"LVDT: noise {1e3 * found.lvdt.noise:.3g} mV, "
        + (f"steps of {1e3 * found.lvdt.resolution:.3g} mV" if found.lvdt.resolution else "no steps"),
        *([] if found.friction is None else [friction_text(found.friction)]),
        *([] if found.curve is None else [characteristic.text(found.curve)]),
        *(f"note: {note}" for note in found.notes),
    ]
    return "\n".join(lines)


def parameters(found: Identification) -> dict[str, Values]:
    """Parameters for the nodes: the valve's model, a compensator for it, the adaptive laws' estimates."""
    delay = found.best.delay if "delay" in found.best.names else None
    known = first_gains.KnownValve(
        found.best.model, delay or 0.0, found.theta, found.lvdt, found.measured.period, found.u_max,
        found.friction,
    )  # fmt: skip
    return parameters_of(known, delay is not None, found.gains)


def parameters_of(known: first_gains.KnownValve, late: bool, gains: Values) -> dict[str, Values]:
    """Parameters for the nodes of a valve and its first ``gains``; ``late``: the dead time belongs to it."""
    model, estimates = known.model, known.theta
    numerator, denominator = ([_rounded(c) for c in part] for part in model)
    bounds = {
        "theta_initial": estimates.initial,
        "theta_min": estimates.lower,
        "theta_max": estimates.upper,
    }
    valve: Values = {
        "valve": "custom",
        "numerator": numerator,
        "denominator": denominator,
        "gain_scale": 1.0,
        "flow_force": 0.0,
        "lvdt.noise": _rounded(known.lvdt.noise),
        "lvdt.resolution": _rounded(known.lvdt.resolution),
    }
    if late:
        valve["lvdt.delay"] = _rounded(known.delay)
    if known.friction is not None:
        valve["friction.coulomb"] = _rounded(known.friction.coulomb)
        valve["friction.static_ratio"] = 1.0
        valve["friction.presliding"] = _rounded(known.friction.presliding)
        valve["disturbance.offset"] = _rounded(known.friction.offset)
    controller: Values = {
        "compensator.design": "designed",
        "compensator.model": "custom",
        "compensator.numerator": numerator,
        "compensator.denominator": denominator,
        "open_loop.static_gain": _rounded(model.static_gain),
    }
    for law in ADAPTIVE:
        controller.update({f"{law}.{name}": list(values) for name, values in bounds.items()})
    controller.update(gains)
    return with_period({"valve_simulator": valve, "controller": controller}, known.period)


def with_period(tree: dict[str, Values], period: float) -> dict[str, Values]:
    """``tree`` with the sample period [s] for all nodes, unless it is the default."""
    if period == defaults(NODES["controller"])["sample_period"]:
        return tree
    return {"": {"sample_period": _rounded(period)}, **tree}


def check_parameters(tree: dict[str, Values]) -> None:
    """Raise ParameterError unless controller and simulator accept these parameters."""
    common = tree.get("", {})
    makers: dict[str, Callable[[Values], Any]] = {
        "valve_simulator": build.valve_params,
        "controller": build.law_params,
    }
    for node, make in makers.items():
        make(updated(NODES[node], defaults(NODES[node]), {**common, **tree.get(node, {})}))


def _rounded(value: float) -> float:
    return float(f"{value:.10g}")


def yaml_text(found: Identification) -> str:
    """A ROS 2 parameter file of ``parameters``."""
    made = found.best
    return parameter_file(
        parameters(found),
        [
            f"Identified from: {found.source}",
            f"Order {made.order}, fit error {100 * made.error:.3g} % rms; coefficients "
            + ("with 95 % bounds:" if made.bounded else "(the test does not tell their bounds):"),
            *(
                f"  {name} = {value:.7g}" + (f" ± {bound:.2g}" if made.bounded else "")
                for name, value, bound in zip(made.names, made.values, made.bounds, strict=True)
            ),
            "arc, oarc: the second-order fit to begin with; bounds from its confidence and from how far it",
            "is from the higher order over several bands of frequency.",
            *STABLE,
        ],
    )


def linearisation_text(found: Identification) -> str:
    """A ROS 2 parameter file of the inverse of the static curve, for the model of ``parameters``.

    Raises ParameterError if there is none.
    """
    assert found.curve is not None
    made = characteristic.parameters(found.curve, found.best.model.static_gain, found.u_max)
    values = {
        name: [_rounded(float(v)) for v in value] if isinstance(value, list) else value
        for name, value in made.items()
    }
    values["linearisation.gain"] = _rounded(found.best.model.static_gain)
    return parameter_file(
        {"controller": values},  # type: ignore[dict-item]
        [
            f"Inverse of the static curve, from: {found.source}",
            *characteristic.text(found.curve).splitlines(),
            "linearisation.gain is the static gain of the model in the file of --output; load both.",
        ],
    )


def parameter_file(tree: dict[str, Values], comments: list[str]) -> str:
    """A ROS 2 parameter file with a section for each node of any namespace; "" is all nodes."""
    return as_yaml({f"/**/{node}" if node else "/**": values for node, values in tree.items()}, comments)


def read_model(path: str) -> TransferFunction:
    """The valve's model in a parameter file such as ``identify`` writes. Raises ParameterError."""
    valve = load(path)["valve_simulator"]
    if "valve" not in valve and "numerator" not in valve:
        raise ParameterError(f"{path} has no valve model: neither 'valve' nor 'numerator' is in it")
    return build.valve_model(updated(NODES["valve_simulator"], defaults(NODES["valve_simulator"]), valve))


def corners_dict(found: Corners) -> dict[str, float | None]:
    """Corners for JSON."""
    return {"minus_3db_hz": found.minus_3db, "minus_90_hz": found.minus_90}


def theta_dict(found: Suggestion) -> dict[str, list[float]]:
    """Estimates and their bounds for JSON."""
    return {"initial": found.initial, "min": found.lower, "max": found.upper}


def fit_dict(made: Fit, measured: Response) -> dict[str, Any]:
    """One fit to ``measured`` for JSON; a corner that the test did not excite is None."""
    return {
        "order": made.order,
        "numerator": list(made.model.numerator),
        "denominator": list(made.model.denominator),
        "delay_s": made.delay,
        "coefficients": {
            name: {"value": float(value), "bound": float(bound) if made.bounded else None}
            for name, value, bound in zip(made.names, made.values, made.bounds, strict=True)
        },
        "static_gain": {
            "value": made.model.static_gain,
            "bound": made.gain_bound if made.bounded else None,
        },
        "poles": [root._asdict() for root in bode.roots(made.model.denominator)],
        "zeros": [root._asdict() for root in bode.roots(made.model.numerator)],
        "error": made.error,
        "model_error": made.model_error,
        **corners_dict(_corners(made, measured)),
    }


def as_dict(found: Identification) -> dict[str, Any]:
    """The whole identification for JSON."""
    m = found.measured
    return {
        "source": found.source,
        "sample_period": m.period,
        "u_max": found.u_max,
        "response": {
            "method": m.method,
            "frequency_hz": m.frequency,
            "real": m.value.real,
            "imaginary": m.value.imag,
            "deviation": m.deviation,
            "coherence": m.coherence,
            **corners_dict(rational.measured_corners(m, found.best.model.static_gain)),
        },
        "fits": [fit_dict(made, m) for made in found.fits],
        "best_order": found.best.order,
        "theta": theta_dict(found.theta),
        "lvdt": found.lvdt._asdict(),
        **({} if found.friction is None else {"friction": found.friction._asdict()}),
        **({} if found.curve is None else {"characteristic": characteristic.as_dict(found.curve)}),
        "gains": found.gains,
        "notes": list(found.notes),
    }


def bode_figure(found: Identification, path: str) -> bytes:
    """Draw the measured response with 95 % error bars and the fits, as the file ``path``."""
    m = found.measured
    figure, top, bottom = bode_axes(found.source, "position over voltage [dB]")
    share = 1.96 * m.deviation / np.abs(m.value)
    size = bode.decibels(m.value)
    bar = np.vstack([-20.0 * np.log10(np.maximum(1.0 - share, 0.05)), 20.0 * np.log10(1.0 + share)])
    turn = bode.degrees(m.value)
    style = {
        "fmt": "o",
        "ms": 4,
        "color": "black",
        "lw": 1.0,
        "capsize": 2,
        "label": f"measured ({m.method})",
    }
    top.errorbar(m.frequency, size, yerr=bar, **style)
    bottom.errorbar(m.frequency, turn, yerr=np.degrees(np.minimum(share, np.pi)), **style)
    share_axis = top.twinx()
    share_axis.plot(m.frequency, m.coherence, ".--", ms=3, lw=0.8, color="gray")
    share_axis.set(ylabel="coherence (gray)", ylim=(0.0, 1.05))
    frequency = np.geomspace(m.frequency[0], m.frequency[-1], 500)
    for made, colour in zip(found.fits, COLOURS, strict=False):
        value = bode.held_response(made.model, frequency, m.period, made.delay)
        label = f"order {made.order}, error {100 * made.error:.2g} %"
        top.semilogx(frequency, bode.decibels(value), color=colour, label=label)
        bottom.semilogx(frequency, bode.degrees(value), color=colour, label=label)
    top.legend(loc="lower left")
    figure.tight_layout()
    return outputs.figure_bytes(figure, path)
