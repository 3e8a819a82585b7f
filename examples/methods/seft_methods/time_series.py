"""Adaptive time series compensator."""

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import savgol_coeffs
from seft_msgs_py.arrays import Floats
from seft_ros.reference_force.compensation_methods import whole_steps
from seft_ros.reference_force.compensator import MethodInputs

from seft_methods.adaptation import AdaptiveCompensator
from seft_methods.delay_estimate import ForceBlocks
from seft_methods.settings import delay_range, read_settings
from seft_methods.signals import Memory, Signals

WINDOW = 1.0
"""Moving window of the least squares, s."""
_BLOCKS = 20  # the window moves on by one at a time
_FITTED = 0.006  # s: past through which a parabola gives the derivatives; more: less noise
_AMPLITUDE = (0.7, 1.3)  # bounds of a0
_AMPLITUDE_RATE = 0.5  # largest change of a0, 1/s
_PRIOR = 1e-3  # weight of the present coefficients, over that of the data


class Ats(AdaptiveCompensator):
    """f_r = a0 f* + a1 f*' + a2 f*'', with a0, a1, a2 fitted on line to the actuator.

    Adaptive time series compensator (Chae, Kazemibidokhti & Ricles 2013, Earthquake Eng. Struct.
    Dyn. 42:1697-1715): by least squares over a moving window of one second, the reference force
    is a0 f + a1 f' + a2 f'' of the measured force; so an actuator of amplitude A and delay tau
    has a0 = 1 / A, a1 = tau / A, a2 = tau^2 / 2 A, and with these coefficients it follows f*.

    f* = -M_e a_g + S r, S = M_c (M_e + M_c)^-1, is the reference force of the solved loop, see
    `restoring` of seft: the series of the acceleration feedback would grow without limit with
    frequency. Derivatives are those of a parabola through the last 6 ms. The same filter is used
    for f* and, in the fit, for the measured force, so that the coefficients also correct its lag.

    Parameters
    ----------
    inputs : MethodInputs
        Gives the first delay.
    **given
        Settings, by name.

    Raises
    ------
    InputError
        If no delay is given, or a setting is invalid.
    """

    def __init__(self, inputs: MethodInputs, **given: Any) -> None:
        settings = read_settings(given)
        n, dt, delay = inputs.axes, inputs.dt, inputs.delay
        shortest, longest = delay_range(inputs, settings)
        low, high = _AMPLITUDE
        self._start = np.tile([1.0, delay, delay**2 / 2], (n, 1))
        self._least = np.array([low, low * shortest, 0.0])
        self._greatest = high * np.array([1.0, longest, longest**2 / 2])
        self._coefficients = self._start.copy()
        block, past = whole_steps(WINDOW / _BLOCKS, dt), max(3, round(_FITTED / dt))
        rate = settings["delay_rate"]
        self._most = np.array([_AMPLITUDE_RATE, rate, rate * longest]) * block * dt
        self._enough = settings["excitation"] ** 2 * block * _BLOCKS
        self._forces = ForceBlocks(settings["band"], dt, n, past, block)
        self._derivatives = parabola_weights(1 + past, dt)
        signals = Signals(inputs, preview=0, blocks=past)
        ground = inputs.mass @ signals.ground_motion(0.0)
        wanted = inputs.share @ signals.restoring_force - ground
        values = np.array([wanted, *(signals.state(i) for i in range(past))])
        self._series = np.tensordot(self._derivatives, values, axes=1)  # of f*: (3, n, columns)
        self._sums: deque[Floats] = deque(maxlen=_BLOCKS)
        super().__init__(Memory.past(wanted[:, past * n :], past))

    def reset(self) -> None:
        """Forget the test so far, and the identified values."""
        self._coefficients[:] = self._start
        self._forces.reset()
        self._sums.clear()
        super().reset()

    def estimates(self) -> dict[str, Floats]:
        """Delay a1 / a0 (s) and amplitude 1 / a0 of each axis, as ``delay`` and ``amplitude``."""
        a0, a1, _ = self._coefficients.T
        return {"delay": a1 / a0, "amplitude": 1 / a0}

    def _present_gains(self) -> Floats:
        gains: Floats = np.einsum("ni,inc->nc", self._coefficients, self._series)
        return gains

    def _products(self, reference: Floats, measured: Floats) -> Floats:
        """Sum the products of (f, f', f'', f_r) over a block, for each axis; shape (n, 4, 4)."""
        count = self._derivatives.shape[1]
        latest = sliding_window_view(measured, count, axis=0)[..., ::-1]
        series = np.einsum("ij,snj->isn", self._derivatives, latest)
        rows = np.concatenate([series, reference[np.newaxis, count - 1 :]])
        products: Floats = np.einsum("isn,jsn->nij", rows, rows)
        return products

    def _adapt(self, reference: Floats, measured: Floats) -> bool:
        """Move the coefficients towards those that fit the window."""
        block = self._forces.step(reference, measured)
        if block is None:
            return False
        self._sums.append(self._products(block[:, 0], block[:, 1]))
        for now, total in zip(self._coefficients, np.sum(self._sums, axis=0), strict=True):
            products, wanted = total[:3, :3], total[:3, 3]
            if not self._enough < min(total[0, 0], total[3, 3]) < math.inf:
                continue
            # one frequency alone can't determine three coefficients: the others do not change
            prior = np.diag(_PRIOR * np.diag(products))
            found = np.linalg.solve(products + prior, wanted + prior @ now)
            bounded = np.clip(found, now - self._most, now + self._most)
            now[:] = np.clip(bounded, self._least, self._greatest)
        return True


def parabola_weights(count: int, dt: float) -> Floats:
    """Weights of the last values, newest first, for value and derivatives now.

    They are those of a parabola fitted by least squares: the filter of Savitzky & Golay (1964) at
    the end of its window.

    Returns
    -------
    ndarray
        Shape (3, count): of the value, the first and the second derivative.
    """
    last = count - 1
    weights = [savgol_coeffs(count, 2, k, dt, pos=last, use="dot")[::-1] for k in range(3)]
    return np.array(weights)
