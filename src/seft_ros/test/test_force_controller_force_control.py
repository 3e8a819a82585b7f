"""The force controller against scipy.signal, and its behaviour at the valve's limit."""

import numpy as np
import pytest
import scipy.signal
from bare_rig import section_of
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase
from seft_ros.force_controller.force_control import ForceController
from seft_ros.force_controller.force_controller_parameters import FORCE_CONTROLLER_TABLE
from seft_ros.force_controller.methods import force_control

DT = 0.002
PAPER = ([37.0], [1.0, 17.14, 4002.0])
CONTROLLERS = {
    "gain": ([2.5], [0.5]),
    "paper": PAPER,
    "integrator": ([50.0], [1.0, 0.0]),
    "biproper lead": ([0.02, 1.0], [0.001, 1.0]),
    "double integrator with zeros": ([1.0, 30.0, 400.0], [1.0, 0.0, 0.0]),
    "order 3": ([4e3, 1e5], [1.0, 120.0, 9e3, 2e5]),
    "order 4 biproper": ([1.0, 20, 5e3, 1e4, 9e5], [1.0, 60, 9e3, 8e4, 2e6]),
    "order 5": ([3e6, 2e8], [1.0, 300.0, 5e4, 4e6, 2e8, 3e9]),
    "leading zeros": ([0.0, 0.0, 37.0], [0.0, 1.0, 17.14, 4002.0]),
}


def controller(numerator, denominator, limit=1e300, axes=1):
    return ForceController([(numerator, denominator)] * axes, limit, DT)


def drive(block, reference, force):
    """Valve drive for histories of reference and measured force, both of shape (N, n)."""
    block.reset()
    states = np.full((len(force), 4, force.shape[1]), 1e6)  # all but the force must not matter
    states[:, 3] = force
    return np.array(
        [block.step(r[None, None], s).copy() for r, s in zip(reference, states, strict=True)]
    )


def filtered(numerator, denominator, error):
    """The same by scipy: bilinear discretisation and a linear filter."""
    numerator, denominator = (np.trim_zeros(p, "f") for p in (numerator, denominator))
    if len(denominator) == 1:
        return error * numerator[0] / denominator[0]
    b, a, _ = scipy.signal.cont2discrete((numerator, denominator), DT, "bilinear")
    return scipy.signal.lfilter(b.ravel(), a, error, axis=0)


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("axes", [1, 3])
def test_below_the_limit_it_is_the_linear_filter_of_scipy(name, axes):
    rng = np.random.default_rng(1)
    reference, force = rng.normal(size=(2, 400, axes))
    expected = filtered(*CONTROLLERS[name], reference - force)
    got = drive(controller(*CONTROLLERS[name], axes=axes), reference, force)
    np.testing.assert_allclose(got, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("numerator", "denominator", "message"),
    [
        ([1.0, 0.0], [5.0], "improper: numerator of degree 1 over denominator of degree 0"),
        ([1.0, 0.0, 0.0], [0.0, 1.0, 1.0], "improper: numerator of degree 2 over .* degree 1"),
        ([1.0], [0.0], "denominator is zero"),
        ([1.0], [0.0, 0.0, 0.0], "denominator is zero"),
        ([1.0], [1.0, -2 / DT], "a pole at 1000 rad/s"),
    ],
)
def test_a_controller_that_cannot_be_sampled_is_refused(numerator, denominator, message):
    with pytest.raises(InputError, match=f"force_controller: .*{message}"):
        controller(numerator, denominator)


@given(
    st.sampled_from(sorted(CONTROLLERS)),
    st.floats(1e-3, 1e3),
    st.integers(1, 4),
    st.integers(0, 2**32 - 1),
    st.floats(0, 8),
)
def test_the_drive_never_exceeds_the_limit(name, limit, axes, seed, size):
    reference = np.random.default_rng(seed).normal(size=(60, axes)) * 10**size
    block = controller(*CONTROLLERS[name], limit=limit, axes=axes)
    assert np.abs(drive(block, reference, 0 * reference)).max() <= limit


@pytest.mark.parametrize("axes", [2, 3])
def test_an_axis_does_not_feel_another_one_at_its_limit(axes):
    rng = np.random.default_rng(2)
    reference = rng.normal(size=(300, axes)) * np.array([1e5, 1.0, 3e4])[:axes]
    together = drive(controller(*PAPER, 10.0, axes), reference, 0 * reference)
    for column in range(axes):
        one = reference[:, column : column + 1]
        alone = drive(controller(*PAPER, 10.0), one, 0 * one)
        np.testing.assert_allclose(together[:, column : column + 1], alone, atol=1e-12)


@pytest.mark.parametrize(("numerator", "steps"), [([50.0], 1), ([5.0, 50.0], 0)])
def test_after_long_saturation_it_leaves_the_limit_at_once(numerator, steps):
    """An integrator as soon as the trapezoid of the errors has changed its sign, a PI at once."""
    error = np.repeat([1.0, -1.0], [5000, 5000])[:, np.newaxis]
    got = drive(controller(numerator, [1.0, 0.0], 10.0), error, 0 * error)
    assert (got[1000:5000] == 10.0).all()
    assert got[5000 + steps, 0] < 10.0
    wound_up = np.clip(filtered(numerator, [1.0, 0.0], error), -10.0, 10.0)
    assert (wound_up[5000 : 5000 + 4000] == 10.0).all()  # what a plain recursion would do


ONE = ([37.0, 2.0], [1.0, 17.14, 4002.0])
OTHER = ([0.0, 50.0], [1.0, 30.0, 900.0])
MIXED = np.array([[1.0, -0.3, 0.0], [0.2, 1.5, 0.1], [0.0, 0.0, 0.7]])


def made(axes, **values):
    names = tuple(f"axis {index}" for index in range(axes))
    specimen = {"specimen.mass": 50.0, "specimen.stiffness": 2e5}
    section = section_of(FORCE_CONTROLLER_TABLE, **specimen, **values)
    return force_control(section, names, Timebase.from_rate(500.0))


def random(axes, steps=50):
    rng = np.random.default_rng(1)
    return zip(rng.normal(size=(steps, axes)), rng.normal(size=(steps, 4, axes)), strict=True)


@pytest.mark.parametrize("feedback", [True, False])
@pytest.mark.parametrize(
    ("controllers", "gain"),
    [([ONE], None), ([ONE] * 3, None), ([ONE, OTHER, ONE], None), ([ONE, OTHER, ONE], MIXED)],
)
def test_the_linear_system_of_a_controller_answers_like_it(controllers, gain, feedback):
    axes = len(controllers)
    control = ForceController(controllers, 1e9, 0.002, feedback, gain)
    linear = control.linear()
    w = np.zeros(len(linear.a))
    for force, state in random(axes):
        signals = np.concatenate([force, state.ravel()])
        expected = linear.c @ w + linear.d @ signals
        w = linear.a @ w + linear.b @ signals
        np.testing.assert_allclose(
            control.step(force[None, None], state), expected, rtol=1e-11, atol=1e-15
        )


def test_a_controller_for_each_axis_is_that_controller_there():
    both = made(2, per_axis=True, numerator=[*ONE[0], *OTHER[0]], denominator=[*ONE[1], *OTHER[1]])
    alone = [ForceController([each], 10.0, 0.002) for each in (ONE, OTHER)]
    for force, state in random(2):
        found = both.step(force[None, None], state)
        for axis, own in enumerate(alone):
            (drive,) = own.step(force[None, None, [axis]], state[:, [axis]])
            np.testing.assert_allclose(found[axis], drive, rtol=1e-12, atol=1e-15)


@given(st.lists(st.floats(-5e4, 5e4), min_size=40, max_size=40), st.floats(0.3, 3.0))
def test_beyond_the_limit_it_does_not_wind_up_with_a_gain_either(forces, gain):
    """The same as a controller whose own output is limited to the limit over the gain."""
    scaled = ForceController([ONE], 10.0, 0.002, gain=np.array([[gain]]))
    own = ForceController([ONE], 10.0 / gain, 0.002)
    for force in forces:
        found, expected = (c.step(np.array([[[force]]]), np.zeros((4, 1))) for c in (scaled, own))
        np.testing.assert_allclose(found, gain * expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"per_axis": True, "numerator": [1.0, 2.0, 3.0]}, "numerator has 3 coefficients for 2"),
        (
            {"per_axis": True, "numerator": [1.0, 2.0], "denominator": [0.0, 1.0, 1.0, 1.0]},
            "denominators of degree 0 and 1",
        ),
        ({"gain": [1.0, 1.0, 1.0, 1.0]}, "gain .* is singular"),
        ({"gain": [1.0, 1.0, 1.0]}, "force_controller: gain: 3 values for 2 axes"),
    ],
)
def test_what_makes_no_controllers_is_refused(values, words):
    with pytest.raises(InputError, match=words):
        made(2, **values)
