"""Deadlines of a simulated rig."""

import pytest
from seft_plant_sim.rig_timing import HURRY, SampleClock


def test_deadlines_are_a_period_apart_and_do_not_drift_by_small_delays():
    clock = SampleClock(0.002, 10.0, makes_up=False)
    for step in range(5):
        assert clock.deadline(step) == pytest.approx(10.0 + 0.002 * step)
        clock.awake(0.0009)
    assert clock.overruns == 0


@pytest.mark.parametrize("makes_up", [False, True])
def test_who_was_held_up_goes_on_from_there(makes_up):
    clock = SampleClock(0.002, 10.0, makes_up=makes_up)
    clock.awake(0.0065)
    assert clock.overruns == 1
    assert clock.deadline(1) == pytest.approx(10.0085, abs=0.002 * HURRY + 1e-9)
    for _ in range(200):
        clock.awake(0.0)
    assert clock.deadline(1) == pytest.approx(10.002 if makes_up else 10.0085)


def test_all_that_is_to_come_is_put_off():
    clock = SampleClock(0.002, 10.0, makes_up=False)
    clock.fall_back(0.001)
    assert clock.deadline(3) == pytest.approx(10.007)
    assert clock.overruns == 0
