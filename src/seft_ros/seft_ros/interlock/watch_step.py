"""One step of the instability watch, compiled."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled
from seft_plant_sim.integration import multiply

Floats = npt.NDArray[np.float64]

HURRY = 10.0
"""How many times faster the strongest vibration uses that time up."""
MODEL, MEASURED, EXPECTED = range(3)
"""Rows of the mean squares: of the model's acceleration, the measured one, and what is expected."""


class WatchParameters(NamedTuple):
    """What does not change of a watch over n axes.

    Attributes
    ----------
    product : ndarray
        Shape (s + 2n, s + 2n), transposed: takes (states, a_g, a) to (states, filtered
        accelerations of the model and as measured).
    average, memory : float
        Factors per step with which mean squares and what was expected fade.
    patience : float
        Steps for which vibration must be there.
    ratio : float
        Largest RMS over the expected one; 0: none is too large.
    least : float
        Mean square that counts as expected in any case, (m/s^2)^2.
    """

    product: Floats
    average: float
    memory: float
    patience: float
    ratio: float
    least: float


class WatchState(NamedTuple):
    """What changes of it.

    Attributes
    ----------
    work, result : ndarray
        States and inputs, and what `WatchParameters.product` makes of them, shape (s + 2n,).
    squares : ndarray
        See `MODEL`, shape (3, n), (m/s^2)^2.
    above : ndarray
        Steps for which vibration has been there, shape (1,).
    """

    work: Floats
    result: Floats
    squares: Floats
    above: Floats


@compiled
def watch_step(
    parameters: WatchParameters, state: WatchState, ground: Floats, acceleration: Floats
) -> bool:
    """Take a step in; say whether vibration has been there for too long.

    Parameters
    ----------
    parameters, state
        The state is brought up to date.
    ground, acceleration : ndarray
        Ground acceleration and measured acceleration, shape (n,), m/s^2.
    """
    p, n, squares = parameters, len(ground), state.squares
    states = len(state.work) - 2 * n
    for i in range(n):
        state.work[states + i] = ground[i]
        state.work[states + n + i] = acceleration[i]
    multiply(p.product, state.work, state.result)
    for i in range(states):
        state.work[i] = state.result[i]
    old, new, excess = p.average, 1.0 - p.average, 0.0
    for i in range(n):
        model, measured = state.result[states + i], state.result[states + n + i]
        squares[MODEL, i] = old * squares[MODEL, i] + new * model * model
        squares[MEASURED, i] = old * squares[MEASURED, i] + new * measured * measured
        expected = max(squares[MODEL, i], squares[EXPECTED, i] * p.memory, p.least)
        squares[EXPECTED, i] = expected
        excess = max(excess, squares[MEASURED, i] / expected)
    # what is far beyond needs less patience than what is a little
    excess /= p.ratio * p.ratio
    state.above[0] = state.above[0] + min(excess, HURRY) if excess > 1.0 else 0.0
    return state.above[0] >= p.patience
