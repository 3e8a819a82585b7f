import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_ros.protection.protected_force import RampDown, extrapolated

STEPS = st.integers(1, 2000)


def factors(steps):
    ramp = RampDown(steps)
    ramp.begin()
    return [ramp.next() for _ in range(steps)]


@given(STEPS)
def test_the_factor_falls_from_one_to_zero_by_half_a_cosine_and_never_rises(steps):
    way = [1.0, *factors(steps)]
    assert way[-1] == 0.0
    assert all(0.0 <= later < earlier for earlier, later in itertools.pairwise(way))
    assert way == pytest.approx(0.5 + 0.5 * np.cos(np.pi * np.arange(steps + 1) / steps), abs=1e-12)


@given(STEPS, st.integers(0, 50), st.integers(0, 50))
def test_before_it_is_one_and_after_it_zero(steps, before, after):
    ramp = RampDown(steps)
    assert [ramp.next() for _ in range(before)] == [1.0] * before
    assert not ramp.finished
    ramp.begin()
    for _ in range(steps):
        assert not ramp.finished
        ramp.next()
    assert ramp.finished
    assert [ramp.next() for _ in range(after)] == [0.0] * after


@given(STEPS, st.data())
def test_asking_again_does_not_begin_it_anew(steps, data):
    expected, ramp = factors(steps), RampDown(steps)
    ramp.begin()
    again = data.draw(st.sets(st.integers(0, steps - 1)))
    got = []
    for step in range(steps):
        if step in again:
            ramp.begin()
        got.append(ramp.next())
    assert got == expected


def test_a_reset_makes_it_ready_for_the_next_test():
    ramp = RampDown(3)
    ramp.begin()
    for _ in range(5):
        ramp.next()
    ramp.reset()
    assert (ramp.begun, ramp.finished, ramp.next()) == (False, False, 1.0)


@pytest.mark.parametrize(("duration", "steps"), [(0.5, 250), (0.002, 1), (1e-6, 1)])
def test_its_duration_is_counted_in_steps(duration, steps):
    ramp = RampDown.lasting(duration, 0.002)
    ramp.begin()
    count = 0
    while not ramp.finished:
        ramp.next()
        count += 1
    assert count == steps


def test_it_has_finished_once_it_has_rested_too():
    ramp = RampDown(3, rest=2)
    assert ramp.whole == 5
    ramp.begin()
    finished = []
    for _ in range(6):
        ramp.next()
        finished.append(ramp.finished)
    assert finished == [False] * 4 + [True] * 2
    assert (ramp.begun, ramp.taken) == (True, 6)


def test_a_target_beyond_the_points_that_were_sent_brakes_and_its_force_stays():
    position, velocity, force = points = np.arange(1.0, 19.0).reshape(3, 3, 2)
    points = points.transpose(1, 0, 2)  # three points, of two axes
    found = extrapolated(points, 1, 5, 0.002)
    np.testing.assert_array_equal(found[:2], points[1:])
    left = np.exp(-0.002 / 0.03 * np.arange(1, 4))[:, np.newaxis]
    np.testing.assert_allclose(found[2:, 0], position[2] + 0.03 * (1.0 - left) * velocity[2])
    np.testing.assert_allclose(found[2:, 1], velocity[2] * left)
    np.testing.assert_array_equal(found[2:, 2], [force[2]] * 3)
    np.testing.assert_array_equal(extrapolated(points[:, 2:], 2, 3, 0.002), [points[2, 2:]] * 3)
