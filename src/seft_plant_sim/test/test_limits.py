import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError
from seft_msgs_py.parameters import Table
from seft_plant_sim.limits import NAMES, Limits, limit_rows

PAPER = {"displacement": 0.076, "velocity": 0.5, "acceleration": 98.1, "force": 22200.0}
UNITS = ("m", "m/s", "m/s^2", "N")
AXES = ("east", "north")


def state_with(row, column, value):
    state = np.zeros((4, 2))
    state[row, column] = value
    return state


@pytest.mark.parametrize("row", range(4))
@pytest.mark.parametrize("column", range(2))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_each_quantity_on_each_axis_has_its_limit(row, column, sign):
    limits, limit = Limits(PAPER, AXES), PAPER[NAMES[row]]
    assert limits.violation(state_with(row, column, sign * limit)) is None
    beyond = sign * math.nextafter(limit, math.inf)
    assert limits.violation(state_with(row, column, beyond)) == (
        f"{NAMES[row]} {beyond:.5g} {UNITS[row]} on axis {AXES[column]} "
        f"is beyond the limit of {limit:g} {UNITS[row]}"
    )


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("row", range(4))
def test_what_is_no_number_breaks_every_limit(row, value):
    for column in range(2):
        assert f"{NAMES[row]} {value}" in Limits(PAPER, AXES).violation(
            state_with(row, column, value)
        )


def test_all_at_their_limits_at_once_is_within():
    state = np.array([[limit, -limit] for limit in PAPER.values()])
    assert Limits(PAPER, AXES).violation(state) is None


def test_the_first_that_is_broken_is_told():
    state = np.full((4, 2), 1e9)
    assert Limits(PAPER, AXES).violation(state).startswith("displacement 1e+09 m on axis east")


@given(st.data(), st.integers(1, 4))
def test_there_is_a_violation_if_and_only_if_a_value_is_beyond_its_limit(data, axes):
    limits = [data.draw(st.floats(1e-9, 1e9)) for _ in NAMES]
    rows = []
    for limit in limits:
        near = [limit, math.nextafter(limit, 0), math.nextafter(limit, math.inf), 0.0, -0.0]
        near += [math.inf, math.nan, 5e-324, 1e308]
        value = st.sampled_from(near) | st.floats(0, 1.5).map(limit.__mul__) | st.floats()
        signed = st.tuples(value, st.sampled_from([1.0, -1.0])).map(math.prod)
        rows.append(data.draw(st.lists(signed, min_size=axes, max_size=axes)))
    within = all(abs(v) <= limit for row, limit in zip(rows, limits, strict=True) for v in row)
    names = [f"axis {index}" for index in range(axes)]
    with np.errstate(over="ignore"):
        verdict = Limits(dict(zip(NAMES, limits, strict=True)), names).violation(np.array(rows))
    assert (verdict is None) == within


@given(st.floats(1e-9, 1e9), st.sampled_from(range(4)))
def test_the_least_excess_alone_is_a_violation(limit, row):
    limits = Limits(dict.fromkeys(NAMES, limit), AXES)
    assert limits.violation(state_with(row, 1, limit)) is None
    assert limits.violation(state_with(row, 1, -math.nextafter(limit, math.inf))) is not None


def test_limits_of_another_node_stand_in():
    rows = limit_rows("supervisor")
    assert [row.default_from for row in rows] == [f"supervisor:limits.{name}" for name in NAMES]
    assert [row.default_from for row in limit_rows()] == [""] * 4
    assert [row.default for row in rows] == list(PAPER.values())
    assert [row.unit for row in rows] == list(UNITS)


def test_a_limit_must_be_positive():
    with pytest.raises(InputError, match=r"limits\.force is 0.0, but must be greater than zero"):
        Table("supervisor", limit_rows()).check({"limits.force": 0})
