"""One node of a name on a host: seen at once, where DDS discovery may take seconds.

Two tests on one ROS domain command each other's rig before either has found the other's names.
So a node holds a socket in Linux's abstract namespace as long as it lives; the kernel takes it
back however the node ends, and like the ROS domain it is the network namespace's own.
"""

import socket

from seft_msgs_py.errors import InputError


def claim(domain: int, node: str) -> socket.socket:
    """Take the name of a node on this host.

    Parameters
    ----------
    domain : int
        ROS domain.
    node : str
        Full name of the node, with its namespace.

    Returns
    -------
    socket.socket
        Holds the claim until it is closed or the process ends.

    Raises
    ------
    InputError
        If another process has it.
    """
    held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        held.bind(f"\0seft/{domain}{node}")
    except OSError:
        held.close()
        raise InputError(
            f"ROS domain {domain} already has a node {node} on this host: another test's; end "
            "it, or set ROS_DOMAIN_ID to another number"
        ) from None
    return held


def is_claimed(domain: int, node: str) -> bool:
    """Tell whether a process of this host has taken the name of a node."""
    try:
        claim(domain, node).close()
    except InputError:
        return True
    return False
