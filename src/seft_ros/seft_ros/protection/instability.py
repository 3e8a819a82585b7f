"""Whether a test is becoming unstable: vibration that no structure has.

A force loop becomes unstable at frequencies above the specimen's own, where the ground motion moves
it little. A limit on acceleration detects that late: by then the vibration is as strong as the test
itself. The watch compares the measured acceleration above the natural frequency with the
acceleration of the whole structure under the ground motion and the measured restoring force
r = f - M_e a::

    (M_e + M_c) (a* + a_g) + g + r = 0                                                      (1)

g is the force of computed parts other than mass. Nothing is assumed of the specimen: if it sticks,
yields or hits a stop, its restoring force contains that, and the structure responds to it. If the
loop itself vibrates, at w, the response to a specimen of natural frequency w_n is not more than
a* = a M_e / (M_e + M_c) (w_n / w)^2.
"""

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, zeros
from seft_msgs_py.errors import InputError
from seft_plant_sim.compiled import compiled, multiply
from seft_plant_sim.lti import bilinear

from seft_ros.reference_force.compensation_methods import substructure_motion
from seft_ros.reference_force.compensator import MethodInputs

_HURRY = 10.0
"""Largest factor by which strong vibration shortens that time."""
IN_BAND = 0.3
"""Part of the structure's whole acceleration that is always assumed as its vibration. If the
specimen yields or hits a stop, the control excites the oil column for some cycles: in fault-free
tests not above 1.5 times the structure's acceleration for long; in an unstable loop it reaches 7
times that acceleration."""
EXPLAINED, OBSERVED, EXPECTED, WHOLE = range(4)
"""Rows of the mean squares: of the structure's acceleration in the band, the measured one there,
the largest recent one of the structure, and the structure's whole acceleration."""


class WatchParameters(NamedTuple):
    """Parameters of a watch over n axes.

    Attributes
    ----------
    product : ndarray
        Shape (s + 5n, s + n), transposed: takes (states, a_g, measured state) to (states,
        acceleration of the structure).
    high_pass : ndarray
        Numerator and denominator, shape (2, 5), highest power first.
    average, memory : float
        Factors per step with which mean squares and the expected vibration fade.
    patience : float
        Steps for which vibration must last.
    ratio : float
        Largest RMS over the expected one; 0: none is too large.
    least : float
        Mean square that is always expected, (m/s^2)^2.
    """

    product: Floats
    high_pass: Floats
    average: float
    memory: float
    patience: float
    ratio: float
    least: float


class WatchState(NamedTuple):
    """State of a watch: arrays of zeros."""

    work: Annotated[Floats, "inputs"]  # states and inputs
    result: Annotated[Floats, "outputs"]  # `WatchParameters.product` times these
    passed: Annotated[Floats, 2, "n", 4]  # memory of the high pass: of this, and as measured
    squares: Annotated[Floats, 4, "n"]  # see `EXPLAINED`, (m/s^2)^2
    above: Annotated[Floats, 1]  # steps for which vibration has lasted


@compiled
def watch_step(
    parameters: WatchParameters, state: WatchState, ground: Floats, measured: Floats
) -> bool:
    """Check a step; say whether vibration has lasted for too long.

    Parameters
    ----------
    parameters, state
        The state is updated.
    ground : ndarray
        Ground acceleration, shape (n,), m/s^2.
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    """
    p, n, squares = parameters, len(ground), state.squares
    states = len(state.result) - n
    for i in range(n):
        state.work[states + i] = ground[i]
        for row in range(4):
            state.work[states + (1 + row) * n + i] = measured[row, i]
    multiply(p.product, state.work, state.result)
    for i in range(states):
        state.work[i] = state.result[i]
    old, new, excess, accepted = p.average, 1.0 - p.average, 0.0, p.ratio * p.ratio
    for i in range(n):
        whole = state.result[states + i]
        explained = pass_high(p.high_pass, state.passed[0, i], whole)
        found = pass_high(p.high_pass, state.passed[1, i], measured[2, i])
        squares[EXPLAINED, i] = old * squares[EXPLAINED, i] + new * explained * explained
        squares[OBSERVED, i] = old * squares[OBSERVED, i] + new * found * found
        squares[WHOLE, i] = old * squares[WHOLE, i] + new * whole * whole
        expected = max(squares[EXPLAINED, i], squares[EXPECTED, i] * p.memory, p.least)
        expected = max(expected, IN_BAND * IN_BAND * squares[WHOLE, i])
        squares[EXPECTED, i] = expected
        if squares[OBSERVED, i] > accepted * expected:  # a division takes longer
            excess = max(excess, squares[OBSERVED, i] / (accepted * expected))
    # strong vibration is accepted for a shorter time than weak vibration
    state.above[0] = state.above[0] + min(excess, _HURRY) if excess > 1.0 else 0.0
    return state.above[0] >= p.patience


@compiled
def pass_high(weights: Floats, memory: Floats, value: float) -> float:
    """Take a value through a filter of fourth order (transposed direct form II)."""
    b, a = weights[0], weights[1]
    result = b[0] * value + memory[0]
    for k in range(3):
        memory[k] = b[k + 1] * value - a[k + 1] * result + memory[k + 1]
    memory[3] = b[4] * value - a[4] * result
    return result


AVERAGE = 0.1
"""Time constant of the mean square, s: some cycles of any vibration in question."""
_MEMORY = 2.0
"""Time constant of the memory of strong expected motion, s."""
SUSTAINED = 0.1
"""Time for which vibration must last, s: an impact is shorter."""
ABOVE = 2.0
"""The band begins at this multiple of the specimen's lowest natural frequency."""


class InstabilityWatch:
    """Compares acceleration above a frequency with that of the structure, see the module.

    Both accelerations, measured and of the structure, go through the same high-pass filter
    (Butterworth, fourth order). Their mean squares are taken over `AVERAGE`; the structure's
    largest fades over `_MEMORY`, because vibration decays slowly. It is a fault if the measured RMS
    stays above ``ratio`` times the structure's for `SUSTAINED`. The structure's RMS is taken as at
    least the floor, and `IN_BAND` of its whole acceleration.

    Parameters
    ----------
    known : MethodInputs
        Mass, computed substructure and sampling period; the stiffness determines the band.
    axes : sequence of str
        Names of the n axes.
    ratio : float
        Largest RMS over the expected one; 0: never a fault.
    floor : float
        RMS that is always expected, m/s^2: several times the sensors' noise.
    lowest : float
        Lower end of the band, Hz; 0: `ABOVE` times the specimen's lowest natural frequency, at most
        a quarter of the sampling rate.

    Attributes
    ----------
    parameters, state : WatchParameters, WatchState
        What `watch_step` takes.
    """

    def __init__(
        self, known: MethodInputs, axes: Sequence[str], ratio: float, floor: float, lowest: float
    ) -> None:
        n, dt = len(axes), known.dt
        self._axes = tuple(axes)
        if lowest >= 0.45 / dt:
            why = f"beyond what is sampled at {1 / dt:g} Hz; take less than {0.45 / dt:g} Hz"
            raise InputError(f"reference_force: instability.lowest {lowest:g} Hz is {why}")
        self._lowest = lowest or min(ABOVE * _natural_hz(known), 0.25 / dt)
        self.parameters = WatchParameters(
            product=_acceleration(known),
            high_pass=_high_pass(self._lowest, dt),
            average=math.exp(-dt / AVERAGE),
            memory=math.exp(-2 * dt / _MEMORY),
            patience=SUSTAINED / dt,
            ratio=float(ratio),
            least=float(floor) ** 2,
        )
        inputs, outputs = self.parameters.product.shape
        self.state = zeros(WatchState, {"inputs": inputs, "outputs": outputs, "n": n})

    def describe(self) -> str:
        """Describe the vibration."""
        _, measured, expected, _ = self.state.squares
        axis = int((measured / expected).argmax())
        rms, over = math.sqrt(measured[axis]), math.sqrt(measured[axis] / expected[axis])
        where = f"{self._lowest:.3g} Hz on axis {self._axes[axis]}"
        size = f"{rms:.3g} m/s^2 RMS, {over:.3g} times that of the structure"
        most = f"under the measured restoring force (limit {self.parameters.ratio:g})"
        return f"instability: acceleration above {where} is {size} {most}"


def _natural_hz(known: MethodInputs) -> float:
    """Lowest natural frequency of the specimen alone, Hz."""
    squares = np.linalg.eigvals(np.linalg.solve(known.mass, known.stiffness)).real
    return math.sqrt(max(float(squares.min()), 0.0)) / math.tau


def _acceleration(known: MethodInputs) -> Floats:
    """Make `WatchParameters.product`, by Eq. (1)."""
    n, beside = known.axes, substructure_motion(known, 0)
    r = np.eye(n, 4 * n, k=3 * n) - known.mass @ np.eye(n, 4 * n, k=2 * n)
    by_measured = beside.d + np.linalg.inv(known.total_mass) @ r
    next_states = beside.a, beside.h, beside.b
    return np.ascontiguousarray(np.block([[*next_states], [-beside.c, -beside.e, -by_measured]]).T)


def _high_pass(lowest: float, dt: float) -> Floats:
    """Butterworth's high pass of fourth order, sampled (bilinear, prewarped), (2, 5)."""
    w = 2.0 / dt * math.tan(math.pi * lowest * dt)
    first, second = (2.0 * math.sin(math.pi * k / 8) for k in (1, 3))
    middle = w * w * (2.0 + first * second)
    outer = first + second
    denominator = [1.0, outer * w, middle, outer * w**3, w**4]
    return np.array(bilinear([1.0, 0.0, 0.0, 0.0, 0.0], denominator, dt))
