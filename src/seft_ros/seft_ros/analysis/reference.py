"""The exact response that a record is held against."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_msgs_py.topics import GROUND_MOTION, RIG_STATE
from seft_plant_sim.whole_structure import ReferenceResponse, reference_response

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
        Arrays of shape (N, n); None if the record holds no rig state, or not the ground
        motion of all N steps.
    """
    states, motion = record.series[RIG_STATE.name], record.series[GROUND_MOTION.name]
    count = int(states.steps[-1]) + 1 if len(states.steps) else 0
    if count == 0 or not np.array_equal(motion.steps[:count], np.arange(count)):
        return None
    return reference_response(record.experiment, motion.values[:count, 0, :])


def quantity(reference: ReferenceResponse, name: str) -> Floats:
    """Pick the reference of a quantity in `COMPARED`, shape (N, n)."""
    values: Floats = getattr(reference, name)
    return values
