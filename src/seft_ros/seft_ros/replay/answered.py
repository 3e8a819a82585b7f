"""Which recorded states a node has answered."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.replay.words import listed

Steps = npt.NDArray[np.int64]


def note_unanswered(node: str, states: Steps, answered: Steps) -> list[str]:
    """Say which states of a bag are not sent in a replay, as they were not answered.

    Parameters
    ----------
    node : str
        Whose answers they are.
    states, answered : ndarray
        Steps of the recorded states and of the answers.

    Returns
    -------
    list of str
        A note, or none.

    Raises
    ------
    InputError
        If a state that was answered is not in the bag.
    """
    lost = np.setdiff1d(answered, states)
    if len(lost):
        raise InputError(
            f"the bag lacks rig/state of step {lost[0]}, which {node} has answered: "
            "what the node remembers of it can't be replayed"
        )
    unanswered = np.setdiff1d(states, answered)
    return (
        [listed("not answered when recorded, and not sent", unanswered)] if len(unanswered) else []
    )
