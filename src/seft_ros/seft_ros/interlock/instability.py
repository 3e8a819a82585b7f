"""Whether a test is going unstable: vibration that the ground motion does not explain.

Acceleration feedback with delay turns unstable at frequencies above the specimen's own, where
the ground motion moves it little. A limit on acceleration sees that late: by then the vibration
is as strong as the test itself. Here what is measured above the natural frequency is held
against what a model of the whole structure does under the same ground motion.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag, expm
from seft_msgs_py.errors import InputError
from seft_msgs_py.timebase import Timebase
from seft_plant_sim.compiled import entry_point

from seft_ros.force_controller.block import bilinear
from seft_ros.interlock.watch_step import (
    EXPECTED,
    MODEL,
    WatchParameters,
    WatchState,
    watch_step,
)
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
ABOVE = 2.0
"""The band begins at this multiple of the specimen's lowest natural frequency."""


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
