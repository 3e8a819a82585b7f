"""Axes and rate of a test whose configuration nobody recorded, told from its messages."""

from collections import Counter
from collections.abc import Iterable
from itertools import islice, pairwise

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.timebase import NANOSECONDS_PER_SECOND
from seft_msgs_py.wire.topics import RIG_STATE
from seft_msgs_py.wire.trajectory_message import Trajectory, parse_trajectory

_ENOUGH = 2000  # messages


def infer_experiment(raws: Iterable[bytes]) -> Experiment:
    """Make an experiment that knows no more than axes and rate.

    The rate is that of the spacing which most samples have, so that lost ones do no harm.

    Parameters
    ----------
    raws : iterable of bytes
        Messages of one loop topic, of which the first few thousand are looked at.

    Raises
    ------
    InputError
        If they do not tell axes and rate.
    """
    messages = _understood(islice(raws, _ENOUGH))
    if not messages:
        raise InputError("no message of the loop can be understood")
    axes = Counter(message.axes for message in messages).most_common(1)[0][0]
    stamps = sorted({message.stamp_ns for message in messages})
    known = Counter(m.points[1].time_from_start_ns for m in messages if len(m.points) > 1)
    spacings = known or Counter(late - early for early, late in pairwise(stamps))
    if not spacings:
        raise InputError("one sample alone does not tell the rate")
    period_ns = spacings.most_common(1)[0][0]
    on_grid = sum(1 for stamp in stamps if period_ns > 0 and stamp % period_ns == 0)
    if 2 * on_grid <= len(stamps):
        raise InputError("stamps are not whole numbers of sampling periods")
    rate = NANOSECONDS_PER_SECOND / period_ns
    return Experiment({RIG_STATE.publisher: {"rate": rate, "axes": list(axes)}})


def _understood(raws: Iterable[bytes]) -> list[Trajectory]:
    messages = []
    for raw in raws:
        try:
            messages.append(parse_trajectory(raw))
        except WireError:
            continue
    return [message for message in messages if message.axes and message.points]
