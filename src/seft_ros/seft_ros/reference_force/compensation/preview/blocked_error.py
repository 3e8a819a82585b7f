"""Force error of a loop whose piston is held still, as weights of the steps to come."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.reference_force.compensation.preview.coming_weights import coming_weights
from seft_ros.reference_force.compensation.preview.target_prediction import NominalSpecimen

Floats = npt.NDArray[np.float64]

_WHERE = "reference_force: tracking"


def is_of_each_mode(options: Mapping[str, Any]) -> bool:
    """Whether E is, as ``tracking.*`` is of a controller that inverts the nominal specimen."""
    return bool(np.any(options["tracking.blocked_compliance"]))


def blocked_error(
    options: Mapping[str, Any], nominal: NominalSpecimen | None, dt: float, axes: int
) -> Floats:
    """Weigh the coming forces so that the sum is E times the force now.

    E is ``tracking.blocked_error`` on each axis. Of a controller that inverts the nominal specimen
    it is b (M_0 s^2 + C_0 s + K_0) / size, b being ``tracking.blocked_compliance`` and size of
    each axis ``tracking.actuator_size``: what the controller asks of a mode for a force is in
    proportion to the mode's stiffness.

    Parameters
    ----------
    options : mapping
        Parameters ``tracking.*``.
    nominal : NominalSpecimen or None
        Specimen that they were identified with; None: the loop does not feel it.
    dt : float
        Sampling period, s.
    axes : int
        n.

    Returns
    -------
    ndarray
        From this step on, shape (m, n, n); m is 0 where E is not known.

    Raises
    ------
    InputError
        If parameters contradict, or sizes are not positive or not those of the axes.
    """
    error, compliance = (
        np.trim_zeros(np.atleast_1d(options[f"tracking.{name}"]).astype(float), "f")
        for name in ("blocked_error", "blocked_compliance")
    )
    if compliance.size and error.size:
        raise InputError(
            f"{_WHERE}.blocked_error is of force controllers that do not know the specimen, "
            "blocked_compliance of one that inverts it; set one of them to [0.0]"
        )
    if compliance.size and nominal is None:
        raise InputError(
            f"{_WHERE}.blocked_compliance needs the specimen that the force controller inverts; "
            "give its tracking.stiffness, tracking.damping (and tracking.mass, if it is another "
            "than model.mass)"
        )
    if nominal is None or not error.size + compliance.size:
        return np.zeros((0, axes, axes))
    if error.size:
        return coming_weights(error, dt)[:, np.newaxis, np.newaxis] * np.eye(axes)
    stiffness, damping = np.hsplit(nominal.restoring, 2)
    weights = [
        coming_weights(np.append(compliance, np.zeros(power)), dt)[:, np.newaxis, np.newaxis]
        * (matrix / _sizes(options, axes))
        for power, matrix in enumerate((stiffness, damping, nominal.mass))
    ]
    return np.sum(weights, axis=0)


def _sizes(options: Mapping[str, Any], axes: int) -> Floats:
    """Size of each axis's actuator, shape (n,)."""
    sizes = np.atleast_1d(options["tracking.actuator_size"]).astype(float)
    if sizes.shape not in ((1,), (axes,)) or not (sizes > 0.0).all():
        raise InputError(
            f"{_WHERE}.actuator_size is {sizes.tolist()}, but must be one number above zero or "
            f"{axes}, one for each axis"
        )
    return np.broadcast_to(sizes, axes)
