"""How near the detectors of faults came to their thresholds in a test that was recorded."""

import numpy as np
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND

from seft_ros.bags.record import Record
from seft_ros.force_controller.detectors_of import detector_shares


def shares_of(record: Record) -> dict[str, float] | None:
    """Say how near each detector came to its threshold, see `detector_shares`.

    None where nobody knows: the configuration is of an older version or not recorded, or no sample
    was answered.
    """
    section = record.experiment.sections.get("force_controller", {})
    states, forces, sent = (
        record.series[topic.name] for topic in (RIG_STATE, REFERENCE_FORCE, VALVE_COMMAND)
    )
    steps, of_states, of_forces = np.intersect1d(
        states.steps, forces.steps, assume_unique=True, return_indices=True
    )
    newest = np.searchsorted(sent.steps, steps, side="right") - 1
    if "detectors.warn_only" not in section or not len(steps) or not len(sent.steps):
        return None
    commands = np.where(newest[:, np.newaxis] < 0, 0.0, sent.values[newest, 0])
    with np.errstate(over="ignore", invalid="ignore"):
        return detector_shares(
            record.experiment, steps, forces.values[of_forces], states.values[of_states], commands
        )
