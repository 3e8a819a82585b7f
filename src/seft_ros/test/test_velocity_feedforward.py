"""The valve's model and its inverse, and the controller that uses them."""

import math

import numpy as np
import pytest
from experiments_at_hand import load
from scipy.integrate import solve_ivp
from seft_msgs_py.errors import InputError
from seft_plant_sim.judge.valve_model import ValveModel
from seft_ros.force_controller.oil_column import crossover
from seft_ros.force_controller.velocity_feedforward import (
    DELAY_ERROR,
    GAIN_ERROR,
    VelocityFeedforward,
    feedforward_step,
)

DT = 0.002
valves = pytest.mark.parametrize(
    ("frequency", "damping", "dead_time"),
    [(70, 0.6, 0.001), (30, 0.6, 0.001), (120, 1.0, 0.0), (60, 1.2, 0.0035)],
)


def solved(frequency, damping, dead_time, time):
    """Flow of a command of one period, by an ODE solver."""
    w, late = 2 * math.pi * frequency, DT + dead_time

    def slope(t, z):
        u = 1.0 if late <= t < late + DT else 0.0
        return [z[1], w * w * (u - z[0]) - 2 * damping * w * z[1]]

    found = solve_ivp(slope, (0, time[-1]), [0, 0], t_eval=time, max_step=1e-4, rtol=1e-8)
    return found.y[0]


@valves
def test_flow_of_a_command_is_that_of_the_differential_equation(frequency, damping, dead_time):
    time = np.linspace(0.0, 0.05, 101)
    model = ValveModel(frequency, damping, dead_time, DT)
    assert model.flow(time) == pytest.approx(solved(frequency, damping, dead_time, time), abs=0.01)


def to_come(model):
    """Part of the flow of past commands that is still to come, the newest first."""
    return 1.0 - model.volume(DT * np.arange(1.0, model.memory + 1)) / DT


@valves
def test_a_command_makes_one_periods_volume(frequency, damping, dead_time):
    model = ValveModel(frequency, damping, dead_time, DT)
    assert model.volume(np.array([1.0]))[0] == pytest.approx(DT, rel=1e-9)
    left = to_come(model)
    assert left[0] <= 1.0 + 1e-12
    assert abs(left[-1]) < 0.02
    # what is under way of a steady flow is the flow times the mean delay, less what is to be sent
    assert DT * left.sum() == pytest.approx(model.delay - DT / 2, abs=0.02 * model.delay)


@pytest.mark.parametrize("dt", [0.004, 0.002, 0.00025])
@valves
def test_inverse_makes_the_wanted_flow(frequency, damping, dead_time, dt):
    """Flows are means over periods; with future flows alone 2 % would be left at 4000 Hz."""
    model = ValveModel(frequency, damping, dead_time, dt)
    before = model.past()
    h, past = model.inverse(model.taps(), before), model.last_period()[0]
    t = dt * np.arange(6 * (len(h) + len(past)))
    wanted = np.sin(2 * np.pi * 6 * t) + 0.3 * np.sin(2 * np.pi * 13 * t)
    command = np.convolve(wanted, h[::-1], mode="valid")  # the first answers sample ``before``
    made = np.convolve(command, past, mode="valid")  # the first is the period before the next one
    first = before + len(past) - 1
    error = made - wanted[first : first + len(made)]
    assert np.sqrt(np.mean(error**2) / np.mean(wanted**2)) < 0.006


def controller(*args, **valve):
    made = feedforward(*args, **valve)
    return made.parameters, made.state


def feedforward(known_gain=1.0, limit=10.0, horizon=25, velocity="measured", **valve):
    """Controller of a free piston, whose oil is stiff because it moves no mass."""
    given = {"sensors.velocity": velocity, "limits.command": limit, "specimen.mass": 1e-6}
    valve = {"flow_gain": 0.04 * known_gain} | valve
    given |= {f"actuator.{name}": value for name, value in valve.items()}
    words = [("/**", *item) for item in given.items()]
    words.append(("reference_force", "compensation.horizon", horizon * DT))
    test = load(*words, config="demo")
    return VelocityFeedforward(test["force_controller"], test.axes, test.timebase)


def drive_piston(arrays, steps=3000, gain=0.04, offset=0.0):
    """Let a free piston follow a swinging target; give target and motion."""
    parameters, state = arrays
    valve = ValveModel(70.0, 0.6, 0.001, DT)
    fine = 20
    weights = [valve.flow(DT * (np.arange(1, 12) - 1 + (i + 0.5) / fine)) for i in range(fine)]
    t = DT * np.arange(steps + 30)
    wanted = np.array([0.004 * np.sin(30 * t), 0.12 * np.cos(30 * t), np.zeros_like(t)])
    wanted[0] += 0.004 * (1 - np.exp(-t)) * np.sin(17 * t)
    wanted[1] = np.gradient(wanted[0], DT)
    sent, x, v = np.zeros(11), wanted[0, 0] + offset, wanted[1, 0]
    command, seen = np.zeros(1), []
    for k in range(steps):
        points = np.ascontiguousarray(wanted[:, k : k + 26].T[:, :, np.newaxis])
        a = (wanted[1, k + 1] - wanted[1, k]) / DT
        feedforward_step(parameters, state, points, np.array([[x], [v], [a], [0.0]]), command)
        seen.append(x)
        sent = np.concatenate([command, sent[:-1]])
        # in the coming period, the command that was just found does not act yet
        for part in weights:
            x += gain * (part @ sent) * DT / fine
        v = gain * (valve.flow(DT * np.arange(1, 12)) @ sent)
    return wanted[0, :steps], np.array(seen)


def test_piston_follows_the_target():
    wanted, seen = drive_piston(controller())
    assert np.sqrt(np.mean((seen - wanted)[500:] ** 2) / np.mean(wanted**2)) < 0.01


def test_error_dies_out_at_the_rate_of_the_feedback():
    arrays = controller()
    rate = arrays[0].feedback[0, 0, 0]
    assert rate == pytest.approx(crossover([ValveModel(70.0, 0.6, 0.001, DT)])[0], rel=0.1)
    wanted, seen = drive_piston(arrays, steps=200, offset=1e-3)
    reference, follows = drive_piston(controller(), steps=200)
    off = (seen - wanted) - (follows - reference)
    after = round(0.006 / DT) + round(1 / rate / DT)
    assert off[after] == pytest.approx(1e-3 * math.exp(-1), abs=2e-4)


@pytest.mark.parametrize("velocity", ["measured", "derived"])
@pytest.mark.parametrize("known_gain", [0.85, 1.15])
def test_flow_gain_is_followed(known_gain, velocity):
    arrays = controller(known_gain, velocity=velocity)
    wanted, seen = drive_piston(arrays)
    assert known_gain * (1 + arrays[1].errors[0, GAIN_ERROR]) == pytest.approx(1.0, abs=0.02)
    assert np.sqrt(np.mean((seen - wanted)[2000:] ** 2) / np.mean(wanted**2)) < 0.01


@pytest.mark.parametrize("dead_time", [0.0, 0.0025])
def test_delay_is_followed(dead_time):
    arrays = controller(dead_time=dead_time)
    drive_piston(arrays)
    assert dead_time + arrays[1].errors[0, DELAY_ERROR] == pytest.approx(0.001, abs=2e-4)


def test_drive_stays_within_the_limit_and_says_so():
    parameters, state = controller(limit=1.0)
    points, command = np.zeros((26, 3, 1)), np.zeros(1)
    assert not feedforward_step(parameters, state, points, np.zeros((4, 1)), command)
    points[:, 0, 0] = 0.3 * DT * np.arange(26)
    assert feedforward_step(parameters, state, points, np.zeros((4, 1)), command)
    assert command[0] == 1.0


def test_a_loaded_valve_opens_further():
    points = np.zeros((26, 3, 1))
    points[:, 0, 0], points[:, 1] = 0.05 * DT * np.arange(26), 0.05
    drives = []
    for force in (0.0, 12000.0):
        parameters, state = controller()
        points[:, 2], command = force, np.zeros(1)
        measured = np.array([[0.0], [0.05], [0.0], [force]])
        feedforward_step(parameters, state, points, measured, command)
        drives.append(command[0])
    leakage = 1 + 50.0 * 12000.0 / 1.66e7 / 0.05
    assert drives[1] / drives[0] == pytest.approx(leakage / math.sqrt(1 - 12 / 24.5), rel=0.02)


def test_the_friction_of_a_piston_presses_the_oil_like_a_force():
    velocity = 0.03 * np.cos(60.0 * DT * np.arange(26))
    points = np.zeros((26, 3, 1))
    points[:, 0, 0], points[:, 1, 0] = DT * np.cumsum(velocity), velocity
    drives = []
    for force, friction in ((0.0, 200.0), (200.0 * np.tanh(velocity / 0.01), 0.0)):
        parameters, state = controller(friction=friction, friction_velocity=0.01)
        points[:, 2, 0], command = force, np.zeros(1)
        measured = np.array([points[0, 0], points[0, 1], [0.0], points[0, 2]])
        feedforward_step(parameters, state, points, measured, command)
        drives.append(command[0])
    assert drives[0] == pytest.approx(drives[1], rel=1e-9)


def test_horizon_that_is_too_short_is_refused():
    with pytest.raises(InputError, match=r"horizon is 0\.02 s, .* make it longer"):
        controller(horizon=10)


def test_a_stop_brings_the_piston_to_the_end_of_the_slowed_plan():
    one, speed, plan = feedforward(), 0.1, np.zeros((26, 3, 1))
    plan[:, 1] = speed
    for step in range(500):
        plan[:, 0, 0] = speed * DT * (step + np.arange(26))
        one.step(plan, np.array([plan[0, 0], [speed], [0.0], [0.0]]))
    before = [each.copy() for each in one.state]
    commands = one.stop(plan)
    for each, other in zip(one.state, before, strict=True):
        np.testing.assert_array_equal(each, other)
    valve = ValveModel(70.0, 0.6, 0.001, DT)
    volume = DT * (to_come(valve) @ one.state.sent[0] + commands.sum())
    assert 0.04 * volume == pytest.approx(speed * (0.05 - DT), rel=0.02)  # after the next sample
    assert abs(commands[-1, 0]) < 0.02 * speed / 0.04
