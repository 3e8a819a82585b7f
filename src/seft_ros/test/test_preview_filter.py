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
from seft_ros.reference_force.compensation.preview.coming_weights import coming_weights
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
ANY = FELT | {"tracking.blocked_error": [4e-6, 2e-4, 0.01]}
INVERTED = FELT | {
    "tracking.blocked_compliance": [5e-12, 1e-9, 5e-8],
    "tracking.actuator_size": [1.0, 1.3],
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
    coming = coming_weights(np.array(options["tracking.blocked_error"]), DT)
    compliance = np.array(options["tracking.blocked_compliance"])
    nominal = [
        np.reshape(options[f"tracking.{name}"], (n, n)) if felt else np.zeros((n, n))
        for name in ("stiffness", "damping")
    ]
    sizes = np.broadcast_to(options["tracking.actuator_size"], n)
    by_mode = sum(  # E of a controller that inverts the nominal specimen
        np.multiply.outer(coming_weights(np.append(compliance, [0.0] * p), DT), matrix / sizes)
        for p, matrix in enumerate([*nominal, known.mass])
    )
    total, share = known.total_mass, known.computed_mass @ np.linalg.inv(known.total_mass)
    system = np.zeros((5 * n, 5 * n))  # x, v, a_g, rate of a_g, p
    system[:n, n : 2 * n] = np.eye(n)
    system[n : 2 * n] = np.hstack(
        [-np.linalg.solve(total, known.stiffness), -np.linalg.solve(total, known.damping),
         -np.eye(n), np.zeros((n, n)), -np.linalg.inv(total)]
    )  # fmt: skip
    system[2 * n : 3 * n, 3 * n : 4 * n] = np.eye(n)
    ahead = expm(system * DT)
    driven, committed = np.zeros((4 * n, 4 * n)), 0  # x, v, f + d, rate of f + d
    if compliance.any():
        committed = round((model.dead_time + model.delay(DT)) / 2 / DT)
        inverse = np.linalg.inv(known.mass)
        driven[:n, n : 2 * n] = driven[2 * n : 3 * n, 3 * n :] = np.eye(n)
        driven[n : 2 * n, : 3 * n] = inverse @ np.hstack([-nominal[0], -nominal[1], np.eye(n)])
    driven = expm(driven * DT)
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
        echo = np.zeros(n)  # of the departure, in a loop of finite gain
        on_its_way = z
        for j in range(horizon + 1):
            a_g = motion[k + j]
            x_j, v_j = path.reshape(2, n)
            r = known.stiffness @ x_j + known.damping @ v_j + p
            target = share @ r - known.mass @ a_g
            if felt:
                d = nominal[0] @ x_j + nominal[1] @ v_j - r
                target = target + d
                if j < len(coming):
                    echo = echo + coming[j] * d + by_mode[j] @ (d - target)
            u = u + tracking.target[j] * target
            if j < committed:
                asked = on_its_way, model.a @ on_its_way + np.outer(model.b, past[0])
                now, then = (model.c @ state for state in asked)
                path = (driven @ np.concatenate([path, now, (then - now) / DT]))[: 2 * n]
                on_its_way = asked[1]
            elif j < horizon:
                rate = (motion[k + j + 1] - a_g) / DT
                path = (ahead @ np.concatenate([path, a_g, rate, p]))[: 2 * n]
        d = nominal[0] @ x + nominal[1] @ v - residual - known.stiffness @ x - known.damping @ v
        d = (d + residual - p) if felt else np.zeros(n)
        forces.append(u - d - echo + 0.8 * 9.0 / variance * (residual - p))
        z = model.a @ z + np.outer(model.b, u)
        past = np.vstack([u, past[:-1]])
    return np.array(forces)


@pytest.mark.parametrize("nominal", [{}, FELT, ANY, INVERTED])
def test_the_fixed_method_is_its_equations(nominal):
    known = told(compensation__adaptive=False, **nominal)
    fixed = METHODS["preview_inverse"](known)
    assert isinstance(fixed, LinearCompensator)
    motion, states = shaking(2, 60, fixed.preview)
    forces = run(fixed, motion, states)
    exact = written_out(known, motion, states, fixed.preview)
    np.testing.assert_allclose(forces, exact, atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("mends", [False, True])
@pytest.mark.parametrize("nominal", [{}, FELT, ANY, INVERTED])
def test_its_steps_are_the_linear_filter_that_it_says_it_is(nominal, mends):
    one = PreviewFilter(told(**nominal), 0.3, mends)
    gain, advance = np.array([0.97, 1.02]), np.array([4e-4, -7e-4])
    motion, states = shaking(2, 200, one.preview)
    expected = run(LinearCompensator(one.linear(gain, advance)), motion, states)
    found = []
    for k, state in enumerate(states):
        one.observe(motion[k : k + 1 + one.preview], state)
        found.append(one.command(gain * one.target - advance * one.rate))
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
            one.observe(motion[k : k + 1 + one.preview], state)
            forces.append(one.command(one.target))
    np.testing.assert_array_equal(forces[:20], forces[20:])


@pytest.mark.parametrize("nominal", [{}, FELT, ANY])
def test_a_rest_that_others_tell_counts_as_one_that_it_follows_itself(nominal):
    """Elastic, p stays what it is over the horizon; told the same, it asks for the same force."""
    motion, states = shaking(2, 30, 200)
    elastic, told_so = (PreviewFilter(told(**nominal), 5.0) for _ in range(2))
    told_so.set_restoring(told_so.restoring, elastic=False)
    steps = 1 + elastic.preview
    for k, state in enumerate(states):
        for one in (elastic, told_so):
            one.observe(motion[k : k + steps], state)
        told_so.rest[:] = elastic.rest
        told_so.expect(np.tile(elastic.rest, steps))
        np.testing.assert_allclose(told_so.departure, elastic.departure, rtol=1e-9, atol=1e-8)
        expected = elastic.command(elastic.target)
        np.testing.assert_allclose(told_so.command(told_so.target), expected, rtol=1e-9)


def test_the_course_is_the_whole_structures_response_to_the_ground_motion():
    known = told()
    one = PreviewFilter(known, 0.3, mends=True)
    motion, _ = shaking(2, 120, one.preview)
    system = np.zeros((8, 8))
    system[:2, 2:4] = np.eye(2)
    pull = np.hstack([known.stiffness, known.damping])
    system[2:4, :4], system[2:4, 4:6] = -np.linalg.solve(known.total_mass, pull), -np.eye(2)
    system[4:6, 6:] = np.eye(2)
    ahead, y = expm(system * DT), np.zeros(4)
    for k in range(100):
        one.observe(motion[k : k + 1 + one.preview], np.zeros((4, 2)))
        one.rest[:] = 0.0  # as if the specimen did as the model says
        one.command(one.target)
        rate = (motion[k + 1] - motion[k]) / DT
        y = (ahead @ np.concatenate([y, motion[k], rate]))[:4]
        np.testing.assert_allclose(one.course, y, atol=1e-6 * np.abs(y).max())


def test_a_course_that_begins_anew_begins_at_the_measured_motion():
    one = PreviewFilter(told(), 0.3, mends=True)
    motion, states = shaking(2, 3, one.preview)
    for k in range(2):
        one.observe(motion[k : k + 1 + one.preview], states[k])
        one.command(one.target)
    one.observe(motion[2 : 3 + one.preview], states[2])
    one.begin_course()
    free, by_rest, by_ground = one.prediction.course()
    exact = free @ one.motion + by_rest @ one.rest + by_ground @ motion[2:4].ravel()
    np.testing.assert_allclose(one.course, exact, rtol=1e-9)


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


@pytest.mark.parametrize(
    ("values", "told_of"),
    [
        ({**ANY, **INVERTED}, "blocked_compliance of one that inverts it; set one of them"),
        ({"tracking.blocked_compliance": [1e-8]}, "needs the specimen that the force controller"),
        (INVERTED | {"tracking.actuator_size": [1.0, 1.0, 1.0]}, "must be one number above zero"),
        (INVERTED | {"tracking.actuator_size": [1.0, 0.0]}, "or 2, one for each axis"),
    ],
)
def test_what_contradicts_of_the_force_loop_is_refused(values, told_of):
    with pytest.raises(InputError, match=told_of):
        METHODS["preview_inverse"](told(**values))
