"""Why a recorded test ended: the rig knows its own limits, the supervisor all else."""

from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.outcome import STOPPED, Outcome, Trip
from seft_msgs_py.wire.timebase import Timebase

from seft_ros.experiment.state_machine import State


def trip_of(outcome: Outcome | None, ending: Status | None, timebase: Timebase) -> Trip | None:
    """Put together what rig and supervisor say of a test's end.

    Parameters
    ----------
    outcome : Outcome or None
        End of the test as the rig saw it.
    ending : Status or None
        The supervisor's last ``done`` or ``tripped``.
    timebase : Timebase
        Of the loop.

    Returns
    -------
    Trip or None
        None if the test ran to the end of its record, or nobody says why it did not.
    """
    trip = outcome.trip if outcome else None
    if ending is None or (trip is None and ending.message != State.TRIPPED):
        return trip
    if ending.message != State.TRIPPED and trip is not None and trip.reason != STOPPED:
        return trip
    told = ending.values.get("step", "")
    if told.isdecimal():
        step = int(told)
    elif trip is not None:
        step = trip.step
    else:
        step = max(0, outcome.steps - 1) if outcome else 0
    return Trip(ending.values.get("detail", ""), step, timebase.stamp_ns(step) / 1e9)
