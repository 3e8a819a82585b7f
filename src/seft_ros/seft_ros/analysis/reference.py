"""The exact response that a record is held against."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import GROUND_MOTION, RIG_STATE
from seft_plant_sim.reference.whole_structure import ReferenceResponse, reference_response

from seft_ros.recording.record import Record

Floats = npt.NDArray[np.float64]


class Compared(NamedTuple):
    """A quantity that is measured and has a reference.

    Attributes
    ----------
    name : str
        As in a summary, and the attribute of `ReferenceResponse`.
    row : int
        Its row in a sample of ``rig/state``.
    """

    name: str
    row: int


COMPARED = (
    Compared("displacement", RIG_STATE.quantities.index("positions")),
    Compared("acceleration", RIG_STATE.quantities.index("accelerations")),
    Compared("force", RIG_STATE.quantities.index("effort")),
)


def reference_of(record: Record) -> ReferenceResponse | None:
    """Exact response of the whole structure at every step from 0 to the record's last.

    Returns
    -------
    ReferenceResponse or None
        Arrays of shape (N, n); None if the record holds no rig state, not the ground motion
        of all N steps, or nothing of the reference-force node's parameters.

    Raises
    ------
    InputError
        If parameters are missing that describe the structure, or make none.
    """
    states, motion = record.series[RIG_STATE.name], record.series[GROUND_MOTION.name]
    count = int(states.steps[-1]) + 1 if len(states.steps) else 0
    whole = count > 0 and np.array_equal(motion.steps[:count], np.arange(count))
    if not whole or "reference_force" not in record.experiment.sections:
        return None
    try:
        return reference_response(record.experiment, motion.values[:count, 0, :])
    except KeyError as error:
        raise InputError(
            f"the structure is not known: its description lacks {error.args[0]}; was it "
            "recorded with another version?"
        ) from None


def reference_specimen(record: Record) -> str:
    """Tell of which specimen `reference_of` is: the ``simulated`` one, or its ``model``.

    Where no rig is simulated the response of the linear model is no truth to judge a test by.
    """
    return "simulated" if "specimen.mass" in record.experiment.sections.get("rig", {}) else "model"


def quantity(reference: ReferenceResponse, name: str) -> Floats:
    """Pick the reference of a quantity in `COMPARED`, shape (N, n)."""
    values: Floats = getattr(reference, name)
    return values


def at_steps(reference: Floats, steps: npt.NDArray[np.int64]) -> Floats:
    """Pick from a reference, by step from 0, some steps; not copied where they are all."""
    return reference if len(steps) == len(reference) else reference[steps]
