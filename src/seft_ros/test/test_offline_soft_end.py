"""A fault at the reference force brings the offline loop down softly, as it does over DDS."""

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from seft_ros.protection.protection_step import RampDown

SHORT = ("ground_motion:synthetic.duration:=5.0", "ground_motion:tail:=0.5")


def run(*words):
    return simulated(load(*SHORT, *words))


def force_of(record):
    return record.series["reference_force"].values[:, 0, 0]


def test_a_force_beyond_its_limit_is_ramped_from_the_last_below():
    free = force_of(run())
    first = int(np.argmax(np.abs(free) > 500.0))
    record = run("reference_force:limits.force:=500.0")
    assert record.trip.step == first
    assert record.trip.time_s == pytest.approx(first * 0.002)
    assert record.trip.reason == (
        f"reference force {free[first]:.5g} N on axis x is beyond the limit of 500 N"
    )
    ramp = RampDown(250)
    ramp.begin()
    expected = [free[first - 1] * ramp.next() for _ in range(250)]
    np.testing.assert_array_equal(force_of(record)[:first], free[:first])
    np.testing.assert_array_equal(force_of(record)[first:], expected)


def test_a_rig_that_trips_within_the_ramp_ends_it_at_once_and_both_causes_are_told():
    """The supervisor's limit stands in for both: the rig's force comes after its reference."""
    free = force_of(run())
    first = int(np.argmax(np.abs(free) > 500.0))
    record = run("supervisor:limits.force:=500.0")
    last = int(record.series["rig/state"].steps[-1])
    assert first < last < first + 249
    assert record.trip.step == last
    assert record.trip.reason.startswith("force ")
    assert "(while ramping down: reference force" in record.trip.reason
