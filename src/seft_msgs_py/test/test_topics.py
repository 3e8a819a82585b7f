"""Axes and names of several rigs."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.outcome import Outcome, Trip, all_saturated
from seft_msgs_py.wire.topics import CLOCK_TOPIC, RigAxes, Timebase, rigs_of, topics_of, with_rigs

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


STEPS = st.integers(0, 10**12)
RATES = st.sampled_from([500.0, 1024.0, 1200.0, 2048.0, 3000.0, 4096.0]) | st.floats(1e-3, 1e6)


@pytest.mark.parametrize("rate", [0, 5e-324, -500.0, 2e9, math.inf, -math.inf, math.nan])
def test_a_rate_that_no_stamps_can_count_is_refused(rate):
    with pytest.raises(InputError, match="must be positive and at most 1e9 Hz"):
        Timebase.from_rate(rate)


@given(RATES, STEPS)
def test_a_step_and_its_stamp_name_each_other_however_long_the_test(rate, step):
    timebase = Timebase.from_rate(rate)
    exact = step * 10**9 / Fraction(rate)
    assert timebase.stamp_ns(step) == round(exact)
    for stamp in (math.floor(exact), round(exact), math.ceil(exact)):  # however a sender rounds
        assert timebase.step(stamp) == step
    assert timebase.dt == 1 / rate


@given(RATES, STEPS, st.data())
def test_a_stamp_between_two_steps_is_refused(rate, step, data):
    timebase = Timebase.from_rate(rate)
    last, following = (timebase.stamp_ns(k) for k in (step, step + 1))
    with pytest.raises(WireError, match="another rate"):
        timebase.step(data.draw(st.integers(last + 2, following - 2)))


@given(RATES, st.lists(st.integers(-(2**61), 2**61) | STEPS))
def test_many_stamps_give_the_steps_of_each(rate, stamps):
    timebase = Timebase.from_rate(rate)
    stamps += [timebase.stamp_ns(step) for step in range(0, 10**6, 99999)]
    steps, fits = timebase.steps(np.array(stamps, dtype=np.int64))
    assert (steps.dtype, fits.dtype) == (np.int64, np.bool_)
    for stamp, step, fit in zip(stamps, steps.tolist(), fits.tolist(), strict=True):
        if fit:
            assert timebase.step(stamp) == step
        else:
            with pytest.raises(WireError, match="another rate"):
                timebase.step(stamp)
