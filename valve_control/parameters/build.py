"""From checked values to the immutable parameters of laws, valve and command shape."""

import math
from collections.abc import Sequence
from typing import Any

from valve_control.laws import arc, compensator, guarantee, oarc, pid, reshaping, velocity
from valve_control.laws.projection import Theta
from valve_control.parameters import design
from valve_control.parameters.table import ParameterError, Value, Values
from valve_control.plant import valve
from valve_control.plant.models import MODELS, TransferFunction
from valve_control.simulation.scenarios import Shape, steps_of, stroke_time

THETA_NAMES = ("a1", "a0", "b0", "b0·dn")


def number(values: Values, name: str) -> float:
    """A parameter that the table declares a number."""
    value = values[name]
    assert isinstance(value, (int, float))
    return value


def numbers(values: Values, name: str) -> Sequence[float]:
    """A parameter that the table declares a list of doubles."""
    return [float(entry) for entry in items(values, name)]


def items(values: Values, name: str) -> Sequence[float | str]:
    """A parameter that the table declares a list."""
    value = values[name]
    assert isinstance(value, list)
    return value


def word(values: Values, name: str) -> str:
    """A parameter that the table declares a string."""
    value = values[name]
    assert isinstance(value, str)
    return value


def reshaping_params(values: Values) -> reshaping.Params:
    """Reshaping filter from the controller's values. Raises ParameterError."""
    wn = number(values, "reshaping.natural_frequency")
    damping = number(values, "reshaping.damping")
    period = number(values, "sample_period")
    # The Euler step (11) of the filter (8) is stable below this frequency.
    limit = 2.0 * damping if damping <= 1.0 else 2.0 * (damping - math.sqrt(damping**2 - 1.0))
    if wn * period >= limit:
        raise ParameterError(
            f"reshaping.natural_frequency is {wn:g} rad/s; at a sample period of {period:g} s and "
            f"damping {damping:g} it must be below {limit / period:g} rad/s"
        )
    return reshaping.Params(
        wn, damping, number(values, "reshaping.max_rate"), number(values, "reshaping.max_accel"), period
    )


def _bounds(values: Values, law: str) -> tuple[Theta, Theta, Theta]:
    lower = numbers(values, f"{law}.theta_min")
    start = numbers(values, f"{law}.theta_initial")
    upper = numbers(values, f"{law}.theta_max")
    for i, name in enumerate(THETA_NAMES):
        if lower[i] > upper[i]:
            raise ParameterError(
                f"{law}.theta_min[{i}] ({name}) is {lower[i]:g}, above {law}.theta_max[{i}], {upper[i]:g}"
            )
        if not lower[i] <= start[i] <= upper[i]:
            raise ParameterError(
                f"{law}.theta_initial[{i}] ({name}) is {start[i]:g}; it must lie between "
                f"{law}.theta_min[{i}], {lower[i]:g}, and {law}.theta_max[{i}], {upper[i]:g}"
            )
    if lower[2] <= 0.0:
        raise ParameterError(
            f"{law}.theta_min[2] (b0) is {lower[2]:g}; it must be positive, since the law divides by b0"
        )
    return Theta(*start), Theta(*lower), Theta(*upper)


def _robust(values: Values, law: str) -> float:
    return 1.0 if values[f"{law}.robust_term"] == "quadratic" else 0.0


def arc_params(values: Values) -> arc.Params:
    """ARC from the controller's values. Raises ParameterError."""
    period = number(values, "sample_period")
    start, lower, upper = _bounds(values, "arc")
    k1, k2 = number(values, "arc.k1"), number(values, "arc.k2")
    robust = _robust(values, "arc")
    return arc.Params(
        k1=k1,
        k2=k2,
        gamma=Theta(*numbers(values, "arc.gamma")),
        theta_initial=start,
        theta_min=lower,
        theta_max=upper,
        robust=robust,
        epsilon=number(values, "arc.epsilon"),
        disturbance_bound=number(values, "arc.disturbance_bound"),
        u_max=number(values, "u_max"),
        period=period,
        reshaping=reshaping_params(values),
        velocity=velocity.design(number(values, "arc.velocity_cutoff"), period),
        guarantee=guarantee.design(2.0 * min(k1, k2) if robust > 0.0 else min(2.0 * k1, k2), period),
    )


def oarc_params(values: Values) -> oarc.Params:
    """OARC from the controller's values. Raises ParameterError."""
    period = number(values, "sample_period")
    start, lower, upper = _bounds(values, "oarc")
    k1, k2 = number(values, "oarc.k1"), number(values, "oarc.k2")
    ks1, ks2 = number(values, "oarc.ks1"), number(values, "oarc.ks2")
    robust = _robust(values, "oarc")
    return oarc.Params(
        k1=k1,
        k2=k2,
        ks1=ks1,
        ks2=ks2,
        z2_weight=number(values, "oarc.z2_weight"),
        gamma=Theta(*numbers(values, "oarc.gamma")),
        theta_initial=start,
        theta_min=lower,
        theta_max=upper,
        robust=robust,
        epsilon1=number(values, "oarc.epsilon1"),
        epsilon2=number(values, "oarc.epsilon2"),
        disturbance_bound=number(values, "oarc.disturbance_bound"),
        u_max=number(values, "u_max"),
        period=period,
        filter=design.k_filter(k1, k2, period),
        reshaping=reshaping_params(values),
        guarantee=guarantee.design((2.0 if robust > 0.0 else 1.0) * min(ks1, ks2), period),
    )


def pid_params(values: Values) -> pid.Params:
    """PID from the controller's values. Raises ParameterError."""
    period = number(values, "sample_period")
    a1, a0, b0 = numbers(values, "pid.theta")
    if b0 <= 0.0:
        raise ParameterError(f"pid.theta[2] (b0) is {b0:g}; it must be positive")
    kp, ki, kd = (number(values, f"pid.{gain}") for gain in ("kp", "ki", "kd"))
    frequency = number(values, "pid.break_frequency")
    if frequency > 0.0:
        kp, ki, kd = pid.place_poles(frequency, a1, a0, b0)
        if min(kp, kd) < 0.0:
            raise ParameterError(
                f"pid.break_frequency is {frequency:g} Hz, which is slower than the valve itself and "
                f"would need negative gains (kp {kp:.3g}, kd {kd:.3g}); choose a higher one"
            )
    form = word(values, "pid.form")
    return pid.Params(
        kp=kp,
        ki=ki,
        kd=kd,
        a1=a1,
        a0=a0,
        b0=b0,
        measured_model_terms=1.0 if form == "paper" else 0.0,
        plain=1.0 if form == "plain" else 0.0,
        static_feedforward=number(values, "pid.static_feedforward"),
        u_max=number(values, "u_max"),
        period=period,
        reshaping=reshaping_params(values),
        velocity=velocity.design(number(values, "pid.derivative_cutoff"), period),
    )


def _model(values: Values, choice: str, prefix: str) -> TransferFunction:
    name = word(values, choice)
    if name in MODELS:
        return MODELS[name]
    model = TransferFunction(
        tuple(numbers(values, f"{prefix}numerator")), tuple(numbers(values, f"{prefix}denominator"))
    )
    if not any(model.denominator) or not model.denominator or model.denominator[-1] == 0.0:
        raise ParameterError(
            f"{prefix}denominator is {list(model.denominator)}; its last entry must not be 0"
        )
    if not model.numerator or model.numerator[-1] == 0.0:
        raise ParameterError(f"{prefix}numerator is {list(model.numerator)}; its last entry must not be 0")
    return model


def valve_model(values: Values) -> TransferFunction:
    """Linear model of the valve, with its gain scaled. Raises ParameterError."""
    model = _model(values, "valve", "")
    scale = number(values, "gain_scale")
    return TransferFunction(tuple(scale * c for c in model.numerator), model.denominator)


def compensator_params(values: Values) -> compensator.Params:
    """Compensator from the controller's values. Raises ParameterError."""
    chosen = word(values, "compensator.design")
    period = number(values, "sample_period")
    try:
        if chosen == "printed_second_order":
            transfer_function = design.PRINTED_SECOND_ORDER
        elif chosen == "printed_fourth_order":
            transfer_function = design.PRINTED_FOURTH_ORDER
        else:
            transfer_function = design.pole_zero_compensator(
                _model(values, "compensator.model", "compensator."),
                number(values, "compensator.bandwidth"),
                bool(values["compensator.cancel_zeros"]),
                int(number(values, "compensator.order")),
            )
        return design.compensator_params(transfer_function, period, number(values, "u_max"))
    except design.DesignError as error:
        raise ParameterError(str(error)) from error


def open_loop_params(values: Values) -> compensator.Params:
    """Static gain from the controller's values."""
    return design.static_params(number(values, "open_loop.static_gain"), number(values, "u_max"))


LAW_PARAMS = {
    "arc": arc_params,
    "oarc": oarc_params,
    "pid": pid_params,
    "compensator": compensator_params,
    "open_loop": open_loop_params,
}


def law_params(values: Values) -> Any:
    """Params of the law that ``controller`` names.

    Every other law is built too, so that a set that could not be switched to is refused at once.
    Raises ParameterError.
    """
    return {name: make(values) for name, make in LAW_PARAMS.items()}[word(values, "controller")]


def valve_params(values: Values) -> valve.Params:
    """Valve from the simulator's values. Raises ParameterError."""
    disturbance = valve.Disturbance(
        coulomb=number(values, "friction.coulomb"),
        static_ratio=number(values, "friction.static_ratio"),
        stribeck_velocity=number(values, "friction.stribeck_velocity"),
        velocity_scale=number(values, "friction.velocity_scale"),
        presliding=number(values, "friction.presliding"),
        flow_force=number(values, "flow_force"),
        offset=number(values, "disturbance.offset"),
        stiffness_drift=number(values, "drift.stiffness"),
        gain_drift=number(values, "drift.gain"),
    )
    try:
        return valve.design(
            _model(values, "valve", ""),
            number(values, "sample_period"),
            number(values, "u_max"),
            number(values, "gain_scale"),
            disturbance,
            number(values, "lvdt.noise"),
            number(values, "lvdt.resolution"),
            number(values, "lvdt.bias"),
            number(values, "lvdt.delay"),
        )
    except valve.ModelError as error:
        raise ParameterError(str(error)) from error


def shape(values: Values) -> Shape:
    """Command shape from the command source's values. Raises ParameterError."""
    made = Shape(
        scenario=word(values, "scenario"),
        amplitude=number(values, "amplitude"),
        offset=number(values, "offset"),
        start=number(values, "start"),
        frequency=number(values, "frequency"),
        end_frequency=number(values, "end_frequency"),
        max_velocity=number(values, "max_velocity"),
        max_accel=number(values, "max_accel"),
        cycle=number(values, "cycle"),
        sweep_time=number(values, "sweep_time"),
        steps=int(number(values, "steps")),
        cycles=int(number(values, "cycles")),
        step_time=number(values, "step_time"),
    )
    if made.scenario == "stepped_sine":
        needed = made.start + steps_of(made)[-1].end
        if needed > number(values, "duration"):
            raise ParameterError(
                f"duration is {number(values, 'duration'):g} s; the stepped sine takes {needed:.4g} s"
            )
    if made.scenario == "point_to_point":
        ramp, cruise, _ = stroke_time(abs(made.amplitude), made.max_velocity, made.max_accel)
        needed = 2.0 * (2.0 * ramp + cruise)
        if needed > made.cycle:
            raise ParameterError(
                f"cycle is {made.cycle:g} s; a stroke of {made.amplitude:g} V there and back takes "
                f"{needed:.3g} s"
            )
    return made


def as_text(value: Value) -> str:
    """``value`` as YAML would have it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ", ".join(str(v) for v in value) + "]"
    return f'"{value}"' if value == "" else str(value)
