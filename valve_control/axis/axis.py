# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Simulates one sample of a hydraulic axis as a pure step: supply, spool edges, cylinder and load.

docs/explanation/axis.md derives the equations. The state of a room of oil is its content W [m³], measured at
vapour pressure: its pressure is p = p_v + 2β·(W - V)/(W + V). So a room that is closed loses nothing, and no
pressure falls below that of vapour: with W < V, the difference is a cavity.

The equations are stiff (a small room answers in microseconds). They are integrated by the two-stage
W-method ROS2 of Verwer, Spee, Blom and Hundsdorfer (1999), of order two with any Jacobian and L-stable. Its
linear system is solved by hand: the three pressures first, then the velocity.
"""

import math
from typing import NamedTuple

GAMMA = 1.0 - 1.0 / math.sqrt(2.0)  # of ROS2, L-stable


class Cylinder(NamedTuple):
    """Cylinder with its lines. Room a drives the piston out, room b in."""

    area_a: float  # m²
    area_b: float  # m²
    stroke: float  # m
    dead_a: float  # m³  volume of room a with its line, piston in
    dead_b: float  # m³  volume of room b with its line, piston out
    leakage: float  # m³/s/Pa  from room to room
    external_leakage: float  # m³/s/Pa  from each room to the tank


class Load(NamedTuple):
    """What the piston moves."""

    mass: float  # kg  piston too
    damping: float  # N·s/m
    stiffness: float  # N/m  of a spring
    rest: float  # m  position at which the spring is slack
    force: float  # N  all constant forces, positive: in the direction out
    coulomb: float  # N  friction while sliding, 0: none
    static_ratio: float  # -  static over Coulomb friction
    stribeck_velocity: float  # m/s
    bristle_stiffness: float  # N/m  of friction before sliding


class Edges(NamedTuple):
    """One number for each edge of the spool: supply to a, supply to b, a to tank, b to tank."""

    pa: float
    pb: float
    at: float
    bt: float


class Supply(NamedTuple):
    """Pump, relief valve and the room between them and the spool."""

    volume: float  # m³
    pump_flow: float  # m³/s
    pump_leakage: float  # m³/s/Pa
    tank: float  # Pa
    relief_pressure: float  # Pa  at which the relief valve begins to open
    relief_spring: float  # √Pa·s·Pa/m³  √p_n/k_cs
    relief_flow_force: float  # s·√Pa/m³  1/(k_cf·√p_n)
    relief_limit: float  # m³/s/√Pa  fully open
    relief_time: float  # s


class Params(NamedTuple):
    """One axis at one sample period. All pressures are absolute."""

    cylinder: Cylinder
    load: Load
    coefficients: Edges  # m³/s/√Pa  fully open
    overlaps: Edges  # -  share of the spool's stroke
    full_scale: float  # V  spool position at which the edges are fully open
    supply: Supply
    bulk_modulus: float  # Pa
    vapour: float  # Pa
    laminar: float  # Pa  pressure difference below which the flow over an edge is laminar
    period: float  # s
    steps: float  # -  integration steps in a period, a whole number


class State(NamedTuple):
    """State of the axis; also one increment of the integration."""

    x: float  # m
    v: float  # m/s
    a: float  # m³  content of room a at vapour pressure
    b: float  # m³
    supply: float  # m³
    relief: float  # m³/s/√Pa  opening of the relief valve
    bristle: float  # m  deflection


class Pressures(NamedTuple):
    """Pressures [Pa] in the two rooms of the cylinder and at the supply port."""

    a: float
    b: float
    supply: float


class Flow(NamedTuple):
    """Flow through an orifice and what a small change of the pressure difference adds to it."""

    flow: float  # m³/s
    conductance: float  # m³/s/Pa  derivative of the flow with respect to the pressure difference


class Flows(NamedTuple):
    """Flows [m³/s] over the edges, through the relief valve, and net into the three rooms."""

    pa: float
    pb: float
    at: float
    bt: float
    relief: float
    into_a: float
    into_b: float
    into_supply: float


def flow(coefficient: float, difference: float, laminar: float) -> Flow:
    """Flow at a pressure ``difference`` [Pa], of its sign; ``coefficient`` in m³/s/√Pa.

    q = k·Δp/(Δp² + Δp_l²)^¼: k·√Δp beyond the ``laminar`` pressure Δp_l [Pa], k·Δp/√Δp_l below it, smooth
    in between, so that the derivative at 0 is finite (Merritt 1967, section 3.3: at small Reynolds numbers
    the flow through an orifice is laminar).
    """
    squares = difference * difference + laminar * laminar
    root = math.sqrt(squares)
    scale = coefficient / math.sqrt(root)
    slope = scale * (0.5 * difference * difference + laminar * laminar) / squares
    return Flow(scale * difference, slope)


def opening(spool: float, overlap: float) -> float:
    """Opening of an edge, 0 to 1, at the ``spool`` position (share of its stroke, positive: towards open).

    ``overlap`` (share of the stroke): dead zone; negative, the edge is open in the middle.
    """
    return max(0.0, min(1.0, (spool - overlap) / (1.0 - overlap)))


def volumes(c: Cylinder, x: float) -> tuple[float, float]:
    """Volumes [m³] of the rooms a and b with the piston at ``x`` [m]."""
    return c.dead_a + c.area_a * x, c.dead_b + c.area_b * (c.stroke - x)


def room_pressure(p: Params, content: float, volume: float) -> float:
    """Pressure [Pa] of ``content`` (m³ at vapour pressure) in a ``volume`` [m³]."""
    if content <= volume:
        return p.vapour
    return p.vapour + 2.0 * p.bulk_modulus * (content - volume) / (content + volume)


def content(p: Params, pressure: float, volume: float) -> float:
    """Content [m³ at vapour pressure] of a full room of ``volume`` [m³] at ``pressure`` [Pa]."""
    strain = 0.5 * (pressure - p.vapour) / p.bulk_modulus
    return volume * (1.0 + strain) / (1.0 - strain)


def pressures(p: Params, s: State) -> Pressures:
    """Pressures of all rooms."""
    volume_a, volume_b = volumes(p.cylinder, s.x)
    return Pressures(
        room_pressure(p, s.a, volume_a),
        room_pressure(p, s.b, volume_b),
        room_pressure(p, s.supply, p.supply.volume),
    )


def initial(p: Params, x: float, a: float, b: float, supply: float) -> State:
    """Axis at rest at ``x`` [m] with the pressures ``a``, ``b`` and ``supply`` [Pa]."""
    volume_a, volume_b = volumes(p.cylinder, x)
    return State(
        x,
        0.0,
        content(p, a, volume_a),
        content(p, b, volume_b),
        content(p, supply, p.supply.volume),
        relief_opening(p.supply, supply),
        0.0,
    )


def relief_balance(s: Supply, pressure: float) -> float:
    """Opening [m³/s/√Pa], without stops, at which a supply ``pressure`` [Pa] balances the poppet."""
    over = max(0.0, pressure - s.tank)
    return (pressure - s.relief_pressure) / (s.relief_spring + s.relief_flow_force * over)


def relief_opening(s: Supply, pressure: float) -> float:
    """Opening [m³/s/√Pa] at which the relief valve comes to rest at a supply ``pressure`` [Pa]."""
    return max(0.0, min(s.relief_limit, relief_balance(s, pressure)))


def relief_stopped(s: Supply, opening: float, pressure: float) -> bool:
    """Whether a stop holds the relief valve's poppet; the forces on it go on."""
    balance = relief_balance(s, pressure)
    return (opening <= 0.0 and balance < opening) or (opening >= s.relief_limit and balance > opening)


def relief_rate(s: Supply, opening: float, pressure: float) -> float:
    """Rate of the relief valve's opening."""
    if relief_stopped(s, opening, pressure):
        return 0.0
    return (relief_balance(s, pressure) - opening) / s.relief_time


def friction_level(load: Load, v: float) -> float:
    """Friction force [N] while sliding at ``v`` [m/s]: Coulomb's with Stribeck's addition."""
    ratio = v / load.stribeck_velocity
    return load.coulomb * (1.0 + (load.static_ratio - 1.0) * math.exp(-ratio * ratio))


def bristle_rate(load: Load, v: float, bristle: float) -> float:
    """Rate [m/s] of the bristles' deflection (LuGre, Canudas de Wit et al. 1995)."""
    if load.coulomb == 0.0:
        return 0.0
    return v - load.bristle_stiffness * abs(v) / friction_level(load, v) * bristle


def force(p: Params, s: State, now: Pressures) -> float:
    """Force [N] that accelerates the mass, positive: out."""
    load = p.load
    pushed = now.a * p.cylinder.area_a - now.b * p.cylinder.area_b
    rod = p.supply.tank * (p.cylinder.area_a - p.cylinder.area_b)  # air on the rod
    spring = load.stiffness * (s.x - load.rest)
    return pushed - rod - load.damping * s.v - spring - load.bristle_stiffness * s.bristle + load.force


def swelling(content: float, volume: float) -> float:
    """Oil at vapour pressure [m³] that one m³ of the room's oil is."""
    return max(1.0, content / volume)


def flows(p: Params, s: State, now: Pressures, spool: float) -> Flows:
    """All flows at a ``spool`` position (share of its stroke)."""
    o, k, c, supply = p.overlaps, p.coefficients, p.cylinder, p.supply
    pa = flow(k.pa * opening(spool, o.pa), now.supply - now.a, p.laminar).flow
    pb = flow(k.pb * opening(-spool, o.pb), now.supply - now.b, p.laminar).flow
    at = flow(k.at * opening(-spool, o.at), now.a - supply.tank, p.laminar).flow
    bt = flow(k.bt * opening(spool, o.bt), now.b - supply.tank, p.laminar).flow
    relief = flow(max(0.0, s.relief), now.supply - supply.tank, p.laminar).flow
    across = c.leakage * (now.a - now.b)
    return Flows(
        pa,
        pb,
        at,
        bt,
        relief,
        pa - at - across - c.external_leakage * (now.a - supply.tank),
        pb - bt + across - c.external_leakage * (now.b - supply.tank),
        supply.pump_flow - supply.pump_leakage * (now.supply - supply.tank) - pa - pb - relief,
    )


def rates(p: Params, s: State, spool: float, held: bool) -> State:
    """Time derivatives of the state at a ``spool`` position (share of its stroke).

    ``held``: the piston is pressed against a stop.
    """
    now = pressures(p, s)
    q = flows(p, s, now, spool)
    volume_a, volume_b = volumes(p.cylinder, s.x)
    return State(
        s.v,
        0.0 if held else force(p, s, now) / p.load.mass,
        q.into_a * swelling(s.a, volume_a),
        q.into_b * swelling(s.b, volume_b),
        q.into_supply * swelling(s.supply, p.supply.volume),
        relief_rate(p.supply, s.relief, now.supply),
        bristle_rate(p.load, s.v, s.bristle),
    )


def compliance(p: Params, content: float, volume: float) -> float:
    """Oil [m³/Pa] that raises the pressure of a room; without limit if there is a cavity in it."""
    if content <= volume:
        return 1e6 * volume
    total = content + volume
    return 0.25 * total * total / (p.bulk_modulus * volume)


def is_held(p: Params, s: State) -> bool:
    """Whether the piston is pressed against a stop."""
    if 0.0 < s.x < p.cylinder.stroke:
        return False
    push = force(p, s, pressures(p, s))
    if s.x <= 0.0:
        return s.v <= 0.0 and push <= 0.0
    return s.v >= 0.0 and push >= 0.0


def integrate(p: Params, s: State, step: float, spool: float, spool_after: float) -> State:
    """State one integration ``step`` [s] later; ``spool`` (share of its stroke) at both its ends.

    A piston that reaches a stop stays there: the impact is plastic. A room that is emptied faster than the
    step can follow ends empty.
    """
    held = is_held(p, s)
    if held:
        s = State(s.x, 0.0, s.a, s.b, s.supply, s.relief, s.bristle)
    s = stages(p, s, step, spool, spool_after, held)
    x, v = s.x, s.v
    if x < 0.0:
        x, v = 0.0, 0.0
    elif x > p.cylinder.stroke:
        x, v = p.cylinder.stroke, 0.0
    relief = max(0.0, min(p.supply.relief_limit, s.relief))
    return State(x, v, max(s.a, 0.0), max(s.b, 0.0), max(s.supply, 0.0), relief, s.bristle)


def stages(p: Params, s: State, step: float, spool: float, spool_after: float, held: bool) -> State:
    """State after both stages of ROS2, each of which solves (I - γhJ)·k = r by hand.

    Linearised at ``s``. Left out are the changes of swelling and of the relief valve's curve: they are small,
    and the order of the method does not depend on them.
    """
    c, load, supply = p.cylinder, p.load, p.supply
    now = pressures(p, s)
    volume_a, volume_b = volumes(c, s.x)
    o, k = p.overlaps, p.coefficients
    h = GAMMA * step
    pa = flow(k.pa * opening(spool, o.pa), now.supply - now.a, p.laminar).conductance
    pb = flow(k.pb * opening(-spool, o.pb), now.supply - now.b, p.laminar).conductance
    at = flow(k.at * opening(-spool, o.at), now.a - supply.tank, p.laminar).conductance
    bt = flow(k.bt * opening(spool, o.bt), now.b - supply.tank, p.laminar).conductance
    relief = flow(1.0, now.supply - supply.tank, p.laminar)
    over = max(0.0, now.supply - supply.tank)
    gain = 1.0 / (supply.relief_spring + supply.relief_flow_force * over) / supply.relief_time
    if relief_stopped(supply, s.relief, now.supply):
        gain = 0.0
    relief_lag = 1.0 + h / supply.relief_time
    own_a = pa + at + c.leakage + c.external_leakage
    own_b = pb + bt + c.leakage + c.external_leakage
    own_supply = pa + pb + s.relief * relief.conductance + supply.pump_leakage
    push_a = c.area_a * swelling(s.a, volume_a)
    push_b = c.area_b * swelling(s.b, volume_b)

    d_a = compliance(p, s.a, volume_a) / h + own_a
    l_b = -c.leakage / d_a
    d_b = compliance(p, s.b, volume_b) / h + own_b + c.leakage * l_b
    l_supply_a = -pa / d_a
    rest_b = -pb + c.leakage * l_supply_a
    l_supply_b = rest_b / d_b
    d_supply = compliance(p, s.supply, supply.volume) / h + own_supply + relief.flow * h * gain / relief_lag
    d_supply += pa * l_supply_a - rest_b * l_supply_b

    # Pressures that a unit of velocity makes: right side (-push_a, push_b, 0).
    y_b = push_b + l_b * push_a
    y_supply = l_supply_a * push_a - l_supply_b * y_b
    per_supply = y_supply / d_supply
    per_b = y_b / d_b - l_supply_b * per_supply
    per_a = -push_a / d_a - l_b * per_b - l_supply_a * per_supply

    friction_lag, friction_gain = 1.0, 0.0
    if load.coulomb > 0.0:
        stiff = load.bristle_stiffness / friction_level(load, s.v)
        friction_lag = 1.0 + h * stiff * abs(s.v)
        friction_gain = 1.0 - stiff * math.copysign(s.bristle, s.v * s.bristle)
    inverse_mass = 0.0 if held else 1.0 / load.mass
    resistance = load.damping + h * load.stiffness
    resistance += load.bristle_stiffness * h * friction_gain / friction_lag
    pivot = 1.0 + h * inverse_mass * (resistance - c.area_a * per_a + c.area_b * per_b)
    # Both stages: the three pressures with the piston's displacement of this step, then the velocity.
    f = rates(p, s, spool, held)
    r = scaled(f, step)
    first = second = r
    for stage in range(2):
        if stage == 1:
            f = rates(p, combined(s, first, 1.0), spool_after, held)
            r = combined(scaled(f, step), first, -2.0)
        opened = r.relief / relief_lag
        r_a = (r.a - push_a * r.x) / h
        r_b = (r.b + push_b * r.x) / h
        r_supply = r.supply / h - relief.flow * opened
        y_b = r_b - l_b * r_a
        at_supply = (r_supply - l_supply_a * r_a - l_supply_b * y_b) / d_supply
        at_b = y_b / d_b - l_supply_b * at_supply
        at_a = r_a / d_a - l_b * at_b - l_supply_a * at_supply
        rubbing = load.bristle_stiffness * r.bristle / friction_lag
        push = c.area_a * at_a - c.area_b * at_b - load.stiffness * r.x - rubbing
        v = (r.v + h * inverse_mass * push) / pivot
        a = at_a + per_a * v
        b = at_b + per_b * v
        in_supply = at_supply + per_supply * v
        opened = opened + h * gain / relief_lag * in_supply
        second = State(
            r.x + h * v,
            v,
            r.a + h * (pa * in_supply + c.leakage * b - own_a * a),
            r.b + h * (pb * in_supply + c.leakage * a - own_b * b),
            r.supply + h * (pa * a + pb * b - own_supply * in_supply - relief.flow * opened),
            opened,
            (r.bristle + h * friction_gain * v) / friction_lag,
        )
        if stage == 0:
            first = second
    return combined(combined(s, first, 1.5), second, 0.5)


def scaled(s: State, factor: float) -> State:
    """``factor``·s."""
    x, v, a, b, supply, relief, z = s
    return State(factor * x, factor * v, factor * a, factor * b, factor * supply, factor * relief, factor * z)


def combined(s: State, k: State, factor: float) -> State:
    """S + ``factor``·k."""
    return State(
        s.x + factor * k.x,
        s.v + factor * k.v,
        s.a + factor * k.a,
        s.b + factor * k.b,
        s.supply + factor * k.supply,
        s.relief + factor * k.relief,
        s.bristle + factor * k.bristle,
    )


def step(p: Params, s: State, begin: float, begin_rate: float, end: float, end_rate: float) -> State:
    """State one period later, while the spool goes from ``begin`` to ``end`` [V].

    In between it is the cubic with the rates [V/s] at both ends.
    """
    n = int(p.steps)
    h = p.period / n
    b1, e1 = begin_rate * p.period, end_rate * p.period
    spool = begin / p.full_scale
    for i in range(n):
        t = (i + 1.0) / n
        rest = 1.0 - t
        after = rest * rest * ((1.0 + 2.0 * t) * begin + t * b1) + t * t * ((3.0 - 2.0 * t) * end - rest * e1)
        after /= p.full_scale
        s = integrate(p, s, h, spool, after)
        spool = after
    return s
