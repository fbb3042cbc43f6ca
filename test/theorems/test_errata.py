# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's equations derived again with SymPy: each test is one entry of docs/reference/errata.md.

Others stand beside the laws in test/laws: (8)-(11) in test_reshaping.py, (12) and (13) over frequency in
test_compensator.py, (35) and (45) in test_oarc.py, (54) and (55) in test_pid.py.
"""

import math

import numpy as np
import pytest
import scipy.linalg
import sympy as sp

from research.theorems import bench
from valve_control.control.laws import compensator_design, oarc, pid, projection, reshaping, velocity
from valve_control.control.laws.projection import Theta
from valve_control.control.laws.signals import Start
from valve_control.control.linear import linear_loop
from valve_control.control.parameters.table import CONTROLLER
from valve_control.control.plant.transfer_functions import FOURTH_ORDER, SECOND_ORDER
from valve_control.parameter import defaults, updated

TH = sp.symbols("theta1:5")
TE = sp.symbols("thetahat1:5")
ERROR = [e - t for e, t in zip(TE, TH, strict=True)]  # θ̃ = θ̂ - θ
TH3MIN, K1, K2, KS1, KS2, RHO = sp.symbols("theta3min k1 k2 ks1 ks2 rho", positive=True)
Z1, Z2, D, X1, X2 = sp.symbols("z1 z2 d x1 x2")


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def is_zero(expression):
    return sp.simplify(sp.expand(expression)) == 0


def test_4_has_theta2():
    """(1) with θ = [a1, a0, b0, b0·dn] is (4) with θ2·x, as (17) has it too."""
    v, a, u, dn, total, a1, a0, b0 = sp.symbols("v a u dn total a1 a0 b0")
    one = a + a1 * v + a0 * X1 - b0 * (u + total)
    named = dict(zip(TH, (a1, a0, b0, b0 * dn), strict=True))
    four = a + TH[0] * v + TH[1] * X1 - TH[2] * u - TH[3] - D
    assert is_zero(one - four.subs(named).subs(D, b0 * total - b0 * dn))


def test_10_brings_the_rate_to_its_limit():
    """Where (9) would exceed the limit of the rate: just to it, with less acceleration than step 2 left."""
    rng = np.random.default_rng(4)
    p = reshaping.Params(314.0, 0.8, 250.0, 12000.0, 1e-3)
    brought = set()
    for _ in range(300):
        s = reshaping.State(*rng.uniform([-10.0, -p.max_rate], [10.0, p.max_rate]))
        command = rng.uniform(-10.0, 10.0)
        wn = p.natural_frequency
        eight = -2.0 * p.damping * wn * s.rate - wn * wn * (s.reference - command)
        step_2 = min(max(eight, -p.max_accel), p.max_accel)
        accel = reshaping.acceleration(p, s, command)
        if abs(s.rate + step_2 * p.period) <= p.max_rate:
            assert accel == pytest.approx(step_2)
            continue
        limit = math.copysign(p.max_rate, step_2)
        assert reshaping.advance(p, s, accel).rate == pytest.approx(limit, rel=1e-12)
        assert 0.0 <= accel / step_2 < 1.0
        brought.add(limit)
    assert brought == {-p.max_rate, p.max_rate}


def test_6_and_7_forget_the_spring():
    """On (2) the voltage left for motion at x = 5 V is 4.5 V, not 10 V; with 10 V nothing reaches (7)."""
    (b0,), (_, a1, a0) = SECOND_ORDER.numerator, SECOND_ORDER.denominator
    u_max = 10.0
    limits = reshaping.Params(314.0, 0.8, b0 * u_max / a1, b0 * u_max, 1e-4)  # (7), (6)
    assert limits.max_rate == pytest.approx(255.6, abs=0.1)
    base = pid.build(updated(CONTROLLER, defaults(CONTROLLER), {"pid.form": "reference"}))
    p = base._replace(a1=a1, a0=a0, b0=b0, u_max=u_max, reshaping=limits)
    rest = pid.initial(p, Start(5.0, 0.0, 5.0, 0.0, 0.0))._replace(integral=0.0)
    _, _, holding = pid.step(p, rest, 5.0, 5.0, 0.0)
    _, _, moving = pid.step(p, rest, 10.0, 5.0, 0.0)
    assert moving.reference_accel == limits.max_accel
    assert u_max - holding.unsaturated_voltage == pytest.approx(4.48, abs=0.01)
    assert moving.unsaturated_voltage == pytest.approx(15.52, abs=0.01)

    valve = bench.plant(Theta(a1, a0, b0, 0.0), limits.period)
    x1, x2 = 5.0, 0.0
    x1, x2 = (
        valve.m11 * x1 + valve.m12 * x2 + valve.g1 * b0 * u_max,
        valve.m21 * x1 + valve.m22 * x2 + valve.g2 * b0 * u_max,
    )
    assert x2 / limits.period == pytest.approx(4.48 * b0, rel=0.01)
    x1 = x2 = fastest = 0.0
    for _ in range(3000):
        x1, x2 = (
            valve.m11 * x1 + valve.m12 * x2 + valve.g1 * b0 * u_max,
            valve.m21 * x1 + valve.m22 * x2 + valve.g2 * b0 * u_max,
        )
        fastest = max(fastest, x2)
    assert 0.0 < fastest < 0.7 * limits.max_rate
    printed = oarc.build(defaults(CONTROLLER)).theta_initial
    assert printed.b0 * u_max / printed.a1 == pytest.approx(600.0)


def test_12_is_not_made_for_2():
    c = compensator_design.PRINTED_SECOND_ORDER
    assert np.allclose(np.array(c.numerator) / c.numerator[0], [1.0, 54.05, 1561.22])
    assert c.static_gain * 1455.97 / 1561.22 == pytest.approx(1.0, abs=1e-12)  # of the model it was made for
    assert c.static_gain * SECOND_ORDER.static_gain == pytest.approx(0.9719, abs=1e-4)
    poles = np.roots(c.denominator)
    assert np.sort(np.abs(poles)) / (2.0 * math.pi) == pytest.approx([24.99, 24.99, 39.82], abs=0.01)


def test_13_cancels_the_poles_of_3_but_not_its_gain():
    c = compensator_design.PRINTED_FOURTH_ORDER
    printed = np.array(c.numerator) / 2880.0
    assert np.array_equal(printed[:4], FOURTH_ORDER.denominator[:4])
    assert printed[4] - FOURTH_ORDER.denominator[4] == pytest.approx(2.0)
    assert c.static_gain * FOURTH_ORDER.static_gain == pytest.approx(0.8889, abs=1e-4)
    assert c.static_gain * 1455.97 / 1561.22 == pytest.approx(1.0, abs=1e-4)  # the gain of (12)'s model
    poles = np.abs(np.roots(c.denominator)) / (2.0 * math.pi)
    assert np.sort(poles) == pytest.approx([24.17, 24.17, 25.63, 25.63, 40.41], abs=0.01)
    zeros = np.roots(FOURTH_ORDER.numerator)
    assert np.abs(zeros) / (2.0 * math.pi) == pytest.approx([31.38, 31.38], abs=0.01)


def test_p2_of_16_holds_with_equality():
    """Nothing projected: Γ⁻¹·Proj(Γτ) - τ = 0, so that "<" is "≤"; otherwise it is never positive."""
    rng = np.random.default_rng(2)
    lower, upper = Theta(5.0, 500.0, 900.0, -6000.0), Theta(150.0, 3000.0, 2500.0, 6000.0)
    gamma = Theta(2.0, 110.0, 120.0, 500.0)
    equal = 0
    for _ in range(500):
        inside = rng.uniform(lower, upper)
        edge = rng.integers(0, 3, 4)
        estimate = Theta(*np.where(edge == 0, lower, np.where(edge == 1, upper, inside)))
        tau, truth = rng.normal(size=4), rng.uniform(lower, upper)
        rates = projection.rates(estimate, gamma, Theta(*tau), lower, upper)
        value = (np.array(estimate) - truth) @ (np.array(rates) / np.array(gamma) - tau)
        assert value <= 1e-9
        equal += abs(value) < 1e-9
    assert equal > 10


def arc_terms():
    xd, xd1, xd2, us2 = sp.symbols("xd xd1 xd2 us2")
    z1 = X1 - xd
    z2 = X2 - (xd1 - K1 * z1)  # (18)
    x2eq_dot = xd2 - K1 * (X2 - xd1)  # (19)
    u_a = (TE[0] * X2 + TE[1] * X1 - TE[3] + x2eq_dot - z1) / TE[2]  # (20)
    u = u_a - K2 / TH3MIN * z2 + us2
    z2_dot = -TH[0] * X2 - TH[1] * X1 + TH[2] * u + TH[3] + D - x2eq_dot  # (19)
    phi2 = [-X2, -X1, u_a, 1]  # (21)
    return z1, z2, z2_dot, phi2, us2, X2 - xd1


def test_22_and_24_are_right():
    z1, z2, z2_dot, phi2, us2, z1_dot = arc_terms()
    assert is_zero(z1_dot - (z2 - K1 * z1))  # (18): G = 1/(s + k1)
    expected = -z1 - TH[2] / TH3MIN * K2 * z2 + TH[2] * us2 - dot(ERROR, phi2) + D
    assert is_zero(z2_dot - expected)  # (22)
    v2_dot = z1 * z1_dot + z2 * z2_dot
    expected = -K1 * z1**2 - TH[2] / TH3MIN * K2 * z2**2 + z2 * (TH[2] * us2 - dot(ERROR, phi2) + D)
    assert is_zero(v2_dot - expected)  # (24)


def test_25_follows_from_23():
    """-k1·z1² - (θ3/θ3min)·k2·z2² <= -λ·V2 with λ = 2·min(k1, k2): the rest is a sum of squares."""
    gap, more = sp.symbols("gap more", nonnegative=True)  # k2 = k1 + gap, θ3 = θ3min·(1 + more)
    decay = K1 * Z1**2 + (1 + more) * (K1 + gap) * Z2**2
    rest = sp.expand(decay - 2 * K1 * (Z1**2 + Z2**2) / 2)
    assert is_zero(rest - Z2**2 * (gap + more * (K1 + gap)))
    assert rest.subs(Z2, sp.symbols("r", real=True)).is_nonnegative


def test_52_keeps_its_rate_with_a_weight():
    """The same for -(θ3/θ3min)·ks1·z1² - ρ·ks2·z2², whichever of ks1 and ks2 is smaller."""
    gap, more = sp.symbols("gap more", nonnegative=True)
    z1, z2 = sp.symbols("z1 z2", real=True)
    v2 = (z1**2 + RHO * z2**2) / 2
    for ks1, ks2 in ((KS1, KS1 + gap), (KS2 + gap, KS2)):
        smaller = ks1 if ks1 == KS1 else ks2
        rest = (1 + more) * ks1 * z1**2 + RHO * ks2 * z2**2 - 2 * smaller * v2
        assert sp.expand(rest).is_nonnegative


def test_quadratic_robust_term_meets_23():
    """z2·(θ3·u_s2 + h) <= ε for u_s2 = -h²·z2/(4·ε·θ3min): what is missing to ε is a square and more."""
    h, eps = sp.symbols("h epsilon", positive=True)
    more = sp.symbols("more", nonnegative=True)
    u_s2 = -(h**2) * Z2 / (4 * eps * TH3MIN)
    missing = eps - Z2 * (TH3MIN * (1 + more) * u_s2 + h)
    assert is_zero(
        missing - ((sp.sqrt(eps) - h * Z2 / (2 * sp.sqrt(eps))) ** 2 + more * h**2 * Z2**2 / (4 * eps))
    )


def test_27_to_31_are_right():
    """The observer (29), (30) with the true θ on the plant (26): error dynamics A0·ε + e2·d̃."""
    u = sp.symbols("u")
    x = sp.Matrix([X1, X2])
    a0 = sp.Matrix([[-K1, 1], [-K2, 0]])
    e1, e2 = sp.Matrix([1, 0]), sp.Matrix([0, 1])
    plant = sp.Matrix([X2 - TH[0] * X1, -TH[1] * X1 + TH[2] * u + TH[3] + D])  # (26)
    a, k = sp.Matrix(TH[:2]), sp.Matrix([K1, K2])
    assert sp.simplify(plant - (a0 * x + (k - a) * X1 + e2 * (TH[2] * u + TH[3] + D))) == sp.zeros(
        2, 1
    )  # (27)
    xi2, xi1, xi0, v0, psi = (sp.Matrix(sp.symbols(f"{n}_1:3")) for n in ("xi2", "xi1", "xi0", "v0", "psi"))
    drives = (
        (xi2, k * X1, 1),
        (xi1, e1 * X1, -TH[0]),
        (xi0, e2 * X1, -TH[1]),
        (v0, e2 * u, TH[2]),
        (psi, e2, TH[3]),
    )
    estimate = sum((weight * state for state, _, weight in drives), sp.zeros(2, 1))  # (30)
    estimate_dot = sum((weight * (a0 * s + drive) for s, drive, weight in drives), sp.zeros(2, 1))  # (29)
    assert sp.simplify(plant - estimate_dot - (a0 * (x - estimate) + e2 * D)) == sp.zeros(2, 1)  # (31)


def oarc_terms():
    xi22, xi12, xi02, v02, psi, xd1, eps, epsu, s2, s3 = sp.symbols(
        "xi22 xi12 xi02 v02 psi xd1 eps epsu alpha_s2 alpha_s3"
    )
    regressor = [-(xi12 + X1), -xi02, v02, psi]
    alpha_a = (-xi22 - TE[0] * regressor[0] - TE[1] * regressor[1] - TE[3] * psi + xd1) / TE[2]  # (39)
    alpha = alpha_a - KS1 / TH3MIN * Z1 + s2 + s3
    z1_dot = xi22 + dot(TH, regressor) + eps + epsu - xd1  # (38)
    phi1 = [regressor[0], regressor[1], alpha_a, psi]
    without_z2 = -TH[2] / TH3MIN * KS1 * Z1 + TH[2] * (s2 + s3) - dot(ERROR, phi1) + eps + epsu
    return z1_dot.subs(v02, alpha + Z2), without_z2, regressor, xi22, v02, psi, eps, epsu


def test_40_lacks_theta3_z2_and_has_ks1():
    """(41) has both: its θ3·z1·z2 comes from the θ3·z2 that (40) leaves out."""
    z1_dot, without_z2, *_ = oarc_terms()
    assert is_zero(z1_dot - (without_z2 + TH[2] * Z2))
    assert not is_zero(z1_dot - without_z2)


@pytest.mark.parametrize("weight", [1, RHO])
def test_49_lacks_ks2_z2_squared_and_the_slope_in_phi2(weight):
    """dV2/dt of z1²/2 + ρ·z2²/2 by (38), (44), (46), (48), for any α1 of slope ∂α1/∂x1; also (50)'s minus."""
    _, without_z2, regressor, xi22, v02, psi, eps, epsu = oarc_terms()
    slope, rest, v01, us2, us3 = sp.symbols("slope rest v01 us2 us3")
    alpha_c = slope * (xi22 + dot(TE, regressor)) + rest  # (45)
    alpha_u = slope * (-dot(ERROR, regressor) + eps + epsu)
    true_rate = slope * (xi22 + dot(TH, regressor) + eps + epsu) + rest  # (44)
    assert is_zero(true_rate - alpha_c - alpha_u)
    u = K2 * v01 - TE[2] * Z1 / weight + alpha_c - KS2 * Z2 + us2 + us3  # (48)
    z2_dot = u - K2 * v01 - true_rate  # (46)
    v2_dot = Z1 * (without_z2 + TH[2] * Z2) + weight * Z2 * z2_dot

    def form(phi2, damping):
        return (
            Z1 * without_z2
            - damping * weight * KS2 * Z2**2
            + weight * Z2 * (us2 - dot(ERROR, phi2) - slope * epsu)
            + weight * Z2 * (us3 - slope * eps)
        )

    xi12_x1, xi02 = -regressor[0], -regressor[1]
    right = [slope * xi12_x1, slope * xi02, Z1 / weight - slope * v02, -slope * psi]
    printed = [slope * xi12_x1, slope * xi02, Z1 / weight - v02, -psi]
    assert is_zero(v2_dot - form(right, 1))
    assert not is_zero(v2_dot - form(right, 0))
    assert not is_zero(v2_dot - form(printed, 1))


def poles(law, p, truth, moving):
    """Poles [1/s] of the law's own step at a short ΔT, with the true velocity, on the valve ``truth``.

    The step is linear in the entries ``moving`` of its state, so that differences of single steps are exact.
    """
    valve = bench.plant(truth, p.period)
    rest = law.initial(p, Start(0.0, 0.0, 0.0, 0.0, 0.0))

    def advance(numbers):
        x1, x2, *state = numbers.tolist()
        s = linear_loop.unflatten(rest, state)
        if "velocity" in s._fields:
            s = s._replace(velocity=velocity.State(x1, x2))
        voltage, after, _ = law.step(p, s, 0.0, x1, 0.0)
        force = truth.b0 * voltage
        x1, x2 = (
            valve.m11 * x1 + valve.m12 * x2 + valve.g1 * force,
            valve.m21 * x1 + valve.m22 * x2 + valve.g2 * force,
        )
        return np.array([x1, x2, *linear_loop.flatten(after)])

    names = ["x1", "x2", *(n for n, field in rest._asdict().items() for _ in linear_loop.flatten(field))]
    entries = [i for i, name in enumerate(names) if name in ("x1", "x2", *moving)]
    start = np.array([0.0, 0.0, *linear_loop.flatten(rest)])
    columns = [advance(start + np.eye(len(start))[i]) - advance(start) for i in entries]
    return np.log(np.linalg.eigvals(np.array(columns).T[entries].astype(complex))) / p.period


def oarc_poles(weight, theta3_min):
    """Poles [1/s] of OARC with the paper's gains and the true θ, frozen; those of the K-filters too."""
    p = oarc.build(updated(CONTROLLER, defaults(CONTROLLER), {"oarc.z2_weight": weight}))
    period = 1e-7
    k1, k2 = p.k1, p.k2
    a0 = scipy.linalg.expm(np.array([[-k1, 1.0, 0.0], [-k2, 0.0, 1.0], [0.0, 0.0, 0.0]]) * period)
    p = p._replace(
        period=period,
        u_max=1e12,
        gamma=Theta(0.0, 0.0, 0.0, 0.0),
        theta_min=p.theta_min._replace(b0=theta3_min),
        filter=oarc.Filter(*a0[0, :2], *a0[1, :2], *a0[:2, 2]),
    )
    return poles(oarc, p, p.theta_initial, ("eta", "v0"))


@pytest.mark.parametrize(
    ("theta3_min", "frequency", "damping"), [(1200.0, 191.9, 0.0995), (900.0, 192.3, 0.1159)]
)
def test_the_literal_weight_is_a_191_hz_loop(theta3_min, frequency, damping):
    """ρ = 1, θ3 = 1200: the poles of ż1 = θ3·z2 - (θ3/θ3min)·ks1·z1, ż2 = -θ3·z1 - ks2·z2."""
    fastest = max(oarc_poles(1.0, theta3_min), key=abs)
    assert abs(fastest) / (2.0 * math.pi) == pytest.approx(frequency, abs=0.1)
    assert -fastest.real / abs(fastest) == pytest.approx(damping, abs=1e-3)


def test_the_default_weight_leaves_the_decay_of_both_errors():
    """ρ = θ3²: z1 and z2 decay with (θ3/θ3min)·ks1 and ks2; the other poles are the K-filters'."""
    got = oarc_poles(1.44e6, 900.0)
    slow = np.sort(got[np.abs(got.imag) < 10.0].real)
    assert slow == pytest.approx([-160.0, -120.0], abs=0.1)
    others = got[np.abs(got.imag) > 10.0]
    assert np.abs(others) == pytest.approx([220.0] * 4, rel=1e-3)


def test_no_break_frequency_gives_the_printed_gains():
    kp, ki, kd = pid.place_poles(7.0, 20.0, 1200.0, 1200.0)
    assert (kp, ki, kd) == pytest.approx((3.83611, 70.90102, 0.093289), rel=1e-5)
    assert round(kp, 3) == 3.836
    _, ki_for_kp, _ = pid.place_poles(
        math.sqrt((3.837 * 1200.0 + 1200.0) / 3.0) / (2.0 * math.pi), 20.0, 1200.0, 1200.0
    )
    assert round(ki_for_kp, 3) != 70.901


def pid_poles(form, kp, ki, kd):
    """Poles [1/s] of (56) with these gains on the valve of its own model terms."""
    p = pid.build(updated(CONTROLLER, defaults(CONTROLLER), {"pid.form": form}))
    p = p._replace(kp=kp, ki=ki, kd=kd, period=1e-6, u_max=1e12, velocity=bench.KEEPS_VELOCITY)
    return poles(pid, p, Theta(p.a1, p.a0, p.b0, 0.0), ("integral",))


def test_poles_of_54_with_the_printed_gains_are_not_at_7_hz():
    got = np.sort(np.abs(pid_poles("paper", 3.837, 70.901, 0.093))) / (2.0 * math.pi)
    assert got == pytest.approx([6.15, 6.15, 9.07], abs=0.01)


def test_poles_of_55_are_at_7_hz_with_model_terms_of_the_reference():
    gains = pid.place_poles(7.0, 20.0, 1200.0, 1200.0)
    w = 2.0 * math.pi * 7.0
    expected = [1.0, 3.0 * w, 3.0 * w**2, w**3]
    assert np.poly(pid_poles("reference", *gains)) == pytest.approx(expected, rel=1e-3)
    assert np.max(np.abs(pid_poles("paper", *gains))) / (2.0 * math.pi) > 9.0
