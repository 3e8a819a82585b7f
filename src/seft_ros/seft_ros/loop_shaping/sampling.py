"""The plant as the digital loop sees it, and whether that loop is stable."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import cont2discrete
from seft_msgs_py.errors import InputError
from seft_plant_sim.lti import split_dead_time, state_space_response

from seft_ros.force_controller.block import ForceController
from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.plant import Plant

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

MAX_DELAY_STEPS = 500
"""Longest dead time in samples: the closed loop's eigenvalues are still found in a second."""


@dataclass(frozen=True)
class SampledPlant:
    """Exact sampling of a plant: zero-order hold, dead time and the loop's step of latency.

    Sample k is answered by u_k, which holds from step k+1 on; the dead time is m whole samples
    and a rest. So z_k+1 = a z_k + before u_k-m-2 + after u_k-m-1, f_k = c z_k + d u_k-m-1, or
    d u_k-m-2 where there is a rest.

    Attributes
    ----------
    a, before, after, c, d : ndarray
        Shapes (s, s), (s, n), (s, n), (n, s), (n, n).
    whole : int
        m.
    rest : bool
        Whether a part of a sample remains.
    dt : float
        Sampling period, s.
    """

    a: Floats
    before: Floats
    after: Floats
    c: Floats
    d: Floats
    whole: int
    rest: bool
    dt: float

    @classmethod
    def of(cls, plant: Plant, dt: float) -> "SampledPlant":
        """Sample a plant; InputError if its dead time is many samples long."""
        whole, rest = split_dead_time(plant.delay, dt)
        if whole > MAX_DELAY_STEPS:
            raise InputError(
                f"the plant's dead time of {plant.delay:g} s is {whole} samples long, but no loop "
                f"is shaped beyond {MAX_DELAY_STEPS}"
            )
        system = plant.a, plant.b, plant.c, plant.d
        early, forced_early, *_ = cont2discrete(system, rest, "zoh")
        late, forced_late, *_ = cont2discrete(system, dt - rest, "zoh")
        before = late @ forced_early
        return cls(late @ early, before, forced_late, plant.c, plant.d, whole, rest > 0, dt)

    def response(self, frequencies_hz: Floats) -> Complexes:
        """Frequency response of the first axis, from u_k to f_k, shape (N,), N/V."""
        z = np.exp(2j * np.pi * frequencies_hz * self.dt)
        earlier = z[:, np.newaxis, np.newaxis]
        drive = self.before / earlier + self.after
        direct = self.d / earlier if self.rest else self.d
        forces = state_space_response(self.a, drive, self.c, direct, z)
        return forces[:, 0, 0] * z ** -(self.whole + 1.0)

    def state_space(self) -> tuple[Floats, Floats, Floats]:
        """Matrices a, b, c with the drives of the last m + 2 samples as states, newest first.

        The plant may have any number of outputs: c has as many rows.
        """
        size, n = self.before.shape
        line = (self.whole + 2) * n
        a = np.zeros((size + line, size + line))
        a[:size, :size] = self.a
        a[:size, -2 * n :] = np.hstack([self.after, self.before])
        a[size + n :, size:-n] = np.eye(line - n)
        b = np.zeros((size + line, n))
        b[size : size + n] = np.eye(n)
        c = np.zeros((len(self.c), size + line))
        c[:, :size] = self.c
        newest = size + (self.whole + self.rest) * n
        c[:, newest : newest + n] = self.d
        return a, b, c


def closed_loop_poles(plant: SampledPlant, controller: Controller) -> Complexes:
    """Eigenvalues of the sampled force loop, closed on all n axes; stable inside |z| = 1.

    Exact, as long as no valve is at its limit. Where axes are coupled through the specimen this
    says more than the margins of each.
    """
    a, b, c = plant.state_space()
    axes = plant.before.shape[1]
    polynomials = controller.numerator, controller.denominator
    control = ForceController([polynomials] * axes, np.inf, plant.dt).linear()
    by_error, direct = control.b[:, :axes], control.d[:, :axes]
    closed = np.block([[a - b @ direct @ c, b @ control.c], [-by_error @ c, control.a]])
    return np.linalg.eigvals(closed)


def dominant_pole(plant: Plant, controller: Controller, dt: float) -> complex:
    """Pole of the sampled loop, closed on all axes, that dies out last or grows fastest."""
    poles = closed_loop_poles(SampledPlant.of(plant, dt), controller)
    return complex(poles[np.abs(poles).argmax()])
