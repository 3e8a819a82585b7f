"""The linear part of preview_inverse, and its filter of the measured motion."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from seft_msgs_py.errors import InputError
from seft_msgs_py.parameters import resolve
from seft_msgs_py.timebase import Timebase
from seft_ros.reference_force.block import knowledge
from seft_ros.reference_force.compensation.linear_filter import LinearCompensator
from seft_ros.reference_force.compensation.methods import METHODS
from seft_ros.reference_force.compensation.preview.motion_filter import motion_filter
from seft_ros.reference_force.compensation.preview.preview_filter import (
    CORNER,
    LONGEST_HORIZON,
    PreviewFilter,
)
from seft_ros.reference_force.compensation.preview.preview_tracking import PreviewTracking
from seft_ros.reference_force.compensation.preview.tracking_model import TrackingModel
from seft_ros.reference_force.parameters import TABLE

DT = 0.002
KNOWN = {
    "mass_ratio": 1.4,
    "model.mass": [52.7, 3.0, 3.0, 60.0],
    "model.damping": [800.3, -90.0, -90.0, 700.0],
    "model.stiffness": [2.11e5, -3e4, -3e4, 1.9e5],
    "compensation.method": "preview_inverse",
    "compensation.noise.position": 5e-6,
    "compensation.noise.velocity": 1e-3,
    "compensation.noise.acceleration": 0.05,
    "compensation.noise.force": 3.0,
    "tracking.numerator": [0.99],
    "tracking.denominator": [1e-4, 0.012, 1.0],
    "tracking.dead_time": 0.0047,
}
FELT = {
    "tracking.stiffness": [2.3e5, -2e4, -2e4, 2.2e5],
    "tracking.damping": [900.0, -50.0, -50.0, 800.0],
}


def told(axes=("x", "y"), **values):
    given_values = KNOWN | {name.replace("__", "."): value for name, value in values.items()}
    section = resolve({"reference_force": TABLE}, {"reference_force": TABLE.check(given_values)})[
        "reference_force"
    ]
    return knowledge(section, axes, Timebase.from_rate(1 / DT))


def shaking(axes, steps, preview, seed=1):
    rng = np.random.default_rng(seed)
    scale = np.array([[1e-3], [0.1], [5.0], [300.0]])
    motion = rng.normal(0, 3, (steps + preview, axes))
    return motion, rng.normal(0, 1, (steps, 4, axes)) * scale


def run(one, motion, states):
    one.reset()
    window = 1 + one.preview
    return np.array([one.step(motion[k : k + window], y) for k, y in enumerate(states)])


def written_out(known, motion, states, horizon, corner=30.0):
    """Fixed method from its equations, one sample after the other."""
    n, options = known.axes, known.options
    model = TrackingModel.from_options(options, DT)
    tracking = PreviewTracking.design(model, horizon, CORNER * DT)
    observe = motion_filter(DT, 5e-6, 1e-3, 0.05)
    felt = bool(np.any(options["tracking.stiffness"]))
    nominal = [
        np.reshape(options[f"tracking.{name}"], (n, n)) if felt else np.zeros((n, n))
        for name in ("stiffness", "damping")
    ]
    total, share = known.total_mass, known.computed_mass @ np.linalg.inv(known.total_mass)
    system = np.zeros((5 * n, 5 * n))  # x, v, a_g, rate of a_g, p
    system[:n, n : 2 * n] = np.eye(n)
    system[n : 2 * n] = np.hstack(
        [-np.linalg.solve(total, known.stiffness), -np.linalg.solve(total, known.damping),
         -np.eye(n), np.zeros((n, n)), -np.linalg.inv(total)]
    )  # fmt: skip
    system[2 * n : 3 * n, 3 * n : 4 * n] = np.eye(n)
    ahead = expm(system * DT)
    variance = 9.0 + (np.diag(known.mass) * 0.05) ** 2
    kinematic, p, z = np.zeros((3, n)), np.zeros(n), np.zeros((len(model.a), n))
    past, forces = np.zeros((len(tracking.past), n)), []
    for k, (x, v, a, f) in enumerate(states):
        kinematic[:2] = observe @ np.vstack([kinematic, x, v, a])
        kinematic[2] = a
        x, v = kinematic[:2]
        residual = f - known.mass @ a - known.stiffness @ x - known.damping @ v
        p = p + (1 - np.exp(-2 * np.pi * corner * DT)) * (residual - p)
        u = tracking.state @ z + tracking.past @ past
        path = np.concatenate([x, v])
        for j in range(horizon + 1):
            a_g = motion[k + j]
            x_j, v_j = path.reshape(2, n)
            r = known.stiffness @ x_j + known.damping @ v_j + p
            target = share @ r - known.mass @ a_g
            if felt:
                target = target + nominal[0] @ x_j + nominal[1] @ v_j - r
            u = u + tracking.target[j] * target
            if j < horizon:
                rate = (motion[k + j + 1] - a_g) / DT
                path = (ahead @ np.concatenate([path, a_g, rate, p]))[: 2 * n]
        d = nominal[0] @ x + nominal[1] @ v - residual - known.stiffness @ x - known.damping @ v
        d = (d + residual - p) if felt else np.zeros(n)
        forces.append(u - d + 0.8 * 9.0 / variance * (residual - p))
        z = model.a @ z + np.outer(model.b, u)
        past = np.vstack([u, past[:-1]])
    return np.array(forces)


@pytest.mark.parametrize("nominal", [{}, FELT])
def test_the_fixed_method_is_its_equations(nominal):
    known = told(compensation__adaptive=False, **nominal)
    fixed = METHODS["preview_inverse"](known)
    assert isinstance(fixed, LinearCompensator)
    motion, states = shaking(2, 60, fixed.preview)
    forces = run(fixed, motion, states)
    exact = written_out(known, motion, states, fixed.preview)
    np.testing.assert_allclose(forces, exact, atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("nominal", [{}, FELT])
def test_its_steps_are_the_linear_filter_that_it_says_it_is(nominal):
    one = PreviewFilter(told(**nominal), 0.3)
    gain, advance = np.array([0.97, 1.02]), np.array([4e-4, -7e-4])
    motion, states = shaking(2, 200, one.preview)
    expected = run(LinearCompensator(one.linear(gain, advance)), motion, states)
    found = []
    for k, state in enumerate(states):
        one.observe(state)
        one.take_residual()
        one.split()
        target, rate = one.target(motion[k : k + 1 + one.preview])
        found.append(one.command(gain * target - advance * rate, one.departure()))
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_a_filter_is_asked_for_without_disturbing_the_test():
    one = PreviewFilter(told(**FELT), 0.3)
    motion, states = shaking(2, 20, one.preview)
    forces = []
    for asking in (False, True):
        one.reset()
        for k, state in enumerate(states):
            if asking:
                one.linear(np.ones(2), np.zeros(2))
            one.observe(state)
            one.take_residual()
            one.split()
            target, _ = one.target(motion[k : k + 1 + one.preview])
            forces.append(one.command(target, one.departure()))
    np.testing.assert_array_equal(forces[:20], forces[20:])


def test_what_the_rest_will_be_counts_only_where_it_differs_from_now():
    one = PreviewFilter(told(**FELT), 0.3)
    motion, states = shaking(2, 1, one.preview)
    one.observe(states[0])
    one.take_residual()
    one.split()
    kept = one.target(motion)
    same = one.target(motion, np.tile(one.rest, 1 + one.preview))
    np.testing.assert_allclose(same, kept, rtol=1e-12)
    other = one.target(motion, np.tile(one.rest + 10.0, 1 + one.preview))
    change = one.rest_gains.reshape(2, -1, 2).sum(axis=(1, 2)) * 10.0
    np.testing.assert_allclose(other[0] - kept[0], change, rtol=1e-9)


@pytest.mark.parametrize(
    ("position", "velocity", "acceleration"),
    [(5e-6, 1e-3, 0.05), (1e-7, 1e-5, 1e-3), (1e-4, 1e-2, 0.5)],
)
def test_the_motion_filter_is_where_the_kalman_filter_settles(position, velocity, acceleration):
    """Its gain by the recursion of variances; the acceleration is a straight line in between."""
    free, drive = np.array([[1.0, DT], [0.0, 1.0]]), np.array([DT**2 / 2, DT])
    noise = np.diag([position**2, velocity**2])
    spread = noise
    for _ in range(20_000):
        ahead = free @ spread @ free.T + np.outer(drive, drive) * acceleration**2
        gain = ahead @ np.linalg.inv(ahead + noise)
        last, spread = spread, (np.eye(2) - gain) @ ahead
        if np.allclose(spread, last, rtol=1e-13, atol=0):
            break
    before, now = np.array([DT**2 / 3, DT / 2]), np.array([DT**2 / 6, DT / 2])
    kept = np.eye(2) - gain
    exact = np.column_stack([kept @ free, kept @ before, gain, kept @ now])
    found = motion_filter(DT, position, velocity, acceleration)
    np.testing.assert_allclose(found, exact, rtol=1e-4, atol=1e-7)


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-5.0, 5.0), st.floats(-400.0, 400.0))
@settings(max_examples=30, deadline=None)
def test_a_motion_of_linear_acceleration_passes_it_unchanged(x, v, a, jerk):
    steps = np.arange(50) * DT
    exact = np.stack(
        [x + v * steps + a * steps**2 / 2 + jerk * steps**3 / 6,
         v + a * steps + jerk * steps**2 / 2, a + jerk * steps]
    ).T  # fmt: skip
    passed, gains = exact[0].copy(), motion_filter(DT, 5e-6, 1e-3, 0.05)
    for sample in exact[1:]:
        passed[:2] = gains @ np.concatenate([passed, sample])
        passed[2] = sample[2]
        np.testing.assert_allclose(passed, sample, rtol=1e-9, atol=1e-9)


def test_sensors_without_noise_are_not_trusted_without_end():
    sensors = ("position", "velocity", "acceleration", "force")
    quiet = {f"compensation__noise__{name}": 0.0 for name in sensors}
    known = told(compensation__adaptive=False, **quiet)
    matrix = METHODS["preview_inverse"](known).linear().matrix()
    assert np.isfinite(matrix).all()


def test_a_horizon_is_the_delay_and_what_the_inverse_needs():
    delay = TrackingModel.from_options(told().options, DT).delay(DT)
    assert PreviewFilter(told(), 1.0).preview == np.ceil((delay + 0.06) / DT)
    assert PreviewFilter(told(tracking__dead_time=0.4), 1.0).preview == LONGEST_HORIZON


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"tracking__numerator": 0.0}, "needs tracking"),
        ({"tracking__dead_time": 0.0}, "dead_time is 0 s"),
        ({"tracking__numerator": [1.0, 0.0, 0.0, 1.0]}, "improper"),
        ({"tracking__denominator": [1.0, -1.0]}, "unstable"),
        ({"tracking__stiffness": [1e5, 1e5, 1e5]}, "tracking.stiffness"),
    ],
)
@pytest.mark.parametrize("adaptive", [False, True])
def test_wrong_input_is_one_line(values, message, adaptive):
    with pytest.raises(InputError, match=message) as caught:
        METHODS["preview_inverse"](told(compensation__adaptive=adaptive, **values))
    assert str(caught.value).startswith("reference_force: ")
    assert "\n" not in str(caught.value)
