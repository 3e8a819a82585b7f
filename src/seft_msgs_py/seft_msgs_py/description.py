"""What a node says of itself on experiment/description: JSON in a String."""

import json
from typing import Any

from seft_msgs_py.errors import WireError
from seft_msgs_py.messages import decode_string
from seft_msgs_py.topics import DESCRIPTION


def decode_description(raw: bytes) -> tuple[str, dict[str, Any]]:
    """Read a message of experiment/description.

    Returns
    -------
    node : str
        Who tells.
    description : dict
        ``node``, ``parameters`` (dict), and what else it tells.

    Raises
    ------
    WireError
        If it is no description of a node.
    """
    try:
        described = json.loads(decode_string(raw))
    except (ValueError, RecursionError):  # WireError is none of these
        raise WireError(f"{DESCRIPTION.name}: the text is no JSON") from None
    match described:
        case {"node": str(node), "parameters": dict()}:
            return node, described
    raise WireError(f"{DESCRIPTION.name}: the text does not describe a node")
