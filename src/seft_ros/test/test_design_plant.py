"""The plant in continuous time, sampled, and in the closed loop, against the blocks themselves."""

from dataclasses import replace

import numpy as np
import pytest
from bare_rig import BareRig
from experiments_at_hand import load
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.facts import FACTS
from seft_msgs_py.errors import InputError
from seft_plant_sim import lti
from seft_plant_sim.simulated.rig import continuous_model
from seft_ros.design.plant import (
    FOLDED,
    Plant,
    held_relations,
    lightly_damped,
    rig_model,
    roots_of,
)
from test_design_closed_loop import elsewhere

MASS, STIFFNESS = 52.7, 2.11e5


def plant_of(test):
    """Give the plant of a test, from valves to forces."""
    return Plant.of_model(*rig_model(test))


def experiment(axes=("x",), **changed):
    """Demo with other facts, or another truth where there is none; a double underscore is a dot."""
    named = {name.replace("__", "."): value for name, value in changed.items()}
    given = [
        ("/**", name, value) if name in FACTS else ("rig", f"simulated.{name}", value)
        for name, value in named.items()
    ]
    return load(*given, ("/**", "axes", list(axes)), config="demo")


def rig_forces(test, commands):
    """Actuator forces of the simulated rig, (N, n), when command k answers sample k."""
    rig = BareRig(continuous_model(test["rig"], test.axes), test.timebase.dt, linear=True)
    rig.reset()
    forces = []
    for command in commands:
        forces.append(rig.read()[3])
        rig.write(command)
    return np.array(forces)


@settings(max_examples=15, derandomize=True)
@given(st.floats(10.0, 500.0), st.floats(1.0, 30.0), st.floats(0.002, 0.4))
def test_the_zeros_of_the_plant_are_the_specimens_poles(mass, hz, damping):
    w = 2 * np.pi * hz
    values = {"mass": mass, "stiffness": mass * w**2, "damping": 2 * damping * w * mass}
    test = experiment(**{f"specimen__{name}": value for name, value in values.items()})
    zero = plant_of(test).antiresonance()
    assert zero.hz == pytest.approx(hz, rel=1e-4)
    assert zero.damping == pytest.approx(damping, rel=1e-3)


@pytest.mark.parametrize("oil_stiffness", [5e6, 1.664e7, 4e7])
def test_the_oil_column_is_the_spring_of_oil_and_specimen_under_the_mass(oil_stiffness):
    pole = plant_of(experiment(actuator__oil_stiffness=oil_stiffness)).oil_column()
    expected = np.sqrt((oil_stiffness + STIFFNESS) / MASS) / (2 * np.pi)
    assert pole.hz == pytest.approx(expected, rel=5e-3)
    assert 0 < pole.damping < 0.2


@pytest.mark.parametrize(("dead_time", "cutoff"), [(0.0, 0.0), (0.004, 80.0), (0.0071, 0.0)])
def test_the_sampled_response_is_the_rigs_own_pulse_response(dead_time, cutoff):
    test = experiment(
        actuator__dead_time=dead_time, sensors__force_filter=cutoff, actuator__leakage=2e3
    )
    dt, count = test.timebase.dt, 12000
    pulse = np.zeros((count, 1))
    pulse[0] = 1.0
    forces = rig_forces(test, pulse)[:, 0]
    f = np.array([1.0, 10.0, 30.0, 90.0, 180.0])
    spectrum = np.exp(-2j * np.pi * np.outer(f, np.arange(count) * dt)) @ forces
    found = plant_of(test).sampled_response(f, dt)
    assert found == pytest.approx(spectrum, rel=1e-6)


def test_a_plant_that_answers_at_once_is_sampled_with_the_step_of_latency_alone():
    f = np.array([10.0, 100.0])
    z = np.exp(2j * np.pi * f * 0.002)
    nothing = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))
    for dead_time, steps in ((0.0, 1), (0.001, 2)):
        plant = Plant("identified", *nothing, np.array([[5.0]]), dead_time, np.zeros(1))
        assert plant.sampled_response(f, 0.002) == pytest.approx(5.0 / z**steps)


def test_a_rig_elsewhere_is_what_is_known_of_it():
    """Not what the simulated one truly is."""
    test = experiment(actuator__dead_time=0.004)
    pinned = test.changed({"rig": {"simulated.actuator.dead_time": 0.001}})
    found = [plant_of(each) for each in (pinned, elsewhere(pinned))]
    assert [plant.source for plant in found] == ["rig", "identified"]
    assert [plant.delay for plant in found] == [0.001, 0.004]


def test_the_dead_time_of_several_axes_is_that_of_the_slowest():
    test = experiment(axes=("x", "y"), actuator__dead_time=[0.001, 0.004])
    assert plant_of(test).delay == 0.004


def test_coupled_axes_see_each_other_through_closed_valves():
    coupled = experiment(axes=("x", "y"), specimen__stiffness=[3e5, -1e5, -1e5, 3e5])
    apart = experiment(axes=("x", "y"), specimen__stiffness=3e5)
    zeros = [plant_of(test).axis(0).antiresonance().hz for test in (coupled, apart)]
    assert zeros[0] == pytest.approx(zeros[1], rel=0.01)  # the other end is all but clamped
    assert abs(zeros[0] / zeros[1] - 1) > 1e-6
    assert len(plant_of(coupled).axis(0).a) == 8  # all but the other valve's


def test_a_dead_time_of_many_samples_is_refused():
    plant = plant_of(experiment(actuator__dead_time=1.0))
    with pytest.raises(InputError, match="1000 samples"):
        plant.sampled(0.001)


def test_lightly_damped_are_the_pairs_that_show():
    values = [-1 + 100j, -1 - 100j, -90 + 100j, -90 - 100j, -50, 1 + 80j, 1 - 80j, 60j, -60j]
    found = lightly_damped(roots_of(values))
    assert [round(2 * np.pi * root.hz) for root in found] == [60, 100]
    assert found[0].damping == 0.0


@pytest.mark.parametrize("late", [0.0, 0.0022])
def test_what_held_commands_fold_down_is_that_of_the_sampled_plant(late):
    test = load("rate:=250.0", config="jhu")
    plant, dt = Plant.of_model(*rig_model(test), motion=True), test.timebase.dt
    lag, s = np.array([[0.0], [0.0], [late], [0.0]]), 2j * np.pi * np.array([3.0, 20.0])
    a, b, c = replace(plant, late=lag.ravel()).sampled(dt)
    shown = lti.state_space_response(a, b, c, np.zeros((4, 1)), np.exp(s * dt))[..., 0]
    x, v, acceleration, _ = (shown * np.exp(np.multiply.outer(s, lag[:, 0]))).T
    found, unsure = held_relations(plant, s.imag / (2 * np.pi), dt, lag, (0 * lag, 0 * lag))
    expected = np.stack([v / (s * x), acceleration / (s * s * x)], axis=1)
    np.testing.assert_allclose(found[..., 0], expected, rtol=0.0, atol=1e-6)
    filtered = held_relations(plant, s.imag / (2 * np.pi), dt, 0 * lag, (lag, 0.5 * lag**2))[0]
    least = FOLDED * np.abs(found - 1.0)
    np.testing.assert_allclose(unsure[:, :2], least + np.abs(found - filtered), rtol=1e-12)
    assert (unsure[:, :2] > least).any() == (late > 0.0)
    assert (unsure[:, 2] > 1e-3 * MASS).any() == (late > 0.0)
