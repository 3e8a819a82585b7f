"""The linear system that a controller says it is answers as its block does."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.parameter_table import resolve
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase
from seft_ros.force_controller.force_control import ForceController
from seft_ros.force_controller.force_controller_parameters import FORCE_CONTROLLER_TABLE
from seft_ros.force_controller.methods import force_control

ONE = ([37.0, 2.0], [1.0, 17.14, 4002.0])
OTHER = ([0.0, 50.0], [1.0, 30.0, 900.0])
MIXED = np.array([[1.0, -0.3, 0.0], [0.2, 1.5, 0.1], [0.0, 0.0, 0.7]])


def made(axes, **values):
    names = [f"axis {index}" for index in range(axes)]
    section = resolve(
        {"force_controller": FORCE_CONTROLLER_TABLE},
        {"force_controller": FORCE_CONTROLLER_TABLE.check(values)},
    )
    return force_control(section["force_controller"], tuple(names), Timebase.from_rate(500.0))


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
