"""Actuators on a specimen, as continuous models.

What drives them differs. The ideal and the pure-delay actuator stand for an actuator with its
force servo loop, as the paper's Eq. 5.2 does: they are driven by the reference force. The
servo-hydraulic actuator is driven by its valve, so that the loop closes over the controller.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from seft_plant_sim.continuous_model import ContinuousModel
from seft_plant_sim.hydraulics import Hydraulics
from seft_plant_sim.nonlinearity import Nonlinearity, PistonAndValve, Springs
from seft_plant_sim.specimen import Specimen

Floats = npt.NDArray[np.float64]


def delayed_force(specimen: Specimen, delay: float) -> ContinuousModel:
    """Actuator that applies the reference force after a pure delay: f(t) = f_r(t - delay).

    The paper's Eq. 5.2; a delay of 0 is the ideal actuator.
    """
    n = specimen.axes
    a, b = specimen.state_matrices()
    c = np.vstack([np.eye(2 * n), a[n:], np.zeros((n, 2 * n))])
    d = np.vstack([np.zeros((2 * n, n)), b[n:], np.eye(n)])
    return _with_springs(ContinuousModel(a, b, c, d, delay, "reference_force"), specimen)


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
    viscous = np.diag(hydraulics.viscous_friction)
    a_specimen[n:, n:] -= b_specimen[n:] @ viscous
    wv = 2 * np.pi * hydraulics.valve_frequency
    zero, one = np.zeros((n, n)), np.eye(n)
    oil = hydraulics.oil_stiffness
    a = np.block(
        [
            [a_specimen, b_specimen, np.zeros((2 * n, 2 * n))],
            [
                zero,
                -np.diag(oil),
                -np.diag(hydraulics.leakage),
                np.diag(oil * hydraulics.flow_gain),
                zero,
            ],
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
    model = ContinuousModel(a, b, c, d, hydraulics.dead_time, "valve_command")
    if not linear:
        # residuals: flow (as opening, V), then what holds the piston back (N)
        inputs = np.zeros((5 * n, 2 * n))
        inputs[n : 2 * n, n:] = -b_specimen[n:]
        inputs[2 * n : 3 * n, :n] = np.diag(oil * hydraulics.flow_gain)
        outputs = np.zeros((4 * n, 2 * n))
        outputs[2 * n : 3 * n, n:] = -b_specimen[n:]
        outputs[3 * n :, n:] = -one
        piston = PistonAndValve(hydraulics, np.diag(specimen.mass))
        limit = hydraulics.opening_limit
        model = replace(model, nonlinearity=Nonlinearity(inputs, outputs, (piston,), limit))
    return _with_springs(model, specimen)


def _with_springs(model: ContinuousModel, specimen: Specimen) -> ContinuousModel:
    """Add the springs' hysteresis to a model whose first states are x and v."""
    p, n = len(specimen.springs), specimen.axes
    if not p:
        return model
    size = len(model.a)
    inputs = np.zeros((size + 2 * p, 3 * p))
    outputs = np.zeros((4 * n, 3 * p))
    acceleration = -np.linalg.solve(specimen.mass, specimen.deformation.T)
    inputs[n : 2 * n, :p] = acceleration
    outputs[2 * n : 3 * n, :p] = acceleration
    inputs[size:, p:] = np.eye(2 * p)
    springs = Nonlinearity(inputs, outputs, (Springs(specimen, first_state=size),))
    a = np.pad(model.a, ((0, 2 * p), (0, 2 * p)))
    a[size : size + p, n : 2 * n] = specimen.deformation  # as long as they are elastic
    widened = replace(
        model,
        a=a,
        b=np.pad(model.b, ((0, 2 * p), (0, 0))),
        c=np.pad(model.c, ((0, 0), (0, 2 * p))),
    )
    known = model.nonlinearity
    return replace(widened, nonlinearity=known.beside(springs) if known else springs)
