"""Axes and names of several rigs."""

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.outcome import Outcome, Trip, all_saturated
from seft_msgs_py.wire.topics import (
    CLOCK_TOPIC,
    RigAxes,
    Timebase,
    rigs_of,
    topics_of,
    with_rigs,
)

AXES = ("west/x", "east/x", "west/y")
WEST, EAST = RigAxes("west", ("west/x", "west/y"), (0, 2)), RigAxes("east", ("east/x",), (1,))


def test_axes_are_sorted_by_the_rigs_they_name():
    assert rigs_of(AXES) == (WEST, EAST)
    assert rigs_of(["x", "y"]) == (RigAxes.whole(["x", "y"]),)
    assert rigs_of(["west/x"]) == (RigAxes("west", ("west/x",), (0,)),)


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        (["west/x", "y"], "y names no rig as the others do"),
        (["1/x"], "a rig named 1 can't have a namespace"),
        (["a/b/x"], "a rig named a/b can't have a namespace"),
    ],
)
def test_what_is_no_rig_is_refused(axes, words):
    with pytest.raises(InputError, match=words):
        Experiment({"rig": {"rate": 500.0, "axes": axes}})


def test_each_rig_has_nodes_and_topics_of_its_own():
    topics = {topic.name: topic for topic in topics_of((WEST, EAST))}
    assert "rig/state" not in topics
    assert topics["west/rig/state"].publisher == "west/rig"
    assert topics["east/rig/state"].subscribers == ("reference_force", "east/force_controller")
    assert topics["east/rig/measured"].publisher == "east/rig"
    assert topics["east/rig/measured"].subscribers == ()
    assert topics["reference_force"].subscribers == (
        "west/force_controller",
        "east/force_controller",
    )
    assert topics["experiment/state"].subscribers == ("ground_motion", "west/rig", "east/rig")
    assert topics[CLOCK_TOPIC.name].publisher == "west/rig"
    assert with_rigs(["rig", "recorder"], (WEST, EAST)) == ["west/rig", "east/rig", "recorder"]


def test_how_a_test_ended_is_put_together():
    stopped = Outcome("tripped", 9, 2, [3, 4], 1.0, Trip("stopped", 8, 0.016), 1)
    at_its_end = {"valve": {"samples": 2, "first_step": 5}}
    tripped = Outcome("tripped", 8, 1, [3], 2.0, Trip("velocity", 9, 0.018), 0, at_its_end)
    both = Outcome.of_all([stopped, tripped])
    assert both.trip == tripped.trip  # the cause
    assert (both.steps, both.missed, both.missed_steps, both.overruns) == (8, 3, [3, 4], 1)
    assert both.wall_s == 2.0
    twice = all_saturated([{"valve": {"samples": 1, "first_step": 2}}, tripped.saturation])
    assert twice == {"valve": {"samples": 3, "first_step": 2}}
    finished = Outcome("finished", 9, 0, [], None, None)
    assert Outcome.of_all([finished, finished]) == finished


DIVISORS = sorted(2**i * 5**j for i in range(10) for j in range(10))
"""Whole rates with a whole period: the divisors of 10^9."""
STEPS = st.integers(0, 10**12)


@given(st.floats(min_value=1e-3, max_value=1e9))
def test_an_accepted_rate_and_its_period_multiply_to_one_second_exactly(rate):
    try:
        timebase = Timebase.from_rate(rate)
    except InputError:
        assert (Fraction(10**9) / Fraction(rate)).denominator != 1
    else:
        assert Fraction(rate) * timebase.period_ns == 10**9
        assert timebase.dt == timebase.period_ns / 1e9


@pytest.mark.parametrize("rate", [0, 5e-324, -500.0, math.inf, -math.inf, math.nan])
def test_a_rate_that_is_no_positive_number_is_refused(rate):
    with pytest.raises(InputError, match="must be positive"):
        Timebase.from_rate(rate)


@given(st.sampled_from(DIVISORS), STEPS)
def test_a_step_and_its_stamp_name_each_other(rate, step):
    timebase = Timebase.from_rate(rate)
    stamp = timebase.stamp_ns(step)
    assert stamp * rate == step * 10**9  # no rounding, however long the test
    assert timebase.step(stamp) == step


@given(st.sampled_from(DIVISORS[:-1]), STEPS, st.data())
def test_a_stamp_between_two_steps_is_refused(rate, step, data):
    timebase = Timebase.from_rate(rate)
    off = data.draw(st.integers(1, timebase.period_ns - 1))
    with pytest.raises(WireError, match="another rate"):
        timebase.step(timebase.stamp_ns(step) + off)
