"""What friction makes of a sine whose motion is not quite the same as that of the others.

Friction bends the piston's motion, most where an overtone meets the oil column's resonance. Then
the force at the sine's own frequency is another one, although the specimen's law is the same. The
law is estimated from all sines and their odd overtones, as stop operators in parallel (Prandtl and
Ishlinskii, see `seft_ros.reference_force.restoring_model`) beside mass, stiffness and damping, none
of which is negative. Taken out of the force is only what the effective stiffness of the stops
differs by from its mean over the sines, so that an error of the law counts little.
"""

import numpy as np
from scipy.optimize import nnls
from seft_msgs_py.arrays import Complexes, Floats

from seft_ros.reference_force.restoring_model import slide

_ORDERS = (1, 3, 5)  # a law that is odd has no others
_STOPS, _LEAST, _MOST = 8, 0.03, 0.8  # thresholds over the displacement
_POINTS = 512  # of a cycle


def uneven_force(w: Floats, x: Complexes, a: Complexes, f: Complexes) -> Complexes:
    """Force of friction in excess of that with the mean effective stiffness.

    Parameters
    ----------
    w : ndarray
        Frequencies of m sines, shape (m,), rad/s.
    x, a, f : ndarray
        Displacement, acceleration and force of one axis, aligned, shape (m, H): amplitudes of the
        sine and of its overtones, in the order of their frequencies; 0: not evaluated.

    Returns
    -------
    ndarray
        At the sines' frequencies, shape (m,), N.
    """
    travel = float(np.mean(np.abs(x[:, 0])))
    thresholds = travel * np.geomspace(_LEAST, _MOST, _STOPS)
    stops = np.array([_stopped(each, thresholds) for each in x])  # (m, H, stops)
    rows, wanted = [], []
    for order in _ORDERS:
        if order > x.shape[1]:
            break
        k = order - 1
        own = np.stack([a[:, k], x[:, k], 1j * order * w * x[:, k]], axis=1)
        seen = f[:, k] != 0.0
        rows.append(np.concatenate([own, stops[:, k]], axis=1)[seen])
        wanted.append(f[seen, k])
    columns, force = np.concatenate(rows), np.concatenate(wanted)
    real = np.concatenate([columns.real, columns.imag])
    size = np.maximum(np.linalg.norm(real, axis=0), 1e-300)
    found, _ = nnls(real / size, np.concatenate([force.real, force.imag]))
    effective = stops[:, 0] / x[:, :1]
    uneven: Complexes = ((effective - effective.mean(axis=0)) * x[:, :1]) @ (found / size)[3:]
    return uneven


def _stopped(x: Complexes, thresholds: Floats) -> Complexes:
    """Amplitudes of stop operators that follow a periodic motion, shape (H, stops)."""
    phase = 2 * np.pi * np.arange(2 * _POINTS) / _POINTS  # the first cycle is from rest
    orders = np.arange(1, len(x) + 1)[:, np.newaxis]
    motion = (x[:, np.newaxis] * np.exp(1j * orders * phase)).real.sum(axis=0)
    stops = np.zeros((len(motion), len(thresholds)))
    slide(np.ascontiguousarray(motion), thresholds, stops)
    spectrum = np.fft.rfft(stops[_POINTS:], axis=0) * 2.0 / _POINTS
    return np.asarray(spectrum[1 : len(x) + 1], dtype=np.complex128)
