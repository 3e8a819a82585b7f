"""What force errors of the past did to a yielding specimen, and the force that mends it."""

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.compensator import Knowledge

Floats = npt.NDArray[np.float64]

_CORRECTION = 4.0  # Hz, of the critically damped way back
_INTEGRAL = 4.0  # Hz
_LARGEST_INTEGRAL = 0.1  # of the largest restoring force so far


class ForceErrorCorrection:
    """Displacement error that measured force errors have caused, and its correction.

    A linear specimen forgets force errors; one that yields keeps them as displacement. With the
    error e = f - f_r* of the measured force against the reference force of the solved loop::

        (M_e + M_c) d'' + C d' + K_t d = (M_e + M_c) M_e^-1 e

    gives the deviation d from the test as it should be, K_t the tangent stiffness. The target
    is lowered by M_e (w^2 d + 2 w d') and by the integral of w e.

    Parameters
    ----------
    knowledge : Knowledge
        Masses and sampling period.
    """

    def __init__(self, knowledge: Knowledge) -> None:
        n = knowledge.axes
        self._dt, self._mass = knowledge.dt, knowledge.mass
        self._inverse_total = np.linalg.inv(knowledge.total_mass)
        self._inverse_mass = np.linalg.inv(knowledge.mass)
        self._share = knowledge.computed_mass @ self._inverse_total
        self._state = np.zeros(2 * n)
        self._deviation, self._rate = self._state[:n], self._state[n:]
        self._integral, self._largest = np.zeros((2, n))

    def step(
        self, ground_motion: Floats, force: Floats, restoring_force: Floats, tangent: Floats
    ) -> Floats:
        """Take a sample in, and compute the force by which the target is lowered.

        Parameters
        ----------
        ground_motion : ndarray
            Of this step, shape (n,), m/s^2.
        force, restoring_force : ndarray
            Measured, shape (n,), N.
        tangent : ndarray
            Tangent stiffness and damping, shape (n, 2n).

        Returns
        -------
        ndarray
            Shape (n,), N.
        """
        dt = self._dt
        error = force + self._mass.dot(ground_motion) - self._share.dot(restoring_force)
        slowed = self._inverse_total.dot(tangent.dot(self._state))
        self._rate += dt * (self._inverse_mass.dot(error) - slowed)
        self._deviation += dt * self._rate
        np.maximum(self._largest, np.abs(restoring_force), out=self._largest)
        self._integral += (2 * np.pi * _INTEGRAL * dt) * error
        end = _LARGEST_INTEGRAL * self._largest
        np.minimum(self._integral, end, out=self._integral)
        np.maximum(self._integral, -end, out=self._integral)
        w = 2 * np.pi * _CORRECTION
        back: Floats = self._mass.dot(w * w * self._deviation + 2 * w * self._rate)
        return back + self._integral
