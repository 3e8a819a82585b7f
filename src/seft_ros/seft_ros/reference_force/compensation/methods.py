"""Compensation methods by the name that a parameter file gives: ours, and those of others."""

from seft_ros.reference_force.compensation.ats import ats
from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge, Method
from seft_ros.reference_force.compensation.inverse import inverse
from seft_ros.reference_force.compensation.linear_acceleration import linear_acceleration
from seft_ros.reference_force.compensation.model import model
from seft_ros.reference_force.compensation.names import OWN, REGISTERED
from seft_ros.reference_force.compensation.none import none
from seft_ros.reference_force.compensation.polynomial import polynomial
from seft_ros.reference_force.compensation.restoring import restoring
from seft_ros.reference_force.compensation.smith import smith
from seft_ros.target.target_motion import TargetMotion

_METHODS: tuple[Method, ...] = (
    *(none, polynomial, linear_acceleration, model, smith, inverse, ats, restoring, TargetMotion),
)


def _registered(name: str) -> Method:
    def make(knowledge: Knowledge) -> Compensator:
        settings = knowledge.options.get("compensation.settings", "")
        where = "reference_force: compensation.method"
        made: Compensator = REGISTERED.make(name, settings, where, knowledge)
        return made

    return make


METHODS: dict[str, Method] = {
    **dict(zip(OWN, _METHODS, strict=True)),
    **{name: _registered(name) for name in REGISTERED.names if name in REGISTERED},
}
