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
from typing import Annotated, Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, zeros
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.compiled import compiled, multiply
from seft_plant_sim.lti import bilinear

from seft_ros.reference_force.compensation_methods import substructure_motion
from seft_ros.reference_force.compensator import MethodInputs
from seft_ros.reference_force.reference_force_block import method_inputs

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
        Shape (s + 5n, s + 3n), transposed: takes (states, a_g, measured state) to (states, filtered
        accelerations of the structure and as measured, the structure's whole one).
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
    average: float
    memory: float
    patience: float
    ratio: float
    least: float


class WatchState(NamedTuple):
    """State of a watch: arrays of zeros."""

    work: Annotated[Floats, "inputs"]  # states and inputs
    result: Annotated[Floats, "outputs"]  # `WatchParameters.product` times these
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
        squares[OBSERVED, i] = old * squares[OBSERVED, i] + new * found * found
        squares[WHOLE, i] = old * squares[WHOLE, i] + new * whole * whole
        expected = max(squares[EXPLAINED, i], squares[EXPECTED, i] * p.memory, p.least)
        expected = max(expected, IN_BAND * IN_BAND * squares[WHOLE, i])
        squares[EXPECTED, i] = expected
        excess = max(excess, squares[OBSERVED, i] / expected)
    # strong vibration is accepted for a shorter time than weak vibration
    excess /= p.ratio * p.ratio
    state.above[0] = state.above[0] + min(excess, _HURRY) if excess > 1.0 else 0.0
    return state.above[0] >= p.patience


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
            raise InputError(
                f"reference_force: instability.lowest {lowest:g} Hz is beyond what is sampled at "
                f"{1 / dt:g} Hz; take less than {0.45 / dt:g} Hz"
            )
        self._lowest = lowest or min(ABOVE * _natural_hz(known), 0.25 / dt)
        a, b, c, d = _filtered(known, self._lowest, dt, n)
        self.parameters = WatchParameters(
            product=np.ascontiguousarray(np.block([[a, b], [c, d]]).T),
            average=math.exp(-dt / AVERAGE),
            memory=math.exp(-2 * dt / _MEMORY),
            patience=SUSTAINED / dt,
            ratio=float(ratio),
            least=float(floor) ** 2,
        )
        inputs, outputs = self.parameters.product.shape
        self.state = zeros(WatchState, {"inputs": inputs, "outputs": outputs, "n": n})

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: Sequence[str], timebase: Timebase
    ) -> "InstabilityWatch":
        """Make it from the reference force's section of an experiment.

        Raises
        ------
        InputError
            See `method_inputs`; or if the band would begin beyond half the sampling rate.
        """
        options = (section[f"instability.{name}"] for name in ("ratio", "floor", "lowest"))
        return cls(method_inputs(section, tuple(axes), timebase), axes, *options)

    def describe(self) -> str:
        """Describe the vibration."""
        _, measured, expected, _ = self.state.squares
        axis = int((measured / expected).argmax())
        rms, over = math.sqrt(measured[axis]), math.sqrt(measured[axis] / expected[axis])
        return (
            f"instability: acceleration above {self._lowest:.3g} Hz on axis {self._axes[axis]} is "
            f"{rms:.3g} m/s^2 RMS, {over:.3g} times that of the structure "
            f"under the measured restoring force (limit {self.parameters.ratio:g})"
        )


def _natural_hz(known: MethodInputs) -> float:
    """Lowest natural frequency of the specimen alone, Hz."""
    squares = np.linalg.eigvals(np.linalg.solve(known.mass, known.stiffness)).real
    return math.sqrt(max(float(squares.min()), 0.0)) / math.tau


def _filtered(
    known: MethodInputs, lowest: float, dt: float, n: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """State space from (a_g, measured state) to the result of `WatchParameters.product`."""
    beside, inverse = substructure_motion(known, 0), np.linalg.inv(known.total_mass)
    own, r = np.eye(n, 4 * n, k=2 * n), np.eye(n, 4 * n, k=3 * n)
    r = r - known.mass @ own
    # Eq. (1)
    by_states, by_ground = -beside.c, -beside.e
    by_measured = -beside.d - inverse @ r
    one, none = np.eye(n), np.zeros((n, n))
    fa, fb, fc, fd = (np.kron(part, one) for part in _high_pass(lowest, dt))
    size, order = len(beside.a), len(fa)
    apart = np.zeros((order, order))
    a = np.block(
        [
            [beside.a, np.zeros((size, 2 * order))],
            [fb @ by_states, fa, apart],
            [np.zeros((order, size)), apart, fa],
        ]
    )
    b = np.block([[beside.h, beside.b], [fb @ by_ground, fb @ by_measured], [fb @ none, fb @ own]])
    nothing = np.zeros_like(fc)
    c = np.block(
        [
            [fd @ by_states, fc, nothing],
            [np.zeros((n, size)), nothing, fc],
            [by_states, nothing, nothing],
        ]
    )
    d = np.block([[fd @ by_ground, fd @ by_measured], [none, fd @ own], [by_ground, by_measured]])
    return a, b, c, d


def _high_pass(lowest: float, dt: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Butterworth's high pass of fourth order in state space, sampled (bilinear, prewarped)."""
    w = 2.0 / dt * math.tan(math.pi * lowest * dt)
    first, second = (2.0 * math.sin(math.pi * k / 8) for k in (1, 3))
    middle = w * w * (2.0 + first * second)
    outer = first + second
    denominator = [1.0, outer * w, middle, outer * w**3, w**4]
    num, den = bilinear([1.0, 0.0, 0.0, 0.0, 0.0], denominator, dt)
    a = np.vstack([-den[1:], np.eye(3, 4)])
    b = np.eye(4, 1)
    c = (num[1:] - num[0] * den[1:])[np.newaxis]
    return a, b, c, np.array([[num[0]]])
