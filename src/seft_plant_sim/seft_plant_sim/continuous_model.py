"""A rig between samples: a linear continuous model, and what is not linear beside it."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from seft_plant_sim.nonlinearity import Nonlinearity

Floats = npt.NDArray[np.float64]
Drive = Literal["valve_command", "reference_force"]


@dataclass(frozen=True)
class ContinuousModel:
    """Actuator and specimen: z' = a z + b w, (x, v, a, f) = c z + d w, w the drive, delayed.

    Where there is a nonlinearity r(z), its inputs times r are added to z' and its outputs
    times r to the outputs; without it, this is the model's small-signal limit.

    Attributes
    ----------
    a, b, c, d : ndarray
        Shapes (s, s), (s, n), (4n, s), (4n, n); the outputs are displacement (m), velocity
        (m/s), acceleration (m/s^2) and actuator force (N), each over the n axes.
    delay : float
        Dead time of the drive in s.
    drive : str
        ``valve_command`` (V) or ``reference_force`` (N).
    nonlinearity : Nonlinearity or None
        What is not linear.
    """

    a: Floats
    b: Floats
    c: Floats
    d: Floats
    delay: float
    drive: Drive
    nonlinearity: Nonlinearity | None = None


def with_low_pass(model: ContinuousModel, cutoff: float) -> ContinuousModel:
    """Put a second-order Butterworth low-pass of ``cutoff`` Hz behind every output."""
    m, s = model.c.shape
    n = model.b.shape[1]
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
    known = model.nonlinearity
    if known is not None:
        r = known.inputs.shape[1]
        inputs = np.vstack([known.inputs, np.zeros((m, r)), w**2 * known.outputs])
        known = replace(known, inputs=inputs, outputs=np.zeros_like(known.outputs))
    return replace(model, a=a, b=b, c=c, d=np.zeros_like(model.d), nonlinearity=known)
