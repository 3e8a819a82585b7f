import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import read_parameter_file
from seft_msgs_py.errors import InputError
from seft_ros.design.controller import (
    Controller,
    Root,
    given_controller,
    lightly_damped,
    roots_of,
    write_controller,
)

HZ = st.floats(0.1, 200.0)


def test_the_papers_controller_is_a_pole_pair_on_the_specimens_frequency():
    controller = given_controller("37", "1 17.14, 4002")
    (pole,) = controller.poles
    assert controller.gain == 37.0
    assert controller.zeros == []
    assert pole.hz == pytest.approx(10.07, abs=0.005)
    assert pole.damping == pytest.approx(0.1355, abs=1e-4)
    again = Controller.from_roots([], [pole])
    assert again.denominator == pytest.approx(controller.denominator)


@settings(max_examples=50, derandomize=True)
@given(HZ, st.floats(0.0, 0.95), HZ, st.floats(-1e3, 1e3).filter(lambda g: abs(g) > 1e-3))
def test_factors_and_coefficients_say_the_same(pair_hz, damping, real_hz, gain):
    poles = [Root(pair_hz, damping), Root(0.0)]
    controller = Controller.from_roots([Root(real_hz)], poles).scaled(gain)
    assert controller.gain == pytest.approx(gain)
    (zero,) = controller.zeros
    assert (zero.hz, zero.damping) == (pytest.approx(real_hz), None)
    integrator, pair = controller.poles
    assert (integrator.hz, integrator.damping) == (pytest.approx(0.0, abs=1e-9), None)
    assert (pair.hz, pair.damping) == (pytest.approx(pair_hz), pytest.approx(damping, abs=1e-9))
    f = np.array([0.7, 33.0])
    s, w = 2j * np.pi * f, 2 * np.pi * pair_hz
    exact = gain * (s + 2 * np.pi * real_hz) / (s * (s**2 + 2 * damping * w * s + w**2))
    assert controller.response(f) == pytest.approx(exact, rel=1e-9)


def test_the_gain_is_that_of_the_factored_form():
    assert Controller.from_coefficients([0.0, 3.0, 1.0], [2.0, 1.0, 5.0]).gain == 1.5


def test_an_unstable_real_pole_has_a_negative_frequency():
    (root,) = roots_of([2 * np.pi])
    assert (root.hz, root.damping) == (pytest.approx(-1.0), None)


def test_lightly_damped_are_the_pairs_that_show():
    values = [-1 + 100j, -1 - 100j, -90 + 100j, -90 - 100j, -50, 1 + 80j, 1 - 80j, 60j, -60j]
    found = lightly_damped(roots_of(values))
    assert [round(2 * np.pi * root.hz) for root in found] == [60, 100]
    assert found[0].damping == 0.0


def test_discretised_it_is_its_response_at_the_warped_frequency():
    controller = Controller.from_coefficients(37.0, [1.0, 17.14, 4002.0])
    dt, f = 0.002, np.array([1.0, 10.0, 90.0, 240.0])
    warped = np.tan(np.pi * f * dt) / (np.pi * dt)
    assert controller.sampled_response(f, dt) == pytest.approx(controller.response(warped))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("1", None), "go together"),
        (("1", "one 2"), "--denominator"),
        (("", "1"), "--numerator"),
        (("inf", "1"), "--numerator"),
        (("1", "nan"), "--denominator"),
        (("0", "1"), "numerator is zero"),
        (("1", "0 0"), "denominator is zero"),
    ],
)
def test_a_controller_that_makes_no_sense_is_told(options, told):
    with pytest.raises(InputError, match=told):
        given_controller(*options)


def test_no_options_give_no_controller():
    assert given_controller(None, None) is None


def test_a_written_controller_is_read_back_to_the_last_bit(tmp_path):
    controller = Controller.from_coefficients([1 / 3, 1e22], [1.0, 2.0 / 7, 1e-9])
    write_controller(controller, tmp_path / "controller.yaml")
    section = read_parameter_file(tmp_path / "controller.yaml")["force_controller"]
    assert tuple(section["numerator"]) == controller.numerator
    assert tuple(section["denominator"]) == controller.denominator
    with pytest.raises(InputError, match="exists already"):
        write_controller(controller, tmp_path / "controller.yaml")
