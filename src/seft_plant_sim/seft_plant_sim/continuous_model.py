"""A structure or a rig between samples: a linear continuous model, and what is not linear."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from seft_plant_sim.actuator.hydraulics import COLUMNS as PISTON
from seft_plant_sim.specimen.restoring_force import Spring
from seft_plant_sim.specimen.specimen import Specimen

Floats = npt.NDArray[np.float64]
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
        Drive beyond which the actuators take no notice, shape (n,).
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
        """Make one without residuals."""
        n = b.shape[1]
        unlimited = np.full(n, np.inf)
        inputs, outputs = np.zeros((len(a), 0)), np.zeros((len(c), 0))
        none = np.zeros((0, PISTON))
        return cls(
            a, b, c, d, delay, drive, inputs, outputs, none, (), np.zeros((0, n)), unlimited
        )  # fmt: skip

    @property
    def is_linear(self) -> bool:
        """Whether nothing is not linear."""
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
