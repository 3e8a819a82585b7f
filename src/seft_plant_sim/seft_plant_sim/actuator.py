"""Actuators on a specimen, as continuous state-space models.

What drives them differs. The ideal and the pure-delay actuator stand for an actuator with its
force servo loop, as the paper's Eq. 5.2 does: they are driven by the reference force. The
servo-hydraulic actuator is driven by its valve, so that the loop closes over the controller.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from seft_plant_sim.specimen import LinearSpecimen

Floats = npt.NDArray[np.float64]
Drive = Literal["valve_command", "reference_force"]


@dataclass(frozen=True)
class ContinuousModel:
    """Actuator and specimen: z' = a z + b w, (x, v, a, f) = c z + d w, w the drive, delayed.

    Attributes
    ----------
    a, b, c, d : ndarray
        Shapes (s, s), (s, n), (4n, s), (4n, n); the outputs are displacement (m), velocity
        (m/s), acceleration (m/s^2) and actuator force (N), each over the n axes.
    delay : float
        Dead time of the drive in s.
    drive : str
        ``valve_command`` (V) or ``reference_force`` (N).
    """

    a: Floats
    b: Floats
    c: Floats
    d: Floats
    delay: float
    drive: Drive


def delayed_force(specimen: LinearSpecimen, delay: float) -> ContinuousModel:
    """Actuator that applies the reference force after a pure delay: f(t) = f_r(t - delay).

    The paper's Eq. 5.2; a delay of 0 is the ideal actuator.
    """
    n = specimen.axes
    a, b = specimen.state_matrices()
    c = np.vstack([np.eye(2 * n), a[n:], np.zeros((n, 2 * n))])
    d = np.vstack([np.zeros((2 * n, n)), b[n:], np.eye(n)])
    return ContinuousModel(a, b, c, d, delay, "reference_force")


def servo_hydraulic(
    specimen: LinearSpecimen,
    *,
    oil_stiffness: Floats,
    leakage: Floats,
    flow_gain: Floats,
    valve_frequency: Floats,
    valve_damping: Floats,
    dead_time: float,
) -> ContinuousModel:
    """Linear servo-hydraulic actuator acting against the specimen.

    With valve opening w (in V), its rate w' and the oil's spring k_oil between valve flow and
    piston::

        f'  = k_oil (q w - v) - lambda f
        w'' = wv^2 (u - w) - 2 zv wv w'

    The piston moves with the specimen, so the specimen's poles are the zeros of the
    valve-to-force response (control-structure interaction, Dyke et al. 1995).

    Parameters
    ----------
    specimen : LinearSpecimen
        The specimen, n axes.
    oil_stiffness : ndarray
        k_oil, stiffness of the oil column, shape (n,), N/m.
    leakage : ndarray
        lambda, leakage rate, shape (n,), 1/s.
    flow_gain : ndarray
        q, piston velocity for one volt without load, shape (n,), m/s/V.
    valve_frequency, valve_damping : ndarray
        Natural frequency in Hz and damping ratio of the valve, shape (n,).
    dead_time : float
        Dead time of the valve in s.
    """
    n = specimen.axes
    a_specimen, b_specimen = specimen.state_matrices()
    wv = 2 * np.pi * valve_frequency
    zero, one = np.zeros((n, n)), np.eye(n)
    a = np.block(
        [
            [a_specimen, b_specimen, np.zeros((2 * n, 2 * n))],
            [
                zero,
                -np.diag(oil_stiffness),
                -np.diag(leakage),
                np.diag(oil_stiffness * flow_gain),
                zero,
            ],
            [zero, zero, zero, zero, one],
            [zero, zero, zero, -np.diag(wv**2), -np.diag(2 * valve_damping * wv)],
        ]
    )
    b = np.vstack([np.zeros((4 * n, n)), np.diag(wv**2)])
    c = np.zeros((4 * n, 5 * n))
    c[: 2 * n, : 2 * n] = np.eye(2 * n)
    c[2 * n : 3 * n] = a[n : 2 * n]
    c[3 * n :, 2 * n : 3 * n] = one
    return ContinuousModel(a, b, c, np.zeros((4 * n, n)), dead_time, "valve_command")
