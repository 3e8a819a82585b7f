"""Limits of the nonlinear rig: small signals, full opening, the end of the stroke, any drive."""

import numpy as np
import pytest
from bare_rig import BareRig, driven, rig_section
from seft_msgs_py.errors import InputError
from seft_plant_sim.simulated.rig import continuous_model

DT = 0.002
NOISE = np.random.default_rng(3).normal(size=(250, 1))
CAPACITY = 24500.0


def plant(axes=("x",), **values):
    """Plant of the table's defaults but for friction; a double underscore stands for a dot."""
    own = {"specimen__damping": 903.5, "actuator__friction": 0.0}
    own |= {"actuator__force_capacity": CAPACITY} | values
    return BareRig(continuous_model(rig_section(**own), axes), DT)


def run(one, commands):
    """Samples, shape (N + 1, 4, n), and what was named as saturated."""
    return driven(one, commands)[:, :4], set(one.saturation)


def difference(amplitude, **values):
    """Largest difference of each quantity between nonlinear and linear, relative to its peak."""
    nonlinear = run(plant(**values), amplitude * NOISE)[0]
    linear = run(plant(actuator__kind="servo_hydraulic_linear", **values), amplitude * NOISE)[0]
    return (np.abs(nonlinear - linear).max(axis=0) / np.abs(linear).max(axis=0)).ravel()


def test_a_small_drive_sees_the_linear_rig():
    """The difference falls with the square of the amplitude, as of the root of the pressure."""
    small, large = difference(1e-3), difference(1e-1)
    np.testing.assert_allclose(large / small, 100.0, rtol=0.02)
    assert difference(1e-5).max() < 1e-6


@pytest.mark.parametrize("leakage", [0.0, 20.0])
def test_a_fully_open_valve_stalls_at_the_force_capacity(leakage):
    """Against a specimen that the stroke does not end before."""
    values = {"specimen__stiffness": 2e6, "actuator__leakage": leakage}
    samples, names = run(plant(**values), np.full((1500, 1), 10.0))
    force = samples[:, 3, 0]
    assert np.abs(force).max() <= 1.01 * CAPACITY
    assert force[-1] > 0.99 * CAPACITY
    assert samples[-1, 0, 0] == pytest.approx(force[-1] / 2e6, rel=5e-3)
    assert "valve" in names
    assert "stroke" not in names
    back, _ = run(plant(**values), np.full((1500, 1), -10.0))
    np.testing.assert_array_equal(back, -samples)


def test_a_load_that_is_stronger_than_the_pressure_is_named():
    """What swings on drives the piston against the oil."""
    slow = np.repeat([[10.0], [-10.0], [10.0], [-10.0]], 20, axis=0)
    values = {"actuator__force_capacity": 500.0, "specimen__mass": 2000.0}
    _, names = run(plant(**values), slow)
    assert "force_capacity" in names


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_stroke_ends_at_the_stops(sign):
    samples, names = run(plant(), np.full((1500, 1), sign * 10.0))
    x = sign * samples[:, 0, 0]
    assert np.isfinite(samples).all()
    assert 0.076 < x[-1] < 0.077
    assert x.max() < 0.077
    assert np.abs(samples[-1, 1]).max() < 1e-3  # and rests there
    assert names >= {"stroke", "valve"}


@pytest.mark.parametrize("drive", [1e3, 1e9, 1e15])
def test_no_drive_gives_what_is_no_number(drive):
    turns = drive * np.sign(np.sin(np.arange(600) / 50.0))[:, np.newaxis]
    for values in ({}, {"actuator__friction": 300.0, "sensors__force_filter": 100.0}):
        assert np.isfinite(run(plant(**values), turns)[0]).all()
    yields = {"specimen__kind": "bouc_wen", "specimen__yield_displacement": 0.002}
    assert np.isfinite(run(plant(**yields), turns)[0]).all()


def test_what_is_too_fast_to_be_followed_is_refused():
    message = "friction, end stops or springs answer at .* raise actuator.friction_velocity"
    with pytest.raises(InputError, match=message):
        plant(actuator__friction=500.0, actuator__friction_velocity=1e-6)
