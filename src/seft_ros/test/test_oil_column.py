"""The regulator of oil columns: its model of the rig, its gains, and the loop that it makes."""

import itertools
import math

import numpy as np
import pytest
from scipy.linalg import expm
from seft_msgs_py.errors import InputError
from seft_plant_sim.judge.valve_model import ValveModel
from seft_ros.force_controller.oil_column import crossover, regulator

OIL = 1.664e7
LEAKAGE = 50.0


def valve(dt, frequency=70.0, damping=0.6, dead_time=0.001):
    return ValveModel(frequency, damping, dead_time, dt)


def gains_of(valves, mass, stiffness, dt, oil=OIL):
    n = len(valves)
    known = np.column_stack([np.full(n, oil), np.full(n, LEAKAGE)])
    memory = max(one.memory for one in valves)
    return regulator(valves, known, np.array(mass), np.array(stiffness), memory, dt)


def deviations(valves, mass, stiffness, dt, seconds, start, known=1.0, on=1.0):
    """Deviations of x that the regulator brings back, by matrix exponentials, shape (N, n).

    It knows so much of the stiffness. ``start`` are those of x, or all of x, v and c.
    """
    n, mass, stiffness = len(valves), np.array(mass), np.array(stiffness)
    gains, sent = gains_of(valves, mass, known * stiffness, dt)
    gains, sent = on * gains, on * sent
    memory, inverse = sent.shape[2], np.linalg.inv(mass)
    natural, damping, late = (
        np.array([getattr(one, name) for one in valves]) for name in ("natural", "damping", "late")
    )
    one, nothing, squares = np.eye(n), np.zeros((n, n)), np.diag(natural**2)
    slopes = np.block(  # of x, v, c, the valve's opening, its rate, and what acts
        [
            [nothing, one, *[nothing] * 4],
            [-inverse @ stiffness, nothing, OIL * inverse, *[nothing] * 3],
            [nothing, -one, -LEAKAGE * one, one, *[nothing] * 2],
            [*[nothing] * 4, one, nothing],
            [*[nothing] * 3, -squares, -np.diag(2 * damping * natural), squares],
            [*[nothing] * 6],
        ]
    )
    # a command acts from ``late`` after its sample on: between two samples it changes once
    whole = (late / dt + 1e-9).astype(int)
    remainder = late - whole * dt
    pieces = [
        (whole + (begin < remainder - 1e-12), expm(slopes * (end - begin)))
        for begin, end in itertools.pairwise(np.unique([0.0, *remainder.tolist(), dt]))
    ]
    state = np.concatenate([start, np.zeros(6 * n - len(start))])
    commands, found = np.zeros((n, memory)), []
    for _ in range(round(seconds / dt)):
        x, v, c, *_ = state.reshape(6, n)
        found.append(x.copy())
        a = inverse @ (OIL * c - stiffness @ x)
        command = -np.einsum("irj,rj->i", gains, np.array([x, v, a, c]))
        command -= np.einsum("ikj,kj->i", sent, commands)
        commands = np.column_stack([command, commands[:, :-1]])
        for old, moved in pieces:
            state[5 * n :] = commands[range(n), old]
            state = moved @ state
    return np.array(found)


@pytest.mark.parametrize("rate", [250.0, 1000.0, 4000.0])
@pytest.mark.parametrize("mass", [0.0, 1.0])
def test_in_stiff_oil_the_volume_is_fed_back_at_the_crossover_frequency(rate, mass):
    one = valve(1 / rate)
    gains, _ = gains_of([one], [[mass]], [[0.0]], 1 / rate)
    (x, v, a, c), w = gains[0, :, 0], crossover([one])[0]
    assert x == pytest.approx(w, rel=0.15)
    assert c == pytest.approx(x, rel=0.1)
    assert abs(v) * w + abs(a) * w**2 < 0.01 * x


@pytest.mark.parametrize("rate", [250.0, 1000.0, 4000.0])
@pytest.mark.parametrize("mass", [20.0, 200.0, 3000.0, 20000.0])
def test_a_deviation_dies_out_within_four_periods_of_the_crossover(rate, mass):
    """Whatever the oil column, here of 145 to 5 Hz, and without ringing."""
    one, k = valve(1 / rate), mass * (2 * math.pi * 3) ** 2
    seconds = 8 * math.pi / crossover([one])[0]
    found = deviations([one], [[mass]], [[k]], 1 / rate, seconds, np.array([1e-3]))[:, 0]
    left = np.abs(found[3 * len(found) // 4 :]).max()
    assert left < 0.05e-3
    assert np.abs(found).max() < 1.01e-3


@pytest.mark.parametrize("rate", [500.0, 1000.0, 4000.0])
def test_an_oil_column_that_rings_is_damped(rate):
    """Energy of the paper's, of 90 Hz, after a jump of the piston's friction."""
    start, energy = np.array([0.0, 0.0, 1e-6]), []
    for on in (0.0, 1.0):
        x = deviations([valve(1 / rate)], [[52.7]], [[2.11e5]], 1 / rate, 0.1, start, on=on)
        energy.append(np.sum(np.diff(x, 2, axis=0) ** 2))
    assert energy[1] < 0.45 * energy[0]


@pytest.mark.parametrize("rate", [250.0, 500.0, 1000.0, 4000.0])
def test_a_specimen_that_sticks_does_not_ring(rate):
    """It is 45 times as stiff as known."""
    start = np.array([1e-5])
    found = deviations(
        [valve(1 / rate)], [[52.7]], [[45 * 2.11e5]], 1 / rate, 0.4, start, known=1 / 45
    )
    assert np.abs(found[-len(found) // 4 :]).max() < 0.1e-5


def test_coupled_axes_come_back_in_their_own_coordinates():
    """Two alike actuators on a body: coordinates that are turned have gains that are turned."""
    dt = 0.001
    mass, k = np.diag([300.0, 5000.0]), np.diag([1e5, 4e6])
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    own, sent = gains_of([valve(dt), valve(dt)], mass, k, dt)
    turned, also = gains_of([valve(dt), valve(dt)], turn @ mass @ turn.T, turn @ k @ turn.T, dt)
    assert np.abs(own[0, :, 1]).max() < 1e-6 * np.abs(own[0]).max()  # here axes are not coupled
    for row in range(4):
        size = np.abs(own[:, row]).max()
        np.testing.assert_allclose(turned[:, row], turn @ own[:, row] @ turn.T, atol=1e-5 * size)
    np.testing.assert_allclose(
        also, np.einsum("ij,jkm,lk->ilm", turn, sent, turn), atol=1e-5 * np.abs(sent).max()
    )


def test_coupled_axes_with_unlike_valves_come_back():
    dt = 0.001
    valves = [valve(dt), valve(dt, 40.0, 0.9, 0.0034)]
    mass, stiffness = [[900.0, 300.0], [300.0, 700.0]], [[3e6, -1e6], [-1e6, 2e6]]
    found = deviations(valves, mass, stiffness, dt, 0.4, np.array([1e-3, -5e-4]))
    assert np.abs(found[-100:]).max() < 0.03e-3
    assert np.abs(found).max() < 1.2e-3


def test_dead_times_of_many_samples_do_not_spoil_the_regulator():
    """With the states of two lines of dead time, a Schur form is not reordered well."""
    dt = 0.00025
    valves = [valve(dt, 40.0, 0.9, 0.002), valve(dt, 110.0, 0.6, 0.002)]
    mass, stiffness = [[1000.0, 800.0], [800.0, 1000.0]], [[9e4, 0.0], [0.0, 9e4]]
    found = deviations(valves, mass, stiffness, dt, 0.3, np.array([1e-3, -5e-4]))
    assert np.abs(found[-100:]).max() < 0.03e-3


def test_a_regulator_that_does_not_exist_is_refused():
    with pytest.raises(InputError, match="no regulator brings this specimen back"):
        gains_of([valve(0.001)], [[100.0]], [[-3.0 * OIL]], 0.001)
