"""Compensation methods by the name that a parameter file gives: ours, and those of other packages.

A package registers a method in its setup.py:

    entry_points={"seft.compensation": ["ours = their_package.module:function"]}
"""

from importlib.metadata import EntryPoint

from seft_msgs_py.errors import InputError

from seft_ros.reference_force.compensation.ats import ats
from seft_ros.reference_force.compensation.compensator import Compensator, Knowledge, Method
from seft_ros.reference_force.compensation.inverse import inverse
from seft_ros.reference_force.compensation.linear_acceleration import linear_acceleration
from seft_ros.reference_force.compensation.model import model
from seft_ros.reference_force.compensation.names import OWN, REGISTERED
from seft_ros.reference_force.compensation.none import none
from seft_ros.reference_force.compensation.polynomial import polynomial
from seft_ros.reference_force.compensation.preview_inverse import preview_inverse
from seft_ros.reference_force.compensation.restoring import restoring
from seft_ros.reference_force.compensation.smith import smith

_METHODS: tuple[Method, ...] = (
    *(none, polynomial, linear_acceleration, model, smith, inverse, ats, restoring),
    preview_inverse,
)


def _registered(entry: EntryPoint) -> Method:
    """Load a registered method when it is used: what others have wrong breaks no test of ours."""

    def make(knowledge: Knowledge) -> Compensator:
        try:
            method = entry.load()
        except Exception as error:
            package = entry.dist.name if entry.dist is not None else entry.module
            raise InputError(
                f"reference_force: compensation.method is {entry.name}, but package {package} "
                f"has no {entry.value} that can be loaded: {error}"
            ) from None
        return method(knowledge)

    return make


METHODS: dict[str, Method] = {
    **dict(zip(OWN, _METHODS, strict=True)),
    **{name: _registered(entry) for name, entry in REGISTERED.items()},
}
