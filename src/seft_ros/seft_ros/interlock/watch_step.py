"""One step of the instability watch, compiled."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled, multiply

Floats = npt.NDArray[np.float64]

HURRY = 10.0
"""How many times faster the strongest vibration uses that time up."""
IN_BAND = 0.3
"""Part of the structure's whole acceleration that counts as its vibration in any case. Where the
specimen yields or bangs the control knocks the oil, which rings for some cycles: in sound tests not
above 1.5 times the structure's acceleration for long; where the loop is unstable it reaches 7 times
that acceleration."""
EXPLAINED, MEASURED, EXPECTED, WHOLE = range(4)
"""Rows of the mean squares: of the structure's acceleration in the band, the measured one there,
the largest of the structure's that is remembered, and the structure's whole acceleration."""


class WatchParameters(NamedTuple):
    """What does not change of a watch over n axes.

    Attributes
    ----------
    product : ndarray
        Shape (s + 5n, s + 3n), transposed: takes (states, a_g, measured state) to (states, filtered
        accelerations of the structure and as measured, the structure's whole one).
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
        States and inputs, and what `WatchParameters.product` makes of them, shapes (s + 5n,) and
        (s + 3n,).
    squares : ndarray
        See `EXPLAINED`, shape (4, n), (m/s^2)^2.
    above : ndarray
        Steps for which vibration has been there, shape (1,).
    """

    work: Floats
    result: Floats
    squares: Floats
    above: Floats


@compiled
def watch_step(
    parameters: WatchParameters, state: WatchState, ground: Floats, measured: Floats
) -> bool:
    """Take a step in; say whether vibration has been there for too long.

    Parameters
    ----------
    parameters, state
        The state is brought up to date.
    ground : ndarray
        Ground acceleration, shape (n,), m/s^2.
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    """
    p, n, squares = parameters, len(ground), state.squares
    states = len(state.result) - 3 * n
    for i in range(n):
        state.work[states + i] = ground[i]
        for row in range(4):
            state.work[states + (1 + row) * n + i] = measured[row, i]
    multiply(p.product, state.work, state.result)
    for i in range(states):
        state.work[i] = state.result[i]
    old, new, excess = p.average, 1.0 - p.average, 0.0
    for i in range(n):
        explained, found = state.result[states + i], state.result[states + n + i]
        whole = state.result[states + 2 * n + i]
        squares[EXPLAINED, i] = old * squares[EXPLAINED, i] + new * explained * explained
        squares[MEASURED, i] = old * squares[MEASURED, i] + new * found * found
        squares[WHOLE, i] = old * squares[WHOLE, i] + new * whole * whole
        expected = max(squares[EXPLAINED, i], squares[EXPECTED, i] * p.memory, p.least)
        expected = max(expected, IN_BAND * IN_BAND * squares[WHOLE, i])
        squares[EXPECTED, i] = expected
        excess = max(excess, squares[MEASURED, i] / expected)
    # what is far beyond needs less patience than what is a little
    excess /= p.ratio * p.ratio
    state.above[0] = state.above[0] + min(excess, HURRY) if excess > 1.0 else 0.0
    return state.above[0] >= p.patience
