"""The interlocks of a test with several rigs, each on its own axes."""

import numpy as np
from experiments_at_hand import load
from interlocks_at_hand import of_rig
from seft_ros.force_controller.interlock import Interlock, Interlocks, interlock_of


def of_rigs(*words):
    return load(*words, config="two_pier_bridge")


def test_each_rig_has_an_interlock_that_sees_its_own_axes():
    both = interlock_of(of_rigs())
    alone = [interlock_of(of_rigs()) for _ in range(2)]
    rng = np.random.default_rng(3)
    for step in range(50):
        points = 1e-5 * rng.normal(size=(26, 3, 2))
        state = np.array([[5e-6], [1e-3], [0.05], [3.0]]) * rng.normal(size=(4, 2))
        state = of_rig(state, drive=rng.normal(size=2))
        drive = both.step(step, points, state)
        for axis, one in enumerate(alone):  # what the other axis does is of no effect
            other = points.copy(), state.copy()
            for values in other:
                values[..., 1 - axis] = 0.0
            assert one.step(step, *other)[axis] == drive[axis] != 0.0
    assert both.reason == ""


def test_the_first_rig_that_trips_gives_the_reason_and_a_reset_is_for_all():
    both = interlock_of(of_rigs("rig:safe.close_time:=0.0"))
    points, rest = np.zeros((26, 3, 2)), np.zeros((6, 2))
    points[0, 2] = 0.0, 1e6
    assert np.array_equal(both.step(0, points, rest), [0.0, 0.0])
    assert both.reason.startswith("reference force 1e+06 N on axis east/pier is beyond")
    points[0, 2] = -1e6, 1e6
    both.step(1, points, rest)
    assert both.reason.startswith("reference force -1e+06 N on axis west/pier is beyond")
    both.reset()
    assert both.reason == ""
    points[0, 2] = 0.0
    both.step(0, points, rest)
    assert both.reason == ""


def test_one_rig_needs_one_interlock():
    assert isinstance(interlock_of(load(config="demo")), Interlock)
    assert isinstance(interlock_of(of_rigs()), Interlocks)
