import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.facts import CHANNELS, FACTS
from seft_msgs_py.errors import InputError
from seft_plant_sim.limits import (
    RATE_SPAN,
    Limits,
    event_ring,
    exceeds,
    is_exceeded,
    largest_force_rate,
    span_steps,
)
from seft_plant_sim.rig_parameters import LIMIT_ROWS

PAPER = {"displacement": 0.076, "velocity": 0.5, "acceleration": 98.1, "force": 22200.0}
RATES = {"displacement_rate": 3.0, "velocity_rate": 300.0}
RATES |= {"acceleration_rate": 3e4, "force_rate": 3e6}
UNITS = ("m", "m/s", "m/s^2", "N")
RATE_UNITS = ("m/s", "m/s^2", "m/s^3", "N/s")
AXES = ("east", "north")
DT = 0.002


class CheckedLimits(Limits):
    """Limits as a driver looks at them, sample by sample; a simulated rig must find the same."""

    def __init__(self, limits, axes, dt):
        super().__init__(limits, axes, dt)
        self.before, self.steps, self.seen = [], span_steps(dt), np.zeros(8)
        self.ring = np.full((self.steps, 4, len(axes)), np.nan)

    def violation(self, measured):
        step, own = len(self.before), np.empty_like(measured)
        broken = exceeds(self.values, step, self.ring, measured, own, self.seen)
        self.before.append(np.array(measured))
        with np.errstate(invalid="ignore", over="ignore"):
            now = np.array(measured, dtype=np.float64)
            found = exceeds(self.values, step, self.recent, now, self.change, self.largest)
            message = self.describe(now) if found else None
            change = measured - self.before[max(0, step - self.steps)]
        change = np.abs(change) if step else np.zeros_like(measured)
        np.testing.assert_array_equal(np.abs(own), change)
        sizes = (np.abs(measured), change)
        parts = (self.values[:4, None], self.values[4:, None])
        beyond = [not (size <= part).all() for size, part in zip(sizes, parts, strict=True)]
        assert broken == beyond[0] + 2 * beyond[1]
        assert (broken > 0) == (message is not None)
        np.testing.assert_array_equal(self.largest, self.seen)
        return message

    def reset(self):
        self.largest[:] = 0.0
        self.before, self.seen[:] = [], 0.0


def state_with(row, column, value):
    state = np.zeros((4, 2))
    state[row, column] = value
    return state


@pytest.mark.parametrize("row", range(4))
@pytest.mark.parametrize("column", range(2))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_quantity_on_each_axis_has_its_limit(row, column, sign):
    limits, limit = CheckedLimits(PAPER, AXES, DT), PAPER[CHANNELS[row]]
    assert limits.violation(state_with(row, column, sign * limit)) is None
    beyond = sign * math.nextafter(limit, math.inf)
    assert limits.violation(state_with(row, column, beyond)) == (
        f"{CHANNELS[row]} {beyond:.5g} {UNITS[row]} on axis {AXES[column]} "
        f"is beyond the limit of {limit:g} {UNITS[row]}"
    )


def test_the_first_that_is_broken_is_reported():
    state = np.full((4, 2), 1e9)
    first = CheckedLimits(PAPER, AXES, DT).violation(state)
    assert first.startswith("displacement 1e+09 m on axis east")


@settings(suppress_health_check=[HealthCheck.too_slow])  # of a busy machine
@given(st.data(), st.integers(1, 4))
def test_there_is_a_violation_if_and_only_if_a_value_is_beyond_its_limit(data, axes):
    limits = [data.draw(st.floats(1e-9, 1e9)) for _ in CHANNELS]
    rows = []
    for limit in limits:
        near = [limit, math.nextafter(limit, 0), math.nextafter(limit, math.inf), 0.0, -0.0]
        near += [math.inf, math.nan, 5e-324, 1e308]
        value = st.sampled_from(near) | st.floats(0, 1.5).map(limit.__mul__) | st.floats()
        signed = st.tuples(value, st.sampled_from([1.0, -1.0])).map(math.prod)
        rows.append(data.draw(st.lists(signed, min_size=axes, max_size=axes)))
    within = all(abs(v) <= limit for row, limit in zip(rows, limits, strict=True) for v in row)
    names = [f"axis {index}" for index in range(axes)]
    checked = CheckedLimits(dict(zip(CHANNELS, limits, strict=True)), names, DT)
    verdict = checked.violation(np.array(rows))
    assert (verdict is None) == within


@pytest.mark.parametrize("row", range(4))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_quantity_has_a_largest_change_from_sample_to_sample(row, sign):
    far = dict.fromkeys(CHANNELS, 1e9)
    limits, rate = CheckedLimits(far | RATES, AXES, DT), RATES[f"{CHANNELS[row]}_rate"]
    assert limits.violation(state_with(row, 1, 1e8)) is None  # of a first sample there is none
    assert limits.violation(state_with(row, 1, 1e8 + 0.999 * sign * rate * DT)) is None
    beyond = state_with(row, 1, 1e8 + 2.1 * sign * rate * DT)
    message = limits.violation(beyond)
    assert message.startswith(f"{CHANNELS[row]} rate {sign * 1.101 * rate:.5g}")
    assert message.endswith(
        f"{RATE_UNITS[row]} on axis north is beyond the limit of {rate:g} {RATE_UNITS[row]}"
    )
    assert limits.violation(beyond) is None
    limits.reset()
    assert limits.violation(state_with(row, 1, -1e8)) is None


@pytest.mark.parametrize(("rate", "steps"), [(250, 1), (500, 1), (1000, 2), (4000, 8)])
def test_a_change_counts_over_2_ms_or_a_longer_period(rate, steps):
    assert span_steps(1.0 / rate) == steps
    limits = CheckedLimits(dict.fromkeys(CHANNELS, 1e9) | RATES, AXES, 1.0 / rate)
    fastest = RATES["force_rate"] / rate
    for k in range(3 * steps):
        assert limits.violation(state_with(3, 1, 0.999 * fastest * k)) is None
    top = 0.999 * fastest * (3 * steps - 1)
    beyond = state_with(3, 1, top + 1.01 * steps * fastest)
    trips = [limits.violation(beyond) is not None for _ in range(steps + 1)]
    assert trips == [True] * steps + [False]  # until the jump is older


@pytest.mark.parametrize("rate", [500, 4000])
def test_noise_uses_the_same_share_of_a_rate_s_limit_at_every_rate(rate):
    limits, force = Limits(PAPER | RATES, ("x",), 1.0 / rate), np.zeros((4, 1))
    own, rng = (limits.recent, force, limits.change, limits.largest), np.random.default_rng(1)
    noise = 80.0 * rng.standard_normal(20_000)  # N, of the load cell of a heavy specimen
    for step, force[3] in enumerate(noise):
        assert not exceeds(limits.values, step, *own)
    assert limits.margins()["force_rate"] == pytest.approx(0.91, abs=0.015)


def test_a_force_rate_of_0_is_the_whole_force_within_2_ms():
    assert largest_force_rate({"force": 22200.0, "force_rate": 0.0}) == 22200.0 / RATE_SPAN
    assert largest_force_rate({"force": 22200.0, "force_rate": 3e6}) == 3e6
    limits = CheckedLimits(PAPER | {"force_rate": 0.0}, AXES, DT)
    limits.violation(state_with(3, 1, -0.4 * PAPER["force"]))
    assert limits.violation(state_with(3, 1, 0.5 * PAPER["force"])) is None
    assert limits.margins()["force_rate"] == pytest.approx(0.1)
    assert limits.violation(state_with(3, 1, -0.6 * PAPER["force"])) == (
        "force rate -1.221e+07 N/s on axis north is beyond the limit of 1.11e+07 N/s"
    )


@pytest.mark.parametrize("row", range(4))
def test_the_least_excess_of_a_change_is_a_violation(row):
    limits = CheckedLimits(dict.fromkeys(CHANNELS, 1e9) | RATES, AXES, DT)
    most = limits.values[4 + row]
    for value, trips in ((most, False), (math.nextafter(most, math.inf), True)):
        limits.reset()
        assert limits.violation(state_with(row, 1, 0.0)) is None
        assert (limits.violation(state_with(row, 1, value)) is not None) == trips
        assert limits.margins()[f"{CHANNELS[row]}_rate"] == 1.0 - value / most
        assert sum(margin < 1.0 for margin in limits.margins().values()) == 2


def test_a_sample_that_is_no_number_is_reported_and_so_is_the_return_from_it():
    limits = CheckedLimits(PAPER | RATES, AXES, DT)
    limits.violation(np.zeros((4, 2)))
    assert limits.violation(state_with(3, 0, math.nan)).startswith("force nan N on axis east")
    assert limits.violation(np.zeros((4, 2))).startswith("force rate nan N/s on axis east")


def test_margins_are_the_smallest_since_the_reset():
    limits = CheckedLimits(PAPER | RATES, AXES, DT)
    for force in (0.0, -0.2, 0.1):
        limits.violation(state_with(3, 1, force * PAPER["force"]))
    margins = limits.margins()
    assert margins["force"] == pytest.approx(0.8)
    assert margins["force_rate"] == pytest.approx(1 - 0.3 * 22200 / (3e6 * DT))
    assert margins["displacement"] == margins["velocity_rate"] == 1.0
    assert list(margins) == list(LIMIT_ROWS)
    limits.reset()
    assert set(limits.margins().values()) == {1.0}


def test_limits_are_those_of_the_paper_unless_they_are_given():
    rows = [FACTS[f"limits.{name}"] for name in LIMIT_ROWS]
    rates = RATES | {"force_rate": 0.0}
    assert [row.default for row in rows] == [*PAPER.values(), *rates.values()]
    assert [row.unit for row in rows] == [*UNITS, *RATE_UNITS]
    with pytest.raises(InputError, match=r"limits\.force is 0, but must be greater than zero"):
        FACTS["limits.force"].check(0, "/**")


def blind_until(limit, steps):
    """Step of the first violation if sensors are at their range in these steps."""
    times, window = event_ring(limit, 0.002)
    for count, step in enumerate(steps):
        if is_exceeded(times, count, step, window):
            return step
    return None


def test_sensors_may_be_blind_for_so_long_and_no_longer():
    for first in (0, 100, 100_000):
        assert blind_until(0.05, range(first, first + 25)) is None
        assert blind_until(0.05, range(first, first + 26)) == first + 25
    assert blind_until(0.0, [7]) == 7
    assert blind_until(1e9, range(2000)) is None


def test_only_the_last_second_counts_and_gaps_within_it_do_not_help():
    assert blind_until(0.05, range(0, 50_000, 20)) is None  # 25 in each second, at the most
    assert blind_until(0.05, range(0, 500, 19)) == 25 * 19
    assert blind_until(0.05, [*range(25), *range(500, 525)]) is None
    assert blind_until(0.05, [*range(25), 499]) == 499


def test_what_is_at_its_limit_is_not_what_is_reported():
    limits, state = CheckedLimits(PAPER, AXES, DT), np.zeros((4, 2))
    state[0], state[3, 1] = PAPER["displacement"], -2 * PAPER["force"]
    assert limits.violation(state).startswith("force -44400 N on axis north")
