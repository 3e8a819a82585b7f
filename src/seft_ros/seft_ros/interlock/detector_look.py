"""A detector against its threshold, compiled, and the rows in which detectors stand."""

from seft_plant_sim.compiled import compiled

from seft_ros.interlock.detector_arrays import DetectorParameters, DetectorState

SAMPLE, TURN_AT, LIMITED_AT, AT_RANGE = range(4)
"""Places of `DetectorState.step`."""
DISPLACEMENT_VELOCITY, VELOCITY_ACCELERATION, OIL = range(3)
"""Relations (1) to (3)."""
CHANGE, NOISE, SECOND_ORDER_WORK, ROUGH, JUMP = 0, 3, *range(6, 9)
NO_RESPONSE, TRACKING, FROZEN = range(9, 12)
"""Rows of the detectors: a relation's sums, its single steps, and so on; four frozen channels."""


@compiled
def look(
    p: DetectorParameters, state: DetectorState, row: int, i: int, seen: float, threshold: float
) -> bool:
    """Hold what a detector sees against its threshold; say whether it has persisted and acts."""
    share = seen / threshold if threshold > 0.0 else 0.0
    if share > state.shares[row, i]:
        state.shares[row, i] = share
    count = state.counts[row, i]
    state.counts[row, i] = count = count + 1 if share > 1.0 else max(count - 1, 0)
    if count >= p.persistence[row] and p.acts[row]:
        state.found[0], state.found[1] = seen, threshold
        return True
    return False
