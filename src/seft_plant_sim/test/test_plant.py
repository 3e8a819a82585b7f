"""The sampled plant against closed forms, and against an ODE solver that knows no sampling."""

import itertools

import numpy as np
import pytest
from bare_rig import BareRig
from scipy.integrate import solve_ivp
from seft_msgs_py.errors import InputError
from seft_plant_sim.actuator import Hydraulics
from seft_plant_sim.continuous_model import delayed_force, servo_hydraulic
from seft_plant_sim.specimen import Specimen

DT = 0.002
PAPER = Specimen(np.array([[52.7]]), np.array([[903.5]]), np.array([[2.11e5]]))
COUPLED = Specimen(
    np.array([[60.0, 5.0, 0.0], [5.0, 45.0, -3.0], [0.0, -3.0, 30.0]]),
    np.array([[900.0, -200.0, 0.0], [-200.0, 700.0, -100.0], [0.0, -100.0, 300.0]]),
    np.array([[3.0e5, -1.0e5, 0.0], [-1.0e5, 2.5e5, -0.8e5], [0.0, -0.8e5, 0.9e5]]),
)
HYDRAULIC = {
    "oil_stiffness": [1.664e7, 1.2e7, 2.0e7],
    "leakage": [20.0, 0.0, 35.0],
    "flow_gain": [0.038527, 0.05, 0.02],
    "valve_frequency": [60.0, 80.0, 45.0],
    "valve_damping": [0.7, 1.0, 0.5],
}
DELAYS = [0.0, 0.001, 0.0027, 0.010, 0.0113]


def hydraulic(specimen, dead_time):
    values = {name: np.array(row[: specimen.axes]) for name, row in HYDRAULIC.items()}
    unused = ("opening_limit", "force_capacity", "friction", "friction_velocity", "stroke")
    values |= {name: np.full(specimen.axes, np.inf) for name in unused}
    values["viscous_friction"] = np.zeros(specimen.axes)
    return servo_hydraulic(specimen, Hydraulics(**values, dead_time=dead_time), linear=True)


def run(plant, commands):
    """Samples of a plant, shape (N + 1, 4, n): sample k + 1 follows command k."""
    return np.array([plant.reset(), *(plant.step(command) for command in commands)])


def solved(specimen, commands, delay, valve):
    """The same by `solve_ivp`, from one change of the drive to the next.

    Command k acts from t[k + 1] + delay until the next does.
    """
    count, n = commands.shape
    mass, damping, stiffness = specimen.mass, specimen.damping, specimen.stiffness
    p = {name: np.array(row[:n]) for name, row in HYDRAULIC.items()}
    wv = 2 * np.pi * p["valve_frequency"]

    def acceleration(x, v, force):
        return np.linalg.solve(mass, force - damping @ v - stiffness @ x)

    def slope(_, z, u):
        if not valve:
            x, v = z.reshape(2, n)
            return np.concatenate([v, acceleration(x, v, u)])
        x, v, f, w, wdot = z.reshape(5, n)
        flow = p["oil_stiffness"] * (p["flow_gain"] * w - v) - p["leakage"] * f
        spool = wv * (wv * (u - w) - 2 * p["valve_damping"] * wdot)
        return np.concatenate([v, acceleration(x, v, f), flow, wdot, spool])

    changes = [(k + 1) * DT + delay for k in range(count)]
    samples = [k * DT for k in range(count + 1)]
    times = sorted({round(t, 12) for t in (*changes, *samples) if t <= samples[-1] + 1e-12})
    z, drive = np.zeros(n * (5 if valve else 2)), np.zeros(n)
    result = []
    for begin, end in itertools.pairwise([*times, None]):
        for k, change in enumerate(changes):
            if abs(change - begin) < 1e-9:
                drive = commands[k]
        if any(abs(begin - t) < 1e-9 for t in samples):
            force = z[2 * n : 3 * n] if valve else drive
            result.append([z[:n], z[n : 2 * n], acceleration(z[:n], z[n : 2 * n], force), force])
        if end is not None:
            z = solve_ivp(
                slope, (begin, end), z, "DOP853", args=(drive,), rtol=1e-11, atol=1e-13
            ).y[:, -1]
    return np.array(result)


@pytest.mark.parametrize("specimen", [PAPER, COUPLED], ids=["1 axis", "3 axes"])
@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("kind", ["delay", "servo_hydraulic"])
def test_samples_are_those_of_the_continuous_system(kind, delay, specimen):
    valve = kind == "servo_hydraulic"
    commands = np.random.default_rng(7).normal(size=(22, specimen.axes)) * (1 if valve else 1000)
    model = hydraulic(specimen, delay) if valve else delayed_force(specimen, delay)
    expected = solved(specimen, commands, delay, valve)
    scale = np.abs(expected).max(axis=(0, 2), keepdims=True)
    ours = run(BareRig(model, DT), commands)
    np.testing.assert_allclose(ours / scale, expected / scale, rtol=0, atol=1e-9)


@pytest.mark.parametrize("rate", [100.0, 512.0, 1000.0, 2000.0])
def test_a_delay_of_whole_samples_is_whole_at_any_rate(rate):
    dt = 1 / rate
    for steps in (1, 3, 29, 300):
        plant = BareRig(delayed_force(PAPER, steps * dt), dt)
        force = run(plant, np.arange(1.0, 400.0)[:, np.newaxis])[:, 3, 0]
        assert np.flatnonzero(force)[0] == 1 + steps


def test_a_sample_is_not_changed_by_later_steps_nor_by_the_command_array():
    plant = BareRig(hydraulic(PAPER, 0.001), DT)
    command = np.ones(1)
    sample = plant.step(command)
    kept = sample.copy()
    for _ in range(5):
        plant.step(np.full(1, 9.0))
    np.testing.assert_array_equal(sample, kept)
    with pytest.raises(InputError, match="a delay of 2001 s is 1000500 samples long"):
        BareRig(delayed_force(PAPER, 2001.0), DT)
