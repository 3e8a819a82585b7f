"""The sampled closed loop of a test, assembled exactly: rig, compensation and force control."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import eig
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from seft_ros.force_controller.force_control import LinearControl
from seft_ros.reference_force.linear_filter import LinearFilter

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

LARGE = 60
"""States from which on it pays to take a loop apart."""


@dataclass(frozen=True)
class ClosedLoop:
    """States q of a whole test over n axes: q[k+1] = matrix q[k] + ground g[k...], x = c q.

    Attributes
    ----------
    matrix : ndarray
        Shape (N, N).
    ground : ndarray
        Shape (N, (1 + preview) n), from the ground accelerations of this step and the coming ones.
    displacement : ndarray
        c, shape (n, N).
    dt : float
        Sampling period, s.
    """

    matrix: Floats
    ground: Floats
    displacement: Floats
    dt: float

    def eigenvalues(self) -> Complexes:
        """All N eigenvalues z; the test is stable where every |z| < 1.

        A large loop is first taken apart into states that act on each other in a circle: these
        blocks have the same eigenvalues, and cost less.
        """
        if len(self.matrix) < LARGE:
            return np.linalg.eigvals(self.matrix).astype(np.complex128)
        _, block = connected_components(csr_array(self.matrix), connection="strong")
        sizes = np.bincount(block)
        found = [np.diag(self.matrix)[sizes[block] == 1]]
        for index in np.flatnonzero(sizes > 1):
            part = np.flatnonzero(block == index)
            found.append(np.linalg.eigvals(self.matrix[np.ix_(part, part)]))
        return np.concatenate(found).astype(np.complex128)

    def dominant(self) -> complex:
        """Eigenvalue that dies out last or grows fastest, of a pair the upper."""
        found = self.eigenvalues()
        z = complex(found[np.abs(found).argmax()])
        return complex(z.real, abs(z.imag))

    def growth_rate(self) -> float:
        """ln|z| / dt of that eigenvalue, 1/s: positive where the test is unstable."""
        return growth_rate(self.dominant(), self.dt)

    def modes(self) -> tuple[Complexes, Complexes]:
        """Eigenvalues z, shape (N,), and how the ground motion moves the specimen through each.

        The latter are the residues of the transfer function from ground acceleration to
        displacement, shape (N, n, n).
        """
        z, left, right = eig(self.matrix, left=True)
        n = len(self.displacement)
        known_ahead = self.ground.reshape(len(z), -1, n)
        powers = z[:, np.newaxis] ** np.arange(known_ahead.shape[1])
        entering = np.einsum("si,spn,ip->in", left.conj(), known_ahead, powers)
        scale = np.einsum("si,si->i", left.conj(), right)
        leaving = (self.displacement @ right).T
        with np.errstate(divide="ignore", invalid="ignore"):  # of delays, which are defective
            return z, leaving[:, :, np.newaxis] * (entering / scale[:, np.newaxis])[:, np.newaxis]


def growth_rate(z: complex, dt: float) -> float:
    """Rate ln|z| / dt at which a mode with this eigenvalue grows, 1/s."""
    return float(np.log(max(abs(z), 1e-300)) / dt)


def closed_loop(
    rig: tuple[Floats, Floats, Floats],
    compensation: LinearFilter,
    control: LinearControl,
    dt: float,
) -> ClosedLoop:
    """Close the loop as the blocks run it.

    Sample k, y = (x, v, a, f) = c q of the rig, gives p = c s + d y + e g by the compensation
    (the reference force, or what else it tells the controller); the controller makes the drive
    u of p and y, and u acts on the rig from sample k+1 on. The states are the rig's (a, b, c of
    `LoopRig.sampled`), the compensation's and the controller's.
    """
    a, b, c = rig
    told, axes = len(compensation.d), b.shape[1]
    by_told, by_state = control.b[:, :told], control.b[:, told:] @ c
    driven_by_told, driven_by_state = b @ control.d[:, :told], b @ control.d[:, told:] @ c
    asked = compensation.d @ c
    none = np.zeros((len(compensation.a), len(control.a)))
    moved = a + driven_by_told @ asked + driven_by_state
    matrix = np.block(
        [
            [moved, driven_by_told @ compensation.c, b @ control.c],
            [compensation.b @ c, compensation.a, none],
            [by_told @ asked + by_state, by_told @ compensation.c, control.a],
        ]
    )
    ground = np.vstack([driven_by_told @ compensation.e, compensation.h, by_told @ compensation.e])
    displacement = np.pad(c[:axes], ((0, 0), (0, len(matrix) - len(b))))
    return ClosedLoop(matrix, ground, displacement, dt)
