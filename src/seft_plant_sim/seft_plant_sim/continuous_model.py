"""Actuator and specimen between samples: a linear continuous model, and what is not linear.

The ideal and the pure-delay actuator stand for an actuator with its force servo loop, as the
paper's Eq. 5.2 does: they are driven by the reference force. The servo-hydraulic actuator is driven
by its valve, so that the loop closes over the controller.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from seft_msgs_py.config.arrays import Floats

from seft_plant_sim.actuator import COLUMNS as PISTON
from seft_plant_sim.actuator import Hydraulics, piston_rows
from seft_plant_sim.specimen import Specimen
from seft_plant_sim.springs import Spring

Drive = Literal["valve_command", "reference_force"]


@dataclass(frozen=True)
class ContinuousModel:
    """Actuator and specimen: z' = a z + b w + g r(z), y = c z + d w + h r(z).

    w is the drive, delayed, and y holds displacement (m), velocity (m/s), acceleration (m/s^2)
    and force (N), each over the n axes. The residuals r are those of pistons, then those of
    springs; without them, this is the small-signal limit. The states begin with x and v, and
    where there are pistons with x, v, the oil's force p and the valve's opening w.

    Attributes
    ----------
    a, b, c, d : ndarray
        Shapes (s, s), (s, n), (4n, s), (4n, n).
    delay : float
        Dead time of the drive in s.
    drive : str
        ``valve_command`` (V) or ``reference_force`` (N).
    inputs, outputs : ndarray
        g and h, shapes (s, r) and (4n, r): of each piston the valve's effective opening less its
        opening (V), of each the force that holds it (N), of each spring its force less the
        elastic one (N).
    pistons : ndarray
        `piston.piston_rows`; none where the actuators are linear.
    springs : tuple of Spring
        p of them.
    deformation : ndarray
        Of the springs per displacement of each axis, shape (p, n).
    drive_limit : ndarray
        Drive at which the actuators saturate, shape (n,).
    """

    a: Floats
    b: Floats
    c: Floats
    d: Floats
    delay: float
    drive: Drive
    inputs: Floats
    outputs: Floats
    pistons: Floats
    springs: tuple[Spring, ...]
    deformation: Floats
    drive_limit: Floats

    @classmethod
    def linear(
        cls, a: Floats, b: Floats, c: Floats, d: Floats, delay: float, drive: Drive
    ) -> "ContinuousModel":
        """Make a model without residuals."""
        n = b.shape[1]
        residuals = np.zeros((len(a), 0)), np.zeros((len(c), 0)), np.zeros((0, PISTON)), ()
        return cls(a, b, c, d, delay, drive, *residuals, np.zeros((0, n)), np.full(n, np.inf))

    @property
    def is_linear(self) -> bool:
        """Whether there are no residuals."""
        return not (len(self.pistons) or self.springs)


def with_springs(model: ContinuousModel, specimen: Specimen) -> ContinuousModel:
    """Add the springs' residuals to a model whose first states are x and v."""
    n, p = specimen.axes, len(specimen.springs)
    if not p:
        return model
    inputs, outputs = np.zeros((len(model.a), p)), np.zeros((4 * n, p))
    accelerations = -np.linalg.solve(specimen.mass, specimen.deformation.T)
    inputs[n : 2 * n] = outputs[2 * n : 3 * n] = accelerations
    return replace(
        model,
        inputs=np.hstack([model.inputs, inputs]),
        outputs=np.hstack([model.outputs, outputs]),
        springs=specimen.springs,
        deformation=specimen.deformation,
    )


def with_low_pass(model: ContinuousModel, cutoff: float) -> ContinuousModel:
    """Put a second-order Butterworth low-pass of ``cutoff`` Hz behind every output."""
    m, s = model.c.shape
    n, r = model.b.shape[1], model.inputs.shape[1]
    w = 2 * np.pi * cutoff
    one = np.eye(m)
    a = np.block(
        [
            [model.a, np.zeros((s, 2 * m))],
            [np.zeros((m, s + m)), one],
            [w**2 * model.c, -(w**2) * one, -np.sqrt(2) * w * one],
        ]
    )
    b = np.vstack([model.b, np.zeros((m, n)), w**2 * model.d])
    c = np.hstack([np.zeros((m, s)), one, np.zeros((m, m))])
    inputs = np.vstack([model.inputs, np.zeros((m, r)), w**2 * model.outputs])
    outputs, d = np.zeros_like(model.outputs), np.zeros_like(model.d)
    return replace(model, a=a, b=b, c=c, d=d, inputs=inputs, outputs=outputs)


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
        Whether the actuator is linearised: the small-signal limit.
    """
    n = specimen.axes
    a_specimen, b_specimen = specimen.state_matrices()
    by_force = b_specimen[n:]
    viscous = np.diag(hydraulics.viscous_friction)
    a_specimen[n:, n:] -= by_force @ viscous
    wv = 2 * np.pi * hydraulics.valve_frequency
    one = np.eye(n)
    oil = hydraulics.oil_stiffness
    flow = np.diag(oil * hydraulics.flow_gain)
    _, v, p, w, rate = (slice(first, first + n) for first in range(0, 5 * n, n))
    a, b = np.zeros((5 * n, 5 * n)), np.zeros((5 * n, n))
    a[: 2 * n, : 2 * n], a[: 2 * n, p] = a_specimen, b_specimen
    a[p, v], a[p, p], a[p, w] = -np.diag(oil), -np.diag(hydraulics.leakage), flow
    a[w, rate] = one
    a[rate, w], a[rate, rate] = -np.diag(wv**2), -np.diag(2 * hydraulics.valve_damping * wv)
    b[rate] = np.diag(wv**2)
    c, d = np.zeros((4 * n, 5 * n)), np.zeros((4 * n, n))
    c[: 2 * n, : 2 * n] = np.eye(2 * n)
    c[2 * n : 3 * n] = a[v]
    c[3 * n :, v], c[3 * n :, p] = -viscous, one
    model = ContinuousModel.linear(a, b, c, d, hydraulics.dead_time, "valve_command")
    if not linear:
        inputs, outputs = np.zeros((5 * n, 2 * n)), np.zeros((4 * n, 2 * n))
        inputs[v, n:], inputs[p, :n] = -by_force, flow
        outputs[2 * n : 3 * n, n:], outputs[3 * n :, n:] = -by_force, -one
        model = replace(
            model,
            drive_limit=hydraulics.opening_limit,
            pistons=piston_rows(hydraulics, np.diag(specimen.mass)),
            inputs=inputs,
            outputs=outputs,
        )
    return with_springs(model, specimen)
