import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_ros.analysis.tracking import benchmark_criteria

QUICK = settings(max_examples=30)
DT = 1 / 512
TIME = np.arange(4000) * DT


def burst(delay=0.0):
    t = TIME - 4.0 - delay
    return np.exp(-((t / 0.7) ** 2)) * np.cos(2 * np.pi * 6.0 * t)


def values(found, *names):
    return [row[name] for row, name in zip(found, names, strict=True)]


def test_j1_finds_3_7_ms_between_the_samples():
    found = benchmark_criteria(burst(), 0.9 * burst(0.0037), burst(), burst(), DT)
    assert values(found, "J1") == pytest.approx([3.7], abs=1e-3)


def test_j1_of_a_measured_signal_that_leads_is_negative():
    found = benchmark_criteria(burst(), burst(-0.0037), burst(), burst(), DT)
    assert values(found, "J1") == pytest.approx([-3.7], abs=1e-3)


def test_a_gain_of_seven_percent_is_seven_percent_in_every_error():
    y = 1.07 * burst()
    found = benchmark_criteria(burst(), y, burst(), y, DT)[0]
    assert found == {
        "J1": pytest.approx(0.0, abs=1e-9),
        **{name: pytest.approx(7.0, rel=1e-9) for name in ("J2", "J3", "J4", "J7")},
    }


def test_hand_values():
    command, measured = np.array([0.0, 3.0, -4.0, 0.0]), np.array([0.0, 4.0, -4.0, -2.0])
    reference, x = np.array([[1.0, 2.0], [2.0, -5.0]]), np.array([[1.0, 2.0], [1.0, -4.0]])
    both = np.stack([command, measured], axis=1), np.stack([measured, command], axis=1)
    found = benchmark_criteria(*both, reference, x, DT)
    assert values(found, "J2", "J2") == pytest.approx(
        [100 * math.sqrt(5 / 25), 100 * math.sqrt(5 / 36)]
    )
    assert values(found, "J3", "J3") == pytest.approx([50.0, 50.0])
    assert values(found, "J4", "J5") == pytest.approx(
        [100 * math.sqrt(1 / 5), 100 * math.sqrt(1 / 29)]
    )
    assert values(found, "J7", "J8") == pytest.approx([50.0, 20.0])


def test_a_mean_error_counts_as_in_the_paper():
    """The benchmark's code takes standard deviations, which are blind to it."""
    command = np.array([1.0, -1.0, 1.0, -1.0])
    found = benchmark_criteria(command, command + 0.1, command, command + 0.1, DT)
    assert found[0]["J2"] == pytest.approx(10.0)
    assert found[0]["J4"] == pytest.approx(10.0)


def test_each_axis_has_its_own_criteria_and_the_fourth_no_floor():
    four = np.stack([burst()] * 4, axis=1)
    found = benchmark_criteria(four, four, four, four, DT)
    names = [set(found[axis]) - {"J1", "J2", "J3"} for axis in range(4)]
    assert names == [{"J4", "J7"}, {"J5", "J8"}, {"J6", "J9"}, set()]


def test_lost_steps_count_neither_as_errors_nor_as_delay():
    steps = np.flatnonzero(np.random.default_rng(0).random(len(TIME)) > 0.1)
    y = 1.02 * burst(0.0037)
    found = benchmark_criteria(burst()[steps], y[steps], burst(), burst(), DT, steps)
    assert values(found, "J1") == pytest.approx([3.7], abs=0.05)
    whole = benchmark_criteria(burst(), y, burst(), burst(), DT)
    assert found[0]["J2"] == pytest.approx(whole[0]["J2"], rel=0.02)


@QUICK
@given(st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
def test_scaling_both_signals_changes_nothing(scale, seed):
    a, b = np.random.default_rng(seed).standard_normal((2, 40))
    one = benchmark_criteria(a, b, a, b, DT)[0]
    other = benchmark_criteria(scale * a, scale * b, scale * a, scale * b, DT)[0]
    assert other == pytest.approx(one, rel=1e-6, abs=1e-6)


@QUICK
@given(st.integers(3, 60), st.integers(0, 2**32 - 1))
def test_identical_signals_are_zero_throughout(count, seed):
    y = np.random.default_rng(seed).standard_normal((count, 3))
    found = benchmark_criteria(y, y, y, y, DT)
    for axis in range(3):
        assert set(found[axis].values()) == {0.0}


def test_what_makes_no_sense_is_nan():
    zero, one = np.zeros(9), np.ones(9)
    for arrays in ((zero, one, zero, one), (one, one * math.nan) * 2, (np.empty(0),) * 4):
        found = benchmark_criteria(*arrays, DT)[0]
        assert all(math.isnan(value) for value in found.values())


def test_shapes_that_differ_are_refused():
    with pytest.raises(ValueError, match="same shape"):
        benchmark_criteria(np.ones(5), np.ones(4), np.ones(5), np.ones(5), DT)
    with pytest.raises(ValueError, match="same shape"):
        benchmark_criteria(np.ones(5), np.ones(5), np.ones((5, 2)), np.ones(5), DT)
