# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The solenoid valve against stiff integration, closed forms, finer substeps and figures of its sources."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from valve_control.control.compiling import compile_function
from valve_control.control.parameters import files
from valve_control.control.parameters.table import VALVE
from valve_control.control.plant import solenoid, solenoid_valve, valve
from valve_control.parameter import defaults, updated

STEP = compile_function(solenoid.step)
PERIOD = 0.001


def values(**changes):
    """Values of the simulator; ``a__b`` is parameter a.b, and what has no dot belongs to the solenoid."""
    given = {"valve": "solenoid"}
    for name, value in changes.items():
        dotted = name.replace("__", ".")
        known = {p.name for p in VALVE}
        given[dotted if dotted in known else f"solenoid.{dotted}"] = value
    return updated(VALVE, defaults(VALVE), given)


def made(finer=1, **changes):
    return solenoid_valve.build(values(**changes), finer)


def run(p, voltages, step=STEP):
    """Rows of position, velocity, force, current, play and bristles at each sample, n+1 of them."""
    state = solenoid.initial(p)
    rows = [(*state.x, state.play, state.bristle)]
    for voltage in voltages:
        state = step(p, state, float(voltage))
        rows.append((*state.x, state.play, state.bristle))
    return np.array(rows)


TIME = np.arange(400) * PERIOD
MOTIONS = (
    3.0 * np.sin(2.0 * np.pi * 6.0 * TIME) + 2.0 * np.sin(2.0 * np.pi * 1.3 * TIME),
    np.where((8 * TIME).astype(int) % 2 == 1, 2.5, -1.0),
    0.3 * np.sin(2.0 * np.pi * 9.0 * TIME),
    14.0 * np.sign(np.sin(2.0 * np.pi * 5.0 * TIME)),
)
EVERYTHING = dict(
    u_min=-8.0, dead_time=0.0013, dither=0.2, dither_frequency=120.0, coil=0.003, eddy=0.001, hysteresis=0.3,
    positive=1.0, negative=0.85, overlap=0.1, friction__coulomb=0.6, friction__presliding=0.02,
    friction__static_ratio=1.4, friction__stribeck_velocity=0.05, bristle_damping=0.002, flow_force=0.1,
    pressure=70.0, disturbance__offset=0.1, drift__gain=0.05, drift__stiffness=0.1, natural_frequency=20.0,
    lvdt__delay=0.0007, bits=12, hum=0.004, null_drift=0.01, warming=20.0, warming_time=0.2,
)  # fmt: skip


def drawn(random):
    """A valve of the box of real ones."""
    return dict(
        natural_frequency=random.uniform(5.0, 60.0), damping=random.uniform(0.5, 1.2),
        coil=random.uniform(0.0005, 0.006), hysteresis=random.uniform(0.0, 0.8),
        positive=random.uniform(0.9, 1.1), negative=random.uniform(0.9, 1.1),
        friction__coulomb=random.uniform(0.0, 1.4), friction__presliding=random.uniform(0.005, 0.04),
        friction__static_ratio=random.uniform(1.0, 1.6),
        friction__stribeck_velocity=random.uniform(0.01, 0.1),
        disturbance__offset=random.uniform(-0.3, 0.3), flow_force=random.uniform(0.0, 0.15),
        dead_time=random.uniform(0.0, 0.0015), overlap=random.uniform(-0.3, 0.3),
    )  # fmt: skip


def integrated(p, voltages):
    """Position [V] at each sample, all in volts of the LVDT: Radau over each voltage, stops by events."""
    s, m, f = p.spool, p.magnet, p.friction
    stiffness = s.natural_frequency**2
    strength = stiffness * s.gain  # V/s² of a volt at the input
    x = np.zeros(3)  # V, V/s, bristles [V]
    current = play = 0.0  # over that of a volt
    dead, rows = p.amplifier.dead_time * p.period, [0.0]
    before = [0.0, 0.0, *voltages]
    whole = int(dead / p.period)
    late = dead - whole * p.period
    for k in range(len(voltages)):
        parts = ((before[k + 1 - whole], late), (before[k + 2 - whole], p.period - late))
        for asked, length in parts:
            if length <= 1e-15:
                continue
            u = min(p.u_max, max(p.amplifier.u_min, asked))
            i0, b0 = current, play

            def flowing(t, i0=i0, b0=b0, u=u):
                i = u + (i0 - u) * math.exp(-t / m.coil)
                return i, min(max(b0, i - 0.5 * m.hysteresis), i + 0.5 * m.hysteresis)

            def rates(t, x, held, flowing=flowing):
                b = flowing(t)[1]
                push = m.positive * max(0.0, b - m.overlap) - m.negative * max(0.0, -b - m.overlap)
                level = f.coulomb + f.static * math.exp(-((x[1] / f.stribeck_velocity) ** 2))
                rate = x[1] - (f.stiffness * abs(x[1]) / level * x[2] if level > 0.0 else 0.0)
                rub = f.stiffness * x[2] + f.damping * rate if level > 0.0 else 0.0
                force = strength * (push + s.offset - s.flow_force * x[0] - rub) - stiffness * x[0]
                force -= 2.0 * s.damping * s.natural_frequency * x[1]
                return [0.0 if held else x[1], 0.0 if held else force, rate, force]

            x = moved((s.low, s.high), rates, x, 0.0, length)
            current, play = flowing(length)
        rows.append(x[0])
    return np.array(rows)


def moved(stops, rates, x, begin, end):
    """State at ``end`` [s]; the spool that meets a stop rests there until the force turns."""
    while end - begin > 1e-15:
        at = next((stop for stop in stops if abs(x[0] - stop) < 5e-9), None)
        held = at is not None and rates(begin, x, False)[3] * at >= 0.0
        if held:
            events = [lambda t, x, at=at: rates(t, x, True)[3] * at]
        else:
            events = [lambda t, x: x[0] - stops[1], lambda t, x: stops[0] - x[0]]
        for event in events:
            event.terminal, event.direction = True, -1.0 if held else 1.0
        found = solve_ivp(
            lambda t, x, held=held: rates(t, x, held)[:3], (begin, end), x, "Radau", events=events,
            rtol=1e-8, atol=[5e-9, 5e-6, 5e-10],
        )  # fmt: skip
        assert found.success
        x, begin = found.y[:, -1], max(found.t[-1], begin + 1e-12)
        if found.status == 1 and not held:
            x = np.array([min(max(x[0], stops[0]), stops[1]), 0.0, x[2]])
    return x


@pytest.mark.parametrize(
    ("number", "motion", "more"),
    [
        (0, 0, {}),
        (1, 1, {"friction__coulomb": 0.0, "hysteresis": 0.5, "overlap": 0.3}),
        (2, 2, {"friction__coulomb": 1.0, "friction__presliding": 0.01, "bristle_damping": 0.001}),
        (3, 3, {"stop_low": -4.0, "stop_high": 5.0, "u_min": -7.0}),
        (4, 1, {"overlap": -0.4, "dead_time": 0.0006}),
    ],
)
def test_stiff_integration_with_located_stops_agrees(number, motion, more):
    p = made(**{**drawn(np.random.default_rng(number)), **more})
    given = MOTIONS[motion][:150]
    found, exact = run(p, given)[:, 0], integrated(p, given)
    assert np.max(np.abs(found - exact)) < 0.005 * np.ptp(exact)
    finer = run(made(4, **{**drawn(np.random.default_rng(number)), **more}), given)[:, 0]
    assert np.max(np.abs(finer - exact)) < 0.3 * np.max(np.abs(found - exact)) + 2e-5


# Closed forms


def triangle(amplitude, samples):
    quarter = np.linspace(0.0, amplitude, samples, endpoint=False)
    one = np.concatenate([quarter, amplitude - quarter, -quarter, quarter - amplitude])
    return np.concatenate([one, one])


def test_the_slow_loop_has_the_width_and_the_area_of_a_parallelogram(width=1.0):
    p = made(hysteresis=width, gain=0.8, natural_frequency=60.0, coil=0.0005, damping=1.0)
    u = triangle(4.0, 4000)
    x = run(p, u)[1:, 0]
    up, down = x[16000 + 500], x[16000 + 8000 - 500]  # both at 0.5 V
    rate, lag = 4.0 / (4000 * PERIOD), 0.0005 + 2.0 / (2.0 * np.pi * 60.0) - PERIOD
    full = 0.8 * (width + 2.0 * rate * lag)
    assert down - up == pytest.approx(full, rel=0.01)
    u, x = u[-16000:], x[-16000:]
    area = abs(np.sum(0.5 * (x + np.roll(x, 1)) * (u - np.roll(u, 1))))
    assert area == pytest.approx(full * (8.0 - width), rel=0.01)


@pytest.mark.parametrize("velocity", [0.001, 0.05, 2000.0, -0.05])
def test_steady_sliding_rubs_at_stribeck_s_level(velocity):
    f = made(
        friction__coulomb=0.6, friction__static_ratio=1.5, friction__stribeck_velocity=0.05,
        friction__presliding=0.01, bristle_damping=0.001,
    ).friction  # fmt: skip
    level = 0.6 * (1.0 + 0.5 * math.exp(-((velocity / 0.05) ** 2)))
    motion, h = solenoid.SubstepMean(velocity, 0.0, 0.0), 1e-4 / min(1.0, abs(velocity))
    for _ in range(4000):
        # Without mobility friction cannot change the velocity.
        motion = solenoid.rub(f, h, 0.0, motion.bristle, velocity, velocity)
    assert motion.velocity == pytest.approx(velocity, rel=1e-12)
    assert motion.friction == pytest.approx(math.copysign(level, velocity), rel=1e-6)


@pytest.mark.parametrize("frequency", [2.0, 15.0, 40.0])
def test_small_motions_without_friction_have_the_model_s_response(frequency):
    chosen = dict(gain=0.9, coil=0.004, eddy=0.001, natural_frequency=15.0, flow_force=0.2, pressure=70.0,
                  dead_time=0.0004, lvdt__delay=0.0011)  # fmt: skip
    p = made(**chosen)
    t = np.arange(round(40.0 / frequency / PERIOD)) * PERIOD
    x = run(p, np.sin(2.0 * np.pi * frequency * t))[:-1, 0]
    steady = t > 20.0 / frequency
    z = np.exp(-2j * np.pi * frequency * t[steady])
    found = np.linalg.lstsq(
        np.stack([z.real, -z.imag, np.ones(len(z))], axis=1), x[steady], rcond=None
    )[0]  # fmt: skip
    s = 2j * np.pi * frequency
    omega = 2.0 * np.pi * 15.0
    stiff = 1.0 + 0.9 * 0.2 * 2.0
    exact = 0.9 * omega**2 / (s**2 + 2.0 * 0.8 * omega * s + stiff * omega**2)
    exact *= np.exp(-0.0004 * s) / ((0.004 * s + 1.0) * (0.001 * s + 1.0))
    hold = (1.0 - np.exp(-s * PERIOD)) / (s * PERIOD)
    assert found[1] + 1j * found[0] == pytest.approx(exact * hold, abs=0.004 * abs(exact))
    like = solenoid_valve.linear(p)
    assert like.lvdt.delay == pytest.approx(1.5)
    linear, voltages = valve.initial(like), np.sin(2.0 * np.pi * frequency * t[:200])
    in_time = run(made(**{**chosen, "dead_time": 0.0}), voltages)[:, 0]
    for position, voltage in zip(in_time, voltages, strict=False):
        assert linear.x.x0 == pytest.approx(position, abs=2e-3)
        linear = valve.step(like, linear, float(voltage))


@pytest.mark.parametrize(("side", "overlap"), [(0.5, 0.0), (0.9, -9.0)])
def test_friction_and_offset_of_the_linear_valve_are_voltages_at_its_input_whatever_the_sides_gain(
    side, overlap
):
    p = made(coil=1e-4, positive=side, negative=side, overlap=overlap, friction__coulomb=0.5,
             friction__presliding=0.01, disturbance__offset=0.2)  # fmt: skip
    u = 1.5 * np.sin(2.0 * np.pi * 0.25 * np.arange(4000) * PERIOD)
    like = solenoid_valve.linear(p)
    linear, positions = valve.initial(like), [0.0]
    for voltage in u:
        linear = valve.step(like, linear, float(voltage))
        positions.append(linear.x.x0)
    assert np.max(np.abs(run(p, u)[:, 0] - positions)) < 0.01 * np.ptp(positions)


# LVDT


def test_the_converter_has_its_steps_and_its_range():
    p = made(bits=12, stop_high=20.0)
    step = 20.0 / 4096.0
    at = solenoid.initial(p)
    for position in (0.001, 3.3333, -9.9999, 11.0, -11.0):
        shown = solenoid.read(p, at._replace(x=valve.Row(position, 0.0, 0.0, 0.0)), 0.0)
        assert shown / step == round(shown / step) and -10.0 <= shown <= 10.0 - step
        assert abs(shown - min(10.0 - step, max(-10.0, position))) <= 0.5 * step + 1e-12


# Properties


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.lists(st.floats(-50.0, 50.0), min_size=1, max_size=60))
def test_any_valve_stays_within_its_stops_and_its_bristles_below_their_level(seed, voltages):
    p = made(**drawn(np.random.default_rng(seed)))
    rows = run(p, np.repeat(voltages, 5))
    assert np.all(np.isfinite(rows)) and np.all(np.abs(rows[:, 0]) <= 10.5)
    f = p.friction
    assert np.all(f.stiffness * np.abs(rows[:, 5]) <= (f.coulomb + f.static) * (1.0 + 1e-9))


# The valves of config/solenoid


FOLDER = Path(__file__).resolve().parents[2] / "config" / "solenoid"
TIMES = {"d634": 0.020, "d633": 0.012, "d661": 0.0065}  # s  0 to 90 % of a step of 10 V
FREQUENCIES = {"d3fxe": 6.48, "d136": 60.0, "voice_coil": 250.0}  # Hz  of -90°


def shipped(name, **changes):
    given = files.load(str(FOLDER / f"{name}.yaml"))["valve_simulator"]
    return solenoid_valve.build(updated(VALVE, defaults(VALVE), {**given, **changes}))


def test_there_are_six_and_each_has_a_figure():
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {*TIMES, *FREQUENCIES}


@pytest.mark.parametrize("name", TIMES)
def test_a_step_takes_the_time_of_the_source(name):
    p = shipped(name, sample_period=0.0001)
    x = run(p, np.full(1500, 10.0))[:-1, 0]
    assert np.argmax(x >= 0.9 * x[-1]) * 0.0001 == pytest.approx(TIMES[name], rel=0.03)


@pytest.mark.parametrize("name", FREQUENCIES)
def test_the_phase_is_a_quarter_turn_at_the_frequency_of_the_source(name):
    """Small motions; the model of the paper, source of d3fxe, has neither friction nor flow force."""
    without = {"friction.coulomb": 0.0, "flow_force": 0.0, "solenoid.hysteresis": 0.0}
    p = shipped(name, sample_period=0.0001, **(without if name == "d3fxe" else {}))
    frequency = FREQUENCIES[name]
    t = np.arange(round(20.0 / frequency / 0.0001)) * 0.0001
    turn = np.exp(-2j * np.pi * frequency * t)
    x = run(p, np.sin(2.0 * np.pi * frequency * t))[:-1, 0]
    steady = t > 10.0 / frequency
    phase = np.angle(2j * np.mean(x[steady] * turn[steady]))
    assert math.degrees(phase) == pytest.approx(-90.0, abs=4.0)
