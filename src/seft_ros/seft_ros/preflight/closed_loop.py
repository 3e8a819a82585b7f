"""The sampled closed loop of a test, assembled exactly: rig, compensation and force control."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import eig
from scipy.sparse.csgraph import connected_components

from seft_ros.force_controller.force_control import LinearControl
from seft_ros.reference_force.compensation.linear_filter import LinearFilter

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Matrices = tuple[Floats, Floats, Floats, Floats]

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

        In a large loop, states that do not act on each other in a circle are taken apart first:
        their blocks have the same eigenvalues, and cost less.
        """
        if len(self.matrix) < LARGE:
            return np.linalg.eigvals(self.matrix).astype(np.complex128)
        count, block = connected_components(self.matrix != 0, connection="strong")
        members = [np.flatnonzero(block == index) for index in range(count)]
        found = [np.linalg.eigvals(self.matrix[np.ix_(part, part)]) for part in members]
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
        """Eigenvalues, and how the ground motion moves the specimen through each of them.

        Returns
        -------
        z : ndarray
            Shape (N,).
        residues : ndarray
            Shape (N, n, n): of the transfer function from ground acceleration to displacement.
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

    Sample k, y = (x, v, a, f), gives f_r = c s + d y + e g, the controller makes the drive u of
    f_r and y, and u acts on the rig from sample k+1 on. The states are the rig's, the
    compensation's s and the controller's.

    Parameters
    ----------
    rig : tuple of ndarray
        a, b, c from the drive to y, see `LoopRig.sampled`.
    compensation : LinearFilter
        From y and g to f_r.
    control : LinearControl
        From f_r and y to u.
    dt : float
        Sampling period, s.
    """
    _, b, c = rig
    n = compensation.axes
    matrix = loop_matrix(
        rig, (compensation.a, compensation.b, compensation.c, compensation.d), control
    )
    by_ground = compensation.e
    ground = np.vstack(
        [b @ control.d[:, :n] @ by_ground, compensation.h, control.b[:, :n] @ by_ground]
    )
    displacement = np.pad(c[:n], ((0, 0), (0, len(matrix) - len(b))))
    return ClosedLoop(matrix, ground, displacement, dt)


def loop_matrix(
    rig: tuple[Floats, Floats, Floats], compensation: Matrices, control: LinearControl
) -> Floats:
    """Matrix of `closed_loop`; stacks of rigs and of compensations give a stack of matrices.

    Parameters
    ----------
    rig : tuple of ndarray
        a, b, c, see `closed_loop`; shapes (..., r, r) and so on.
    compensation : tuple of ndarray
        a, b, c, d of a `LinearFilter`; shapes (..., s, s) and so on.
    control : LinearControl
        See `closed_loop`.

    Returns
    -------
    ndarray
        Shape (..., N, N).
    """
    a, b, c = rig
    filter_a, filter_b, filter_c, filter_d = compensation
    n = filter_d.shape[-2]
    by_force, by_state = control.b[:, :n], control.b[:, n:]
    driven_by_force, driven_by_state = b @ control.d[:, :n], b @ control.d[:, n:]
    asked = filter_d @ c
    first, second = a.shape[-1], a.shape[-1] + filter_a.shape[-1]
    size = second + len(control.a)
    matrix = np.zeros((*asked.shape[:-2], size, size))
    matrix[..., :first, :first] = a + driven_by_force @ asked + driven_by_state @ c
    matrix[..., :first, first:second] = driven_by_force @ filter_c
    matrix[..., :first, second:] = b @ control.c
    matrix[..., first:second, :first] = filter_b @ c
    matrix[..., first:second, first:second] = filter_a
    matrix[..., second:, :first] = by_force @ asked + by_state @ c
    matrix[..., second:, first:second] = by_force @ filter_c
    matrix[..., second:, second:] = control.a
    return matrix
