"""Force error that a loop needs to build up a force where its piston can't move."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from seft_ros.identification.plant_fit import PlantFit
from seft_ros.identification.rational import sampled
from seft_ros.loop_shaping.controller import Controller
from seft_ros.loop_shaping.roots import Root

Floats = npt.NDArray[np.float64]

_HIGHEST_HZ = 20.0  # beyond, structures under test hardly move
_DEGREE = 4
_POINTS = 200


def blocked_error(fit: PlantFit, controller: Controller, dt: float) -> tuple[float, ...]:
    """Fit a polynomial to the force error over force of a loop whose piston is held still.

    With a blocked piston the oil's spring is all that a valve works against: no specimen, no
    resonance of the oil column. The error over force is then the inverse of the open loop,
    E = 1 / (C H), as sampled, controller and latency in it.

    Parameters
    ----------
    fit : PlantFit
        The valve-to-force response, with the specimen.
    controller : Controller
        Of the force loop.
    dt : float
        Sampling period, s.

    Returns
    -------
    tuple of float
        E in s, highest power first, good up to about 20 Hz.
    """
    blocked = replace(fit.model, zeros=(), poles=(), leakage=Root(fit.leakage / (2 * np.pi)))
    highest = min(_HIGHEST_HZ, 0.1 / dt)
    f = np.linspace(highest / _POINTS, highest, _POINTS)
    error = 1.0 / (controller.sampled_response(f, dt) * sampled(blocked, f, dt))
    scale = 1.0 / np.abs(error)  # its errors count relatively
    columns = scale[:, np.newaxis] * np.vander(1j * f / highest, _DEGREE + 1)  # of even size
    error = scale * error
    found = np.linalg.lstsq(
        np.concatenate([columns.real, columns.imag]),
        np.concatenate([error.real, error.imag]),
        rcond=None,
    )[0]
    units = (2 * np.pi * highest) ** np.arange(_DEGREE, -1, -1)
    return tuple((found / units).tolist())
