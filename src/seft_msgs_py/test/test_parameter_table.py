import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.facts import CHANNELS, fact_of, facts
from seft_msgs_py.config.parameter_table import (
    Parameter,
    Table,
    as_matrix,
    group,
    mass_matrix,
    nearest,
    per_axis,
    symmetric_matrix,
)
from seft_msgs_py.errors import InputError

FINITE = st.just(0.0) | st.floats(1e-30, 1e30) | st.floats(-1e30, -1e-30)
KINDS = ("float", "int", "bool", "string", "floats", "ints", "strings")


def check(kind, value, **row):
    return Parameter("mass_ratio", kind, None, "a test's", **row).check(value, "here")


def refused(kind, value, rule, **row):
    with pytest.raises(InputError) as caught:
        check(kind, value, **row)
    text = str(caught.value)
    assert text.startswith("here: mass_ratio is ")
    assert rule in text
    return text


@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        ("float", 2, 2.0),
        ("float", 2.11e5, 211000.0),
        ("int", 7, 7),
        ("bool", False, False),
        ("string", "", ""),
        ("floats", 2, 2.0),
        ("floats", [1, 2.5], [1.0, 2.5]),
        ("ints", 3, 3),
        ("ints", [3, 4], [3, 4]),
        ("strings", ["x", "y"], ["x", "y"]),
        ("texts", ["x", "y"], ["x", "y"]),
    ],
)
def test_a_value_that_fits_is_returned_in_the_type_of_the_parameter(kind, value, expected):
    result = check(kind, value)
    assert result == expected
    assert type(result) is type(expected)
    if isinstance(expected, list):
        assert [type(item) for item in result] == [type(item) for item in expected]


@pytest.mark.parametrize(
    ("kind", "values", "rule"),
    [
        ("float", ["x", "", True, None, [1.0], {}, 1j], "must be a number"),
        ("int", [1.0, 1.5, "1", True, None, [1], 2**63, -(2**63) - 1], "must be a whole number"),
        ("bool", [0, 1, "true", None, [True]], "must be true or false"),
        ("string", [1, 1.0, True, None, ["x"]], "must be text"),
        ("floats", ["x", True, None, {}, [1.0, "x"], [True], [[1.0]]], "must be a number, or"),
        ("ints", [1.5, [1, 1.5], [1, True], "1"], "must be a whole number, or"),
        ("strings", ["x", 1, None, [1], ["x", True], {}], "must be a list of texts"),
        ("texts", [1, None, [1], ["x", True], {}], "must be text, or a list of texts"),
        ("texts", ["a\0b", ["x", "\0"]], "must hold no NUL character"),
        *((kind, [[]], "must not be empty") for kind in ("floats", "ints", "strings", "texts")),
    ],
)
def test_another_type_or_an_empty_list_is_refused_with_what_it_must_be(kind, values, rule):
    for value in values:
        refused(kind, value, rule)


@pytest.mark.parametrize(
    "value", [math.nan, math.inf, -math.inf, 10**400, -(10**400), 1e31, -1e308, 1e-31]
)
def test_a_number_that_nothing_in_si_units_has_is_refused(value):
    refused("float", value, "must be 0, or 1e-30 to 1e+30 in size")
    refused("floats", [1.0, value], "must be 0, or 1e-30 to 1e+30 in size")


@given(FINITE, FINITE, FINITE)
def test_bounds_are_inclusive(value, one, other):
    low, high = min(one, other), max(one, other)
    if low <= value <= high:
        assert check("float", value, minimum=low, maximum=high) == value
    else:
        refused("float", value, "must be at", minimum=low, maximum=high)


@given(FINITE)
def test_positive_excludes_zero(value):
    if value > 0:
        assert check("floats", [1.0, value], positive=True) == [1.0, value]
    else:
        refused("floats", [1.0, value], "must be greater than zero", positive=True)


def test_what_every_value_is_held_to_is_reported_with_unit_and_choices():
    refused("float", -1, "must be at least 0 kg", minimum=0.0, unit="kg")
    refused("float", 11, "must be at most 10 s", maximum=10.0, unit="s")
    refused("ints", [0, -1], "must be at least 0", minimum=0)
    refused("strings", ["rig", "rug"], "did you mean rig?", choices=("rig", "recorder"))
    text = refused("string", "setf", "must be one of eft, seft", choices=("eft", "seft"))
    assert text.endswith("did you mean seft?")
    refused("string", "x", 'must be one of "", a', choices=("", "a"))


@given(
    st.sampled_from(KINDS),
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=3),
        max_leaves=5,
    ),
)
def test_any_value_is_converted_for_good_or_refused_in_an_input_error(kind, value):
    try:
        once = check(kind, value)
    except InputError:
        return
    assert check(kind, once) == once


TABLE = Table(
    "rig",
    [
        *facts(),
        Parameter("seed", "int", 0, "a seed"),
        Parameter("specimen.mass", "floats", None, "mass of it", "kg"),
        Parameter("specimen.damping", "floats", 0.0, "damping of it"),
        Parameter("sensors.force_noise", "float", 0.0, "noise"),
    ],
)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("sede", "seed"),
        ("specimen.mas", "specimen.mass"),
        ("specimen.dampening", "specimen.damping"),
        ("mass", "specimen.mass"),
        ("actuator.mass", "specimen.mass"),
        ("sensors_force.noise", "sensors.force_noise"),
        ("axis", "axes"),
    ],
)
def test_an_unknown_parameter_names_the_nearest(name, meant):
    with pytest.raises(InputError) as caught:
        TABLE.check({name: 1})
    assert str(caught.value) == f"rig: there is no parameter {name}; did you mean {meant}?"


def test_an_unknown_parameter_that_is_like_none_gets_no_hint():
    with pytest.raises(InputError, match=r"there is no parameter zzzzzz$"):
        TABLE.check({"zzzzzz": 1})
    assert nearest("", ["x"]) == ""
    assert nearest("x", []) == ""


def test_a_group_is_the_parameters_under_one_name():
    section = {"specimen.mass": 1.0, "specimen.a.b": 2, "specimens.mass": 3, "specimen": 4}
    assert group(section, "specimen") == {"mass": 1.0, "a.b": 2}


@pytest.mark.parametrize("name", ["", "run", "größe 2", "2026-11-24_15.30", "x" * 200])
def test_a_name_of_a_file_is_any_that_a_disk_takes(name):
    assert check("string", name, file_name=True) == name


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("../run", "without a path"),
        ("..", "without a path"),
        ("-run", "must not begin with -"),
        (" run", "must not begin"),
        ("a\nb", "control characters"),
        ("a\0b", "NUL"),
        ("ö" * 101, "at most 200 bytes"),
    ],
)
def test_a_name_of_a_file_is_no_path(name, rule):
    assert len(refused("string", name, rule, file_name=True)) < 400


XYZ = ("x", "y", "z")
NUMBERS = st.floats(-1e6, 1e6)


def test_one_number_holds_for_every_axis():
    assert per_axis(2.5, XYZ, "here").tolist() == [2.5, 2.5, 2.5]
    assert per_axis([2.5], XYZ, "here").tolist() == [2.5, 2.5, 2.5]


def test_numbers_for_other_than_one_or_all_axes_are_refused():
    for values in ([1.0, 2.0], [1.0] * 4, [1.0] * 9):
        with pytest.raises(InputError, match=rf"there: {len(values)} values for 3 axes"):
            per_axis(values, XYZ, "there")


def test_a_matrix_is_a_number_a_diagonal_or_rows():
    assert as_matrix(2.0, ("x", "y"), "here").tolist() == [[2, 0], [0, 2]]
    assert as_matrix([2.0, 3.0], ("x", "y"), "here").tolist() == [[2, 0], [0, 3]]
    assert as_matrix([1.0, 2.0, 3.0, 4.0], ("x", "y"), "here").tolist() == [[1, 2], [3, 4]]
    assert as_matrix([5.0], ("x",), "here").tolist() == [[5]]


def test_mass_must_be_positive():
    for value in (0.0, -1.0, [1.0, 0.0, 1.0], [1.0, -1e-9, 1.0]):
        with pytest.raises(InputError, match="mass must be positive"):
            mass_matrix(value, XYZ, "rig: specimen.mass")


def test_mass_must_be_positive_definite_not_only_on_its_diagonal():
    coupled = [2.0, 3.0, 3.0, 4.0]  # determinant -1
    with pytest.raises(InputError, match="definite"):
        mass_matrix(coupled, ("x", "y"), "here")
    assert mass_matrix([2.0, 2.0, 2.0, 4.0], ("x", "y"), "here").tolist() == [[2, 2], [2, 4]]


def test_an_asymmetric_matrix_is_refused():
    for make in (mass_matrix, symmetric_matrix):
        with pytest.raises(InputError, match="not symmetric"):
            make([2.0, 1.0, 1.1, 4.0], ("x", "y"), "here")


def test_stiffness_may_be_zero_or_negative():
    assert symmetric_matrix(0.0, ("x", "y"), "here").tolist() == [[0, 0], [0, 0]]
    assert symmetric_matrix([-1.0, 1.0, 1.0, -1.0], ("x", "y"), "here").tolist()[0] == [-1, 1]


@given(st.lists(NUMBERS, min_size=1, max_size=30), st.integers(1, 5))
def test_any_count_gives_a_square_matrix_or_an_input_error(values, axes):
    names = [f"a{i}" for i in range(axes)]
    if len(values) in (1, axes, axes**2):
        matrix = as_matrix(values, names, "here")
        assert matrix.shape == (axes, axes)
        assert set(np.ravel(matrix)) <= {*values, 0.0}
    else:
        with pytest.raises(InputError):
            as_matrix(values, names, "here")


# ---- Facts: which there are, and where a file has them


def test_a_node_has_the_facts_that_it_names_after_rate_and_axes():
    assert [row.name for row in facts()] == ["rate", "axes"]
    limits = [row.name for row in facts("limits.", "specimen.mass")]
    assert limits[:3] == ["rate", "axes", "specimen.mass"]
    assert limits[3:7] == [f"limits.{channel}" for channel in CHANNELS]


def test_a_fact_is_the_default_of_a_truth_of_its_name_or_of_the_calibration():
    assert fact_of("simulated.actuator.flow_gain") == "actuator.flow_gain"
    assert fact_of("simulated.sensors.force_noise") == "sensors.force_noise"
    assert fact_of("simulated.sensors.force_bias") == "calibration.force_bias"
    assert fact_of("simulated.actuator.stroke") == fact_of("actuator.flow_gain") == ""
