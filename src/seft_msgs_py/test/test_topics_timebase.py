import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.topics import Timebase

DIVISORS = sorted(2**i * 5**j for i in range(10) for j in range(10))
"""Whole rates with a whole period: the divisors of 10^9."""
STEPS = st.integers(0, 10**12)


@pytest.mark.parametrize(
    ("rate", "period_ns"),
    [
        (1, 1_000_000_000),
        (1024.0 / 2, 1_953_125),
        (0.5, 2_000_000_000),
        (12.5, 80_000_000),
        (1e9, 1),
    ],
)
def test_a_rate_with_a_whole_period_is_exact(rate, period_ns):
    timebase = Timebase.from_rate(rate)
    assert timebase.period_ns == period_ns
    assert timebase.rate == rate
    assert timebase.dt == period_ns / 1e9


@given(st.integers(1, 10**6))
def test_whole_rates_are_usable_if_and_only_if_they_divide_a_billion(rate):
    if rate in DIVISORS:
        assert Timebase.from_rate(rate).period_ns * rate == 10**9
    else:
        with pytest.raises(InputError) as caught:
            Timebase.from_rate(rate)
        below = max(d for d in DIVISORS if d < rate)
        above = min(d for d in DIVISORS if d > rate)
        assert f"{below} and {above} Hz" in str(caught.value)


@given(st.floats(min_value=1e-3, max_value=1e9))
def test_an_accepted_rate_and_its_period_multiply_to_one_second_exactly(rate):
    try:
        timebase = Timebase.from_rate(rate)
    except InputError:
        assert (Fraction(10**9) / Fraction(rate)).denominator != 1
    else:
        assert Fraction(rate) * timebase.period_ns == 10**9


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


def test_stamps_of_1000_hz_are_refused_at_512_hz():
    fast, odd = Timebase.from_rate(1000), Timebase.from_rate(512)
    assert odd.step(fast.stamp_ns(125)) == 64  # both grids meet here
    with pytest.raises(WireError, match="1000000 ns is not on the 512 Hz grid"):
        odd.step(fast.stamp_ns(1))
