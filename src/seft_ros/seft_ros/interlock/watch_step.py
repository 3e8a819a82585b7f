"""One step of the instability watch, compiled."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled
from seft_plant_sim.integration import multiply

Floats = npt.NDArray[np.float64]

HURRY = 3.0
"""How many times faster the strongest vibration uses that time up."""
RINGING = 0.7
"""Least mean square over its own mean while vibration does not die away."""
EXPLAINED, MEASURED, EXPECTED, LASTING = range(4)
"""Rows of the mean squares: of the structure's acceleration, the measured one, the largest
of the structure's that is remembered, and the mean of the measured one over some more cycles."""


class WatchParameters(NamedTuple):
    """What does not change of a watch over n axes.

    Attributes
    ----------
    product : ndarray
        Shape (s + 5n, s + 2n), transposed: takes (states, a_g, measured state) to (states, filtered
        accelerations of the structure and as measured).
    average, lasting, memory : float
        Factors per step with which mean squares, their mean and what was expected fade.
    patience : float
        Steps for which vibration must be there.
    ratio : float
        Largest RMS over the expected one; 0: none is too large.
    least : float
        Mean square that counts as expected in any case, (m/s^2)^2.
    """

    product: Floats
    average: float
    lasting: float
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
        (s + 2n,).
    squares : ndarray
        See `EXPLAINED`, shape (4, n), (m/s^2)^2.
    above : ndarray
        Steps for which vibration has been there without dying away, shape (1,).
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
    states = len(state.result) - 2 * n
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
        squares[EXPLAINED, i] = old * squares[EXPLAINED, i] + new * explained * explained
        squares[MEASURED, i] = old * squares[MEASURED, i] + new * found * found
        squares[LASTING, i] += (1.0 - p.lasting) * (squares[MEASURED, i] - squares[LASTING, i])
        expected = max(squares[EXPLAINED, i], squares[EXPECTED, i] * p.memory, p.least)
        squares[EXPECTED, i] = expected
        if squares[MEASURED, i] > RINGING * squares[LASTING, i]:
            excess = max(excess, squares[MEASURED, i] / expected)
    # what is far beyond needs less patience than what is a little
    excess /= p.ratio * p.ratio
    change = min(excess, HURRY) if excess > 1.0 else -1.0
    state.above[0] = max(state.above[0] + change, 0.0)
    return state.above[0] >= p.patience
