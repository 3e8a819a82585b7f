"""The sampled closed loop of a test, assembled exactly: rig, compensation and force control."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import eig
from scipy.sparse.csgraph import connected_components

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
    control: Matrices | None,
    dt: float,
    feedback: bool = True,
) -> ClosedLoop:
    """Close the loop as the blocks run it.

    Sample k, y = (x, v, a, f), gives f_r = c s + d y + e g, the force error e = f_r - f gives the
    drive u = c_u w + d_u e, and u acts on the rig from sample k+1 on. The states are the
    rig's, the compensation's s and the controller's w.

    Parameters
    ----------
    rig : tuple of ndarray
        a, b, c from the drive to y, see `LoopRig.sampled`.
    compensation : LinearFilter
        From y and g to f_r.
    control : tuple of ndarray or None
        a, b, c, d of the force controller; None: f_r itself drives the rig.
    dt : float
        Sampling period, s.
    feedback : bool
        Whether the controller sees the measured force.
    """
    _, b, c = rig
    n = compensation.axes
    matrix = loop_matrix(
        rig, (compensation.a, compensation.b, compensation.c, compensation.d), control, feedback
    )
    _, gain, _, direct = control or no_control(n)
    by_ground = compensation.e
    ground = np.vstack([b @ direct @ by_ground, compensation.h, gain @ by_ground])
    displacement = np.pad(c[:n], ((0, 0), (0, len(matrix) - len(b))))
    return ClosedLoop(matrix, ground, displacement, dt)


def no_control(axes: int) -> Matrices:
    """Give the matrices of a controller that hands f_r itself on to the rig."""
    return np.zeros((0, 0)), np.zeros((0, axes)), np.zeros((axes, 0)), np.eye(axes)


def loop_matrix(
    rig: tuple[Floats, Floats, Floats],
    compensation: Matrices,
    control: Matrices | None,
    feedback: bool,
) -> Floats:
    """Matrix of `closed_loop`; stacks of rigs and of compensations give a stack of matrices.

    Parameters
    ----------
    rig : tuple of ndarray
        a, b, c, see `closed_loop`; shapes (..., r, r) and so on.
    compensation : tuple of ndarray
        a, b, c, d of a `LinearFilter`; shapes (..., s, s) and so on.
    control : tuple of ndarray or None
        See `closed_loop`.
    feedback : bool
        Likewise.

    Returns
    -------
    ndarray
        Shape (..., N, N).
    """
    a, b, c = rig
    filter_a, filter_b, filter_c, filter_d = compensation
    n = filter_d.shape[-2]
    if control is None:
        control, feedback = no_control(n), False
    own, gain, shown, direct = control
    by_rig = filter_d @ c
    if feedback:
        by_rig = by_rig - c[..., 3 * n :, :]
    first, second = a.shape[-1], a.shape[-1] + filter_a.shape[-1]
    matrix = np.zeros((*by_rig.shape[:-2], second + len(own), second + len(own)))
    driven = b @ direct
    matrix[..., :first, :first] = a + driven @ by_rig
    matrix[..., :first, first:second] = driven @ filter_c
    matrix[..., :first, second:] = b @ shown
    matrix[..., first:second, :first] = filter_b @ c
    matrix[..., first:second, first:second] = filter_a
    matrix[..., second:, :first] = gain @ by_rig
    matrix[..., second:, first:second] = gain @ filter_c
    matrix[..., second:, second:] = own
    return matrix
