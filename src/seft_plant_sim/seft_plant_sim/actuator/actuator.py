"""Actuators on a specimen, as continuous models.

What drives them differs. The ideal and the pure-delay actuator stand for an actuator with its
force servo loop, as the paper's Eq. 5.2 does: they are driven by the reference force. The
servo-hydraulic actuator is driven by its valve, so that the loop closes over the controller.
"""

from dataclasses import replace

import numpy as np

from seft_plant_sim.actuator.hydraulics import Hydraulics, piston_rows
from seft_plant_sim.continuous_model import ContinuousModel, with_springs
from seft_plant_sim.specimen.specimen import Specimen


def delayed_force(specimen: Specimen, delay: float) -> ContinuousModel:
    """Actuator that applies the reference force after a pure delay: f(t) = f_r(t - delay).

    The paper's Eq. 5.2; a delay of 0 is the ideal actuator.
    """
    n = specimen.axes
    a, b = specimen.state_matrices()
    c = np.vstack([np.eye(2 * n), a[n:], np.zeros((n, 2 * n))])
    d = np.vstack([np.zeros((2 * n, n)), b[n:], np.eye(n)])
    return with_springs(ContinuousModel.linear(a, b, c, d, delay, "reference_force"), specimen)


def servo_hydraulic(
    specimen: Specimen, hydraulics: Hydraulics, *, linear: bool = False
) -> ContinuousModel:
    """Servo-hydraulic actuator acting against the specimen.

    With the oil's force p, the valve opening w (in V), its rate w', the piston's velocity v and
    the force f on the specimen, which is what the load cell measures::

        p'  = k_oil (q g(w, p) - v) - lambda p
        w'' = wv^2 (u - w) - 2 zv wv w'
        f   = p - c_p v - friction(v) - stop(x, v)

    The piston moves with the specimen, so the specimen's poles are the zeros of the
    valve-to-force response (control-structure interaction, Dyke et al. 1995). The valve's flow
    g(w, p) = w sqrt(1 - sgn(w) p / F_s) ends where the load uses up the supply pressure; drive
    and opening end where the valve is fully open. For small p and without Coulomb friction this
    is the linear model with g = w.

    Parameters
    ----------
    specimen : Specimen
        n axes.
    hydraulics : Hydraulics
        Of the n actuators.
    linear : bool
        Leave out what is not linear in the actuator: the small-signal limit.
    """
    n = specimen.axes
    a_specimen, b_specimen = specimen.state_matrices()
    by_force = b_specimen[n:]
    viscous = np.diag(hydraulics.viscous_friction)
    a_specimen[n:, n:] -= by_force @ viscous
    wv = 2 * np.pi * hydraulics.valve_frequency
    zero, one = np.zeros((n, n)), np.eye(n)
    oil = hydraulics.oil_stiffness
    flow = np.diag(oil * hydraulics.flow_gain)
    a = np.block(
        [
            [a_specimen, b_specimen, np.zeros((2 * n, 2 * n))],
            [zero, -np.diag(oil), -np.diag(hydraulics.leakage), flow, zero],
            [zero, zero, zero, zero, one],
            [zero, zero, zero, -np.diag(wv**2), -np.diag(2 * hydraulics.valve_damping * wv)],
        ]
    )
    b = np.vstack([np.zeros((4 * n, n)), np.diag(wv**2)])
    c = np.zeros((4 * n, 5 * n))
    c[: 2 * n, : 2 * n] = np.eye(2 * n)
    c[2 * n : 3 * n] = a[n : 2 * n]
    c[3 * n :, n : 2 * n] = -viscous
    c[3 * n :, 2 * n : 3 * n] = one
    d = np.zeros((4 * n, n))
    model = ContinuousModel.linear(a, b, c, d, hydraulics.dead_time, "valve_command")
    if not linear:
        model = replace(
            model,
            drive_limit=hydraulics.opening_limit,
            pistons=piston_rows(hydraulics, np.diag(specimen.mass)),
            inputs=np.block(
                [[zero, zero], [zero, -by_force], [flow, zero], [zero, zero], [zero, zero]]
            ),
            outputs=np.block([[zero, zero], [zero, zero], [zero, -by_force], [zero, -one]]),
        )
    return with_springs(model, specimen)
