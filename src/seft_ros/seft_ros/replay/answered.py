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
        Notes: of these, and of steps of which the bag has neither state nor answer.

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
    found = {
        "not answered when recorded, and not sent": np.setdiff1d(states, answered),
        "neither rig/state nor its answer is in the bag, and whether the node had them is not "
        "known": np.setdiff1d(np.arange(answered[-1] if len(answered) else 0), states),
    }
    return [listed(what, steps) for what, steps in found.items() if len(steps)]
