"""Compensation methods by the name that a parameter file gives."""

from seft_ros.reference_force.compensation.ats import ats
from seft_ros.reference_force.compensation.compensator import Method
from seft_ros.reference_force.compensation.inverse import inverse
from seft_ros.reference_force.compensation.linear_acceleration import linear_acceleration
from seft_ros.reference_force.compensation.model import model
from seft_ros.reference_force.compensation.names import NAMES
from seft_ros.reference_force.compensation.none import none
from seft_ros.reference_force.compensation.polynomial import polynomial
from seft_ros.reference_force.compensation.preview_inverse import preview_inverse
from seft_ros.reference_force.compensation.restoring import restoring
from seft_ros.reference_force.compensation.smith import smith

_METHODS: tuple[Method, ...] = (
    *(none, polynomial, linear_acceleration, model, smith, inverse, ats, restoring),
    preview_inverse,
)
METHODS: dict[str, Method] = dict(zip(NAMES, _METHODS, strict=True))
