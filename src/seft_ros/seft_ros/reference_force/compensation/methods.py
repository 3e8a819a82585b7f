"""Compensation methods by the name that a parameter file gives."""

from seft_ros.reference_force.compensation.ats import ats
from seft_ros.reference_force.compensation.compensator import Method
from seft_ros.reference_force.compensation.inverse import inverse
from seft_ros.reference_force.compensation.linear_acceleration import linear_acceleration
from seft_ros.reference_force.compensation.model import model
from seft_ros.reference_force.compensation.none import none
from seft_ros.reference_force.compensation.polynomial import polynomial
from seft_ros.reference_force.compensation.preview_inverse import preview_inverse
from seft_ros.reference_force.compensation.restoring import restoring
from seft_ros.reference_force.compensation.smith import smith

METHODS: dict[str, Method] = {
    "none": none,
    "polynomial": polynomial,
    "linear_acceleration": linear_acceleration,
    "model": model,
    "smith": smith,
    "inverse": inverse,
    "ats": ats,
    "restoring": restoring,
    "preview_inverse": preview_inverse,
}
