"""What force errors do to a yielding specimen, and the force that mends it."""

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.compensator import Knowledge
from seft_ros.reference_force.compensation.preview.target_prediction import WAY_BACK

Floats = npt.NDArray[np.float64]

_INTEGRAL = 4.0  # Hz
_LARGEST_INTEGRAL = 0.1  # of the largest restoring force so far
_DISTURBANCE = 6.0  # Hz up to which the loop's deviation lasts


class ForceErrorCorrection:
    """Displacement error that measured force errors have caused, and its correction.

    A linear specimen forgets force errors; one that yields keeps them as displacement. With the
    error e = f - f_r* of the measured force against the reference force of the solved loop::

        (M_e + M_c) d'' + C d' + (K + kappa) d = (M_e + M_c) M_e^-1 e

    gives the deviation d from the test as it should be, K + kappa the tangent stiffness. The
    target is lowered by M_e (w^2 d + 2 w d'), by the integral of w e, and by the slow part of the
    force that the loop makes beside what its model expects.

    Where the force loop is known for any specimen, the lowering for (d, d') is that of the whole
    way back, and nothing is integrated: what the loop does late, and what several modes of a
    structure make of it, is reckoned with.

    Parameters
    ----------
    knowledge : Knowledge
        Masses and sampling period.
    restoring : ndarray
        (K, C) of the specimen while it is elastic, shape (n, 2n).
    pace : float
        Factor on the frequencies at which it corrects: below 1 where the loop's delay makes them
        too fast.
    way_back : ndarray or None
        Lowering for (d, d') that is reckoned over the whole way back, shape (n, 2n).
    """

    def __init__(
        self,
        knowledge: Knowledge,
        restoring: Floats,
        pace: float = 1.0,
        way_back: Floats | None = None,
    ) -> None:
        n, dt = knowledge.axes, knowledge.dt
        mass = knowledge.mass
        inverse = np.linalg.inv(knowledge.total_mass)
        # inputs: force, a_g, x, v, p, the loop's deviation, kappa d; then d, d' and the two sums
        force, ground_motion, x, v, p, deviation, yielded, *states = np.eye(11 * n).reshape(
            11, n, 11 * n
        )
        d, rate, integral, disturbance = states
        restoring_force = restoring @ np.vstack([x, v]) + p
        share = knowledge.computed_mass @ inverse
        error = force + mass @ ground_motion - share @ restoring_force
        slowing = inverse @ (restoring @ np.vstack([d, rate]) + yielded)
        rate = rate + dt * (np.linalg.inv(mass) @ error - slowing)
        d = d + dt * rate
        if way_back is None:
            integral = integral + 2 * np.pi * pace * _INTEGRAL * dt * error
        lasting = 1.0 - np.exp(-2 * np.pi * pace * _DISTURBANCE * dt)
        disturbance = disturbance + lasting * (deviation - disturbance)
        if way_back is None:
            w = 2 * np.pi * pace * WAY_BACK
            lowering = mass @ (w * w * d + 2 * w * rate)
        else:
            lowering = way_back @ np.vstack([d, rate])
        lowering = lowering + disturbance
        self._gain = np.vstack([d, rate, integral, disturbance, restoring_force, lowering])
        self._known, self._result = np.zeros(11 * n), np.zeros(6 * n)
        self._inputs, self._states = np.split(self._known, [7 * n])
        self._deviation = self._states[:n]
        self._new_states = self._result[: 4 * n]
        parts = self._result.reshape(6, n)
        self._integral, self._restoring_force, self._lowering = parts[2], parts[4], parts[5]
        self._largest = [0.0] * n

    def step(
        self,
        ground_motion: Floats,
        force: Floats,
        motion: Floats,
        rest: Floats,
        slope: Floats,
        deviation: Floats,
    ) -> Floats:
        """Take a sample in, and compute the force by which the target is lowered.

        Parameters
        ----------
        ground_motion, force : ndarray
            Of this step, shape (n,), m/s^2 and N.
        motion : ndarray
            (x, v), shape (2n,).
        rest : ndarray
            Restoring force beside K x + C v, shape (n,), N.
        slope : ndarray
            Its slope over the displacement, shape (n, n), N/m.
        deviation : ndarray
            Force that the loop makes beside what its model expects, shape (n,), N.

        Returns
        -------
        ndarray
            Shape (n,), N; valid until the next step.
        """
        yielded = slope.dot(self._deviation)
        np.concatenate((force, ground_motion, motion, rest, deviation, yielded), out=self._inputs)
        np.dot(self._gain, self._known, out=self._result)
        for axis, restoring_force in enumerate(self._restoring_force.tolist()):
            largest = max(self._largest[axis], abs(restoring_force))
            self._largest[axis], end = largest, _LARGEST_INTEGRAL * largest
            self._integral[axis] = min(max(self._integral[axis], -end), end)
        self._states[:] = self._new_states
        self._lowering += self._integral
        return self._lowering
