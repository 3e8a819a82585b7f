"""Nonlinear rigs against their equations of motion, written out anew for an ODE solver.

Each law by itself: test_springs.py, test_bouc_wen.py; in a rig: test_energy_balance.py.

The solver knows no exponentials and no residuals; it goes from one change of the drive to the
next with tight tolerances.
"""

import itertools

import numpy as np
import pytest
from bare_rig import FRAME, BareRig, driven, rig_section
from scipy.integrate import solve_ivp
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.simulated.actuator import STOP_DAMPING, STOP_STIFFNESS
from seft_plant_sim.simulated.rig import continuous_model

DT = 0.002
COUNT = 150
SERVO = {
    "oil_stiffness": 1.664e7,
    "leakage": 20.0,
    "flow_gain": 0.038527,
    "valve_frequency": 60.0,
    "valve_damping": 0.7,
    "rated_voltage": 10.0,
    "force_capacity": 24500.0,
    "friction": 30.0,
    "friction_velocity": 0.01,
    "viscous_friction": 50.0,
    "stroke": 0.076,
    "dead_time": 0.0013,
}
ONE = {"mass": 52.7, "damping": 903.5, "stiffness": 2.11e5}
TOLERANCE = {"sine": 1e-3, "noise": 1.5e-3}  # of the peak; noise fills the band to 250 Hz
STOREYS = ([1.8e5, 1.5e5], [[1.0, 0.0], [-1.0, 1.0]])
YIELD = {"yield_displacement": 0.001, "hardening_ratio": 0.1}
SMOOTH = {"bouc_wen.exponent": 1.7, "bouc_wen.beta": 0.7, "bouc_wen.gamma": 0.3}


def sampled(specimen, actuator, commands, cutoff=0.0):
    """Samples of our plant, shape (N + 1, 4, n): sample k + 1 follows command k."""
    values = {f"specimen.{name}": value for name, value in specimen.items()}
    values |= {f"actuator.{name}": value for name, value in actuator.items()}
    values |= {f"sensors.{channel}_filter": cutoff for channel in CHANNELS}
    section = rig_section(**values)
    plant = BareRig(continuous_model(section, ("x", "y")[: commands.shape[1]]), DT)
    return driven(plant, commands)[:, :4]


def valve_flow(w, p, h):
    """w sqrt(1 - sgn(w) p / F_s) within the valve's opening; back where the load is stronger."""
    w = np.clip(w, -h["rated_voltage"], h["rated_voltage"])
    left = 1 - np.sign(w) * p / h["force_capacity"]
    return w * np.sign(left) * np.sqrt(np.abs(left))


def held_back(x, v, h):
    """Friction, and stops that push only."""
    stop = STOP_STIFFNESS * h["oil_stiffness"]
    force = h["friction"] * np.tanh(v / h["friction_velocity"]) + h["viscous_friction"] * v
    contact = stop * (np.abs(x) - h["stroke"]) * (1 + STOP_DAMPING * v * np.sign(x))
    return force + np.where(np.abs(x) > h["stroke"], np.sign(x) * np.maximum(contact, 0), 0)


def hysteresis(kind, z, v, s):
    """Rate of z."""
    y = s["yield_displacement"]
    if kind == "bilinear":
        return np.where((z >= y) & (v > 0) | (z <= -y) & (v < 0), 0.0, v)
    n, beta, gamma = (s[f"bouc_wen.{name}"] for name in ("exponent", "beta", "gamma"))
    power = np.abs(z / y) ** n
    return v - beta * np.abs(v) * power * np.sign(z) - gamma * v * power


def solved(specimen, actuator, commands, cutoff=0.0):
    """The same samples by `solve_ivp`."""
    count, n = commands.shape
    valve = "delay" not in actuator
    h, kind = actuator, specimen.get("kind", "linear")
    mass = np.diag(np.atleast_1d(specimen["mass"]))
    damping = np.reshape(specimen["damping"], (n, n))
    stiffness = np.reshape(specimen["stiffness"], (n, n))
    k, d = STOREYS if n == 2 else ([2.11e5], [[1.0]])
    k, d = np.array(k), np.array(d)
    sizes = [n, n, n, n, n, len(k), 4 * n, 4 * n]
    ends = np.cumsum(sizes)[:-1]

    def outputs(x, v, p, z, u):
        force = p - held_back(x, v, h) if valve else u
        restoring = stiffness @ x
        if kind != "linear":
            a = specimen["hardening_ratio"]
            restoring = d.T @ (k * (a * (d @ x) + (1 - a) * z))
        acceleration = np.linalg.solve(mass, force - damping @ v - restoring)
        return np.concatenate([x, v, acceleration, force])

    def slope(_, state, u):
        x, v, p, w, opening_rate, z, y, y_rate = np.split(state, ends)
        truth = outputs(x, v, p, z, u)
        rates = [v, truth[2 * n : 3 * n], *np.zeros((3, n))]
        if valve:
            wv = 2 * np.pi * h["valve_frequency"]
            flow = h["flow_gain"] * valve_flow(w, p, h) - v
            rates[2] = h["oil_stiffness"] * flow - h["leakage"] * p
            rates[3:] = opening_rate, wv**2 * (u - w) - 2 * h["valve_damping"] * wv * opening_rate
        plastic = 0.0 * z if kind == "linear" else hysteresis(kind, z, d @ v, specimen)
        wc = 2 * np.pi * cutoff
        filtered = [y_rate, wc**2 * (truth - y) - np.sqrt(2) * wc * y_rate]
        return np.concatenate([*rates, plastic, *filtered])

    delay = actuator["dead_time"] if valve else actuator["delay"]
    if valve:
        commands = np.clip(commands, -h["rated_voltage"], h["rated_voltage"])
    changes = {round((i + 1) * DT + delay, 9): command for i, command in enumerate(commands)}
    samples = {round(i * DT, 9) for i in range(count + 1)}
    times = sorted(t for t in samples | set(changes) if t <= count * DT + 1e-9)
    state, u, result = np.zeros(sum(sizes)), np.zeros(n), []
    for begin, end in itertools.pairwise([*times, None]):
        u = changes.get(begin, u)
        if begin in samples:
            x, v, p, _, _, z, y, _ = np.split(state, ends)
            result.append(y if cutoff else outputs(x, v, p, z, u))
        if end is not None:
            how = {"method": "DOP853", "rtol": 1e-7, "atol": 1e-10}
            state = solve_ivp(slope, (begin, end), state, args=(u,), **how).y[:, -1]
    return np.reshape(result, (count + 1, 4, n))


def drive(name, axes, amplitude):
    time = DT * np.arange(COUNT)[:, np.newaxis]
    if name == "sine":
        return amplitude * np.sin(2 * np.pi * 6.0 * time + np.arange(axes))
    rng = np.random.default_rng(11)
    return amplitude * rng.normal(size=(COUNT, axes))


def error(specimen, actuator, commands, expected=None, cutoff=0.0):
    """Largest error of any quantity, relative to its peak."""
    ours = sampled(specimen, actuator, commands, cutoff)
    if expected is None:
        expected = solved(specimen, actuator, commands, cutoff)
    return (np.abs(ours - expected) / np.abs(expected).max(axis=0)).max()


@pytest.mark.parametrize(
    ("name", "amplitude", "dead_time"), [("sine", 8.0, 0.004), ("noise", 2.0, 0.0013)]
)
def test_actuator_with_valve_flow_and_friction(name, amplitude, dead_time):
    actuator, commands = SERVO | {"dead_time": dead_time}, drive(name, 1, amplitude)
    expected = solved(ONE, actuator, commands)
    assert error(ONE, actuator, commands, expected) < TOLERANCE[name]
    linear = sampled(ONE, actuator | {"kind": "servo_hydraulic_linear"}, commands)
    assert np.abs(linear - expected)[:, 3].max() > 0.05 * np.abs(expected[:, 3]).max()


def test_end_stops_push_and_do_not_pull():
    actuator, commands = SERVO | {"stroke": 0.003}, drive("sine", 1, 6.0)
    expected = solved(ONE, actuator, commands)
    difference = sampled(ONE, actuator, commands) - expected
    peak = np.abs(expected).max(axis=0)
    assert peak[0] > actuator["stroke"]
    assert (np.abs(difference).max(axis=0) < 0.05 * peak).all()
    assert (np.sqrt(np.mean(difference**2, axis=0)) < 0.01 * peak).all()


def test_two_actuators_on_a_shear_frame_whose_storeys_yield():
    specimen = FRAME | {"kind": "bouc_wen"} | SMOOTH | YIELD
    ideal = {"kind": "ideal", "delay": 0.0}
    cases = (SERVO, drive("sine", 2, 4.0)), (ideal, drive("noise", 2, 2500.0))
    for actuator, commands in cases:
        expected = solved(specimen, actuator, commands)
        storeys = np.abs(expected[:, 0] @ np.array(STOREYS[1]).T).max(axis=0)
        assert (storeys > 1.5 * YIELD["yield_displacement"]).all()
        assert error(specimen, actuator, commands, expected) < 1e-3


def test_the_filters_see_what_is_not_linear_too():
    specimen = ONE | {"kind": "bilinear"} | YIELD
    assert error(specimen, SERVO, drive("noise", 1, 2.0), cutoff=100.0) < TOLERANCE["noise"]
