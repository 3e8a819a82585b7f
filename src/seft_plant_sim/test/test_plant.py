"""The sampled plant: its delay, and its samples.

Against an ODE solver: test_nonlinear_plant_by_hand.py; a small drive sees the linear rig.
"""

from dataclasses import replace

import numpy as np
import pytest
from bare_rig import BareRig, driven, make_rig, rig_section
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_plant_sim.lti import TransferFunction, state_space_response
from seft_plant_sim.simulated.actuator import Hydraulics, InnerLoop
from seft_plant_sim.simulated.continuous_model import (
    delayed_force,
    imposed_motion,
    servo_hydraulic,
    with_inner_loop,
)
from seft_plant_sim.simulated.specimen import Specimen

PAPER = Specimen(np.array([[52.7]]), np.array([[903.5]]), np.array([[2.11e5]]))


@pytest.mark.parametrize("rate", [100.0, 512.0, 1000.0, 2000.0])
def test_a_delay_of_whole_samples_is_whole_at_any_rate(rate):
    dt = 1 / rate
    for steps in (1, 3, 29, 300):
        plant = BareRig(delayed_force(PAPER, steps * dt), dt)
        force = driven(plant, np.arange(1.0, 400.0))[1:, 3, 0]
        assert np.flatnonzero(force)[0] == steps


def test_a_sample_is_not_changed_by_later_steps_nor_by_the_command_array():
    plant = BareRig(delayed_force(PAPER, 0.0), 0.002)
    command = np.ones(1)
    plant.read()
    plant.write(command)
    command[:] = 9.0
    sample = plant.read()
    kept = sample.copy()
    assert sample[3, 0] == 1.0
    for _ in range(5):
        plant.write(command)
        plant.read()
    np.testing.assert_array_equal(sample, kept)
    with pytest.raises(InputError, match="a delay of 2001 s is 1000500 samples long"):
        BareRig(delayed_force(PAPER, 2001.0), 0.002)


@pytest.mark.parametrize(
    ("kind", "times"),
    [
        ("servo_hydraulic", [0.002, 0.006]),
        ("servo_hydraulic", [0.003, 0.0]),
        ("servo_hydraulic_linear", [0.0013, 0.0055]),
        ("servo_hydraulic_linear", [0.0, 0.31]),
    ],
)
def test_each_axis_has_its_own_dead_time(kind, times):
    """Two that are not coupled do what each does alone, to rounding."""
    commands = np.random.default_rng(6).normal(size=(300, 2))
    values = {"actuator__kind": kind, "actuator__friction": 10.0, "sensors__force_lag": 0.003}
    both = driven(make_rig(("x", "y"), actuator__dead_time=times, **values), commands)
    for axis, time in enumerate(times):
        alone = driven(make_rig(actuator__dead_time=time, **values), commands[:, axis])[..., 0]
        scale = np.abs(alone).max(axis=0)
        np.testing.assert_allclose(both[..., axis] / scale, alone / scale, rtol=0.0, atol=1e-12)


def test_an_imposed_motion_has_its_response_and_the_specimens_force():
    """Two axes of unlike order, coupled by mass, damping and stiffness."""
    specimen = Specimen(
        np.array([[50.0, 5.0], [5.0, 40.0]]),
        np.array([[900.0, -200.0], [-200.0, 300.0]]),
        np.array([[2e5, -5e4], [-5e4, 1e5]]),
    )
    servos = (
        TransferFunction((4e4, 8e6), (2.0, 600.0, 1.6e5, 8e6), 0.002),
        TransferFunction((2.4e5,), (1.0, 20.0, 2.5e5), 0.001),
    )
    model, f = imposed_motion(specimen, servos, np.ones(2)), np.geomspace(0.1, 300.0, 40)
    s = 2j * np.pi * f
    found = state_space_response(model.a, model.b, model.c, model.d, s).reshape(-1, 4, 2, 2)
    motion = np.zeros((len(f), 2, 2), dtype=np.complex128)
    for i, servo in enumerate(servos):
        motion[:, i, i] = replace(servo, dead_time=0.0).response(f)
    by = s[:, np.newaxis, np.newaxis]
    stiffness = specimen.mass * by**2 + specimen.damping * by + specimen.stiffness
    wanted = np.stack([motion, by * motion, by**2 * motion, stiffness @ motion], axis=1)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-12)
    assert model.delay.tolist() == [0.002, 0.001]
    with pytest.raises(InputError, match="two poles more than zeros"):
        imposed_motion(specimen, (servos[0], TransferFunction((1.0,), (1.0, 1.0))), np.ones(2))


# ---- What the actuator is, by hand after Merritt (1967)


def hydraulics(axes=("x",), **values):
    section = rig_section("actuator.", **values)
    return Hydraulics.from_parameters(group(section, "simulated.actuator"), axes)


@pytest.mark.parametrize("term", ["proportional", "integral", "derivative", "delta_p"])
def test_the_inner_loop_closes_the_valve_by_each_of_its_terms(term):
    terms = {"proportional": 800.0, "integral": 0.0, "derivative": 0.0, "delta_p": 0.0}
    terms |= {term: {"proportional": 2000.0, "delta_p": 1e-4}.get(term, 300.0)}
    given = {name: np.array([value]) for name, value in terms.items()}
    loop = InnerLoop(gain=np.array([0.9]), derivative_filter=np.array([40.0]), **given)
    valve = servo_hydraulic(PAPER, hydraulics(), linear=True)
    closed = with_inner_loop(valve, loop, np.ones(1))
    s, w = 2j * np.pi * np.array([1.0, 8.0, 30.0]), 2 * np.pi * 40.0
    every = np.eye(len(valve.a))
    x, _, p = state_space_response(valve.a, valve.b, every, 0.0 * valve.b, s)[:, :3, 0].T
    of_error = terms["proportional"] + terms["integral"] / s + terms["derivative"] * s * w / (s + w)
    wanted = x * of_error * 0.9 / (1.0 + x * of_error + p * terms["delta_p"])
    none = np.zeros((len(closed.c), 1))
    found = state_space_response(closed.a, closed.b, closed.c, none, s)[:, 0, 0]
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_the_oil_column_resonates_with_actuator_and_specimen():
    """Mass on oil and specimen's spring together: the paper's 90 Hz, exactly if undamped."""
    undamped = Specimen(np.array([[52.7]]), np.zeros((1, 1)), np.array([[2.11e5]]))
    oil = 52.7 * (2 * np.pi * 90) ** 2 - 2.11e5
    closed = hydraulics(oil_stiffness=oil, leakage=0.0)
    poles = np.linalg.eigvals(servo_hydraulic(undamped, closed, linear=True).a)
    (hz,) = {round(p.imag / (2 * np.pi), 6) for p in poles if p.imag > 2 * np.pi * 80}
    assert hz == pytest.approx(90.0, abs=1e-5)
