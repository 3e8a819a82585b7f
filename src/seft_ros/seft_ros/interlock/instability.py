"""Whether a test is going unstable: vibration that the ground motion does not explain.

Acceleration feedback with delay turns unstable at frequencies above the specimen's own, where
the ground motion moves it little. A limit on acceleration sees that late: by then the vibration
is as strong as the test itself. Here what is measured above the natural frequency is held
against what a model of the whole structure does under the same ground motion.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag, expm
from seft_msgs_py.errors import InputError
from seft_msgs_py.timebase import Timebase
from seft_plant_sim.compiled import compiled, entry_point
from seft_plant_sim.integration import multiply

from seft_ros.force_controller.block import bilinear
from seft_ros.reference_force.block import knowledge
from seft_ros.reference_force.compensation.compensator import Knowledge
from seft_ros.reference_force.compensation.substructure import whole_system

Floats = npt.NDArray[np.float64]

AVERAGE = 0.1
"""Time constant of the mean square, s: some cycles of any vibration in question."""
MEMORY = 2.0
"""Time constant with which strong motion that was expected is forgotten, s."""
SUSTAINED = 0.1
"""Time for which vibration must be there, s: a knock is none."""
HURRY = 10.0
"""How many times faster the strongest vibration uses that time up."""
ABOVE = 2.0
"""The band begins at this multiple of the specimen's lowest natural frequency."""


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


class InstabilityWatch:
    """Acceleration above a frequency must be what the ground motion explains.

    Both accelerations, measured and of the model, go through the same high-pass filter
    (Butterworth, fourth order). Their mean squares are taken over `AVERAGE`; the model's largest
    fades over `MEMORY`, as vibration rings on. It is a fault if the measured RMS stays above
    ``ratio`` times the model's (and the floor) for `SUSTAINED`. The model need not be exact: a
    growing oscillation passes any ratio.

    Parameters
    ----------
    known : Knowledge
        Mass, computed mass, damping and stiffness of the model, and the sampling period.
    axes : sequence of str
        Names of the n axes.
    ratio : float
        Largest RMS over the expected one; 0: never a fault.
    floor : float
        RMS that counts as expected in any case, m/s^2: several times the sensors' noise.
    lowest : float
        Where the band begins, Hz; 0: at `ABOVE` times the specimen's lowest natural frequency,
        at most at a quarter of the sampling rate.

    Attributes
    ----------
    parameters, state : WatchParameters, WatchState
        What `watch_step` takes.
    """

    def __init__(
        self, known: Knowledge, axes: Sequence[str], ratio: float, floor: float, lowest: float
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
            memory=math.exp(-2 * dt / MEMORY),
            patience=SUSTAINED / dt,
            ratio=float(ratio),
            least=float(floor) ** 2,
        )
        work, result = np.zeros((2, len(self.parameters.product)))
        self.state = WatchState(work, result, np.zeros((3, n)), np.zeros(1))
        arguments = self.state.squares[MODEL], self.state.squares[MODEL]
        self._step = entry_point(watch_step, self.parameters, self.state, *arguments)
        self.reset()

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: Sequence[str], timebase: Timebase
    ) -> "InstabilityWatch":
        """Make it of the reference force's section of an experiment.

        Raises
        ------
        InputError
            As `knowledge`, or if the band would begin beyond half the sampling rate.
        """
        options = (section[f"instability.{name}"] for name in ("ratio", "floor", "lowest"))
        return cls(knowledge(section, tuple(axes), timebase), axes, *options)

    def reset(self) -> None:
        """Begin a new test, at rest."""
        for values in self.state:
            values[:] = 0.0
        self.state.squares[EXPECTED] = self.parameters.least

    def step(self, ground_motion: Floats, acceleration: Floats) -> str | None:
        """Look at one step, see `watch_step`; one line with what is wrong, if anything."""
        if self.parameters.ratio == 0.0:
            return None
        found = self._step(self.parameters, self.state, ground_motion, acceleration)
        return self.describe() if found else None

    def describe(self) -> str:
        """Say what vibrates."""
        _, measured, expected = self.state.squares
        axis = int((measured / expected).argmax())
        rms, over = math.sqrt(measured[axis]), math.sqrt(measured[axis] / expected[axis])
        return (
            f"instability: acceleration above {self._lowest:.3g} Hz on axis {self._axes[axis]} is "
            f"{rms:.3g} m/s^2 RMS, {over:.3g} times what the ground motion explains "
            f"(limit {self.parameters.ratio:g})"
        )


def _natural_hz(known: Knowledge) -> float:
    """Lowest natural frequency of the specimen alone, Hz."""
    squares = np.linalg.eigvals(np.linalg.solve(known.mass, known.stiffness)).real
    return math.sqrt(max(float(squares.min()), 0.0)) / math.tau


def _filtered(
    known: Knowledge, lowest: float, dt: float, n: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """State space from (a_g, a) to the high-passed accelerations of the model and as measured."""
    motion, push = whole_system(known)
    size, restoring = len(motion), motion[n : 2 * n]
    held = expm(dt * np.block([[motion, push], [np.zeros((n, size + n))]]))  # zero-order hold
    fa, fb, fc, fd = _high_pass(lowest, dt)
    one, none = np.eye(n), np.zeros((n, n))
    filters = [np.kron(part, one) for part in (fa, fb, fc, fd)]
    order = len(fa) * n
    a = block_diag(held[:size, :size], filters[0], filters[0])
    a[size : size + order, :size] = filters[1] @ restoring  # the model's acceleration, filtered
    b = np.block(
        [
            [held[:size, size:], np.zeros((size, n))],
            [-filters[1], np.zeros((order, n))],
            [np.zeros((order, n)), filters[1]],
        ]
    )
    c = np.block(
        [
            [filters[3] @ restoring, filters[2], np.zeros((n, order))],
            [np.zeros((n, size + order)), filters[2]],
        ]
    )
    d = np.block([[-filters[3], none], [none, filters[3]]])
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
