import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.parameter_table import as_matrix, mass_matrix, per_axis, symmetric_matrix
from seft_msgs_py.errors import InputError

XYZ = ("x", "y", "z")
NUMBERS = st.floats(-1e6, 1e6)


def test_one_number_holds_for_every_axis():
    assert per_axis(2.5, XYZ, "here").tolist() == [2.5, 2.5, 2.5]
    assert per_axis([2.5], XYZ, "here").tolist() == [2.5, 2.5, 2.5]


def test_one_number_for_each_axis_stays_in_order():
    assert per_axis([1.0, 2.0, 3.0], XYZ, "here").tolist() == [1.0, 2.0, 3.0]


def test_numbers_for_other_than_one_or_all_axes_are_refused():
    for values in ([1.0, 2.0], [1.0] * 4, [1.0] * 9):
        with pytest.raises(InputError, match=rf"there: {len(values)} values for 3 axes"):
            per_axis(values, XYZ, "there")


def test_a_matrix_is_a_number_a_diagonal_or_rows():
    assert as_matrix(2.0, ("x", "y"), "here").tolist() == [[2, 0], [0, 2]]
    assert as_matrix([2.0, 3.0], ("x", "y"), "here").tolist() == [[2, 0], [0, 3]]
    assert as_matrix([1.0, 2.0, 3.0, 4.0], ("x", "y"), "here").tolist() == [[1, 2], [3, 4]]
    assert as_matrix([5.0], ("x",), "here").tolist() == [[5]]


@pytest.mark.parametrize("count", [2, 4, 5, 8, 10])
def test_a_matrix_of_another_size_is_refused(count):
    with pytest.raises(InputError, match=rf"there: {count} values for 3 axes.*give 1, 3 .* or 9"):
        as_matrix([1.0] * count, XYZ, "there")


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
