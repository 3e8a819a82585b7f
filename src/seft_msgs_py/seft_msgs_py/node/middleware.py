"""What a ROS process needs before it starts: settings of FastDDS, shared memory, a free name.

`network.xml` and `one_host.xml` hold the settings:

- UDP only, on one host too. Shared memory is no faster here (`bench/loop.py` measures both), and
  all tests on a host, whatever their domain, share its ports, whose health FastDDS judges by one
  second without activity: while other tests start, end or are killed, or while the host stalls, a
  living node may lose its port and receive nothing from then on. Killed processes leave files.
- A participant announces itself for 3 s, not for half a second: of six that start together some
  miss each other, and would meet only at the next announcement, 3 s later.
- Readers acknowledge what they have at a heartbeat; with the default of 3 s thousands of samples
  pile up, and clearing them away stops a publisher for milliseconds.
- While nacks of the last sample are suppressed, the next one does not wake the event thread.
- FastDDS writes its messages to stderr: stdout is for results.
"""

import errno
import os
import socket
import tempfile
from pathlib import Path

from seft_msgs_py.errors import InputError

NETWORK = Path(__file__).with_name("network.xml")
ONE_HOST = Path(__file__).with_name("one_host.xml")
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
FOLDER = Path("/dev/shm")
TRACERS = "lttng-ust-wait-*"


def prepare_middleware() -> None:
    """Have FastDDS read our settings, unless the environment names others, or static peers.

    Call it before rclpy starts; processes that are started later inherit it.
    """
    named = os.environ.get(PROFILES)
    if named not in (None, str(NETWORK), str(ONE_HOST)):
        return
    if os.environ.get(RANGE) == "LOCALHOST":
        if not os.environ.get("ROS_STATIC_PEERS"):  # which only rmw's own settings heed
            os.environ[PROFILES] = str(ONE_HOST)
            os.environ[RANGE] = "SYSTEM_DEFAULT"  # at LOCALHOST rmw adds shared memory
    elif named is None:
        os.environ[PROFILES] = str(NETWORK)


def prepare_on_this_host() -> None:
    """Do the same, and stay on this host unless the environment sets another range."""
    os.environ.setdefault(RANGE, "LOCALHOST")
    prepare_middleware()


def check_shared_memory(folder: Path = FOLDER) -> None:
    """Check that there is a page of shared memory for the tracer that comes with rclpy (LTTng).

    It maps a file there when rclpy is imported, and without memory behind that file the kernel ends
    the process (SIGBUS). Our messages need no shared memory.

    Raises
    ------
    InputError
        If there is none.
    """
    files = list(folder.glob(TRACERS))
    if (files and all(file.stat().st_blocks for file in files)) or not folder.is_dir():
        return
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            os.posix_fallocate(file.fileno(), 0, 2 * os.sysconf("SC_PAGESIZE"))
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise InputError(
                f"{folder} is full, and no ROS process can start: remove what nobody uses there"
            ) from None


def single_instance(domain: int, node: str) -> socket.socket:
    """Hold the full name of a node on this host in a ROS domain, until the socket is closed.

    Two tests on one ROS domain would command each other's rig before DDS discovery, which may take
    seconds, has shown either the other's names. The socket is in Linux's abstract namespace: the
    kernel frees it however the process ends, and like the ROS domain it belongs to the network
    namespace.

    Raises
    ------
    InputError
        If another process holds it.
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


def is_running(domain: int, node: str) -> bool:
    """Tell whether a process of this host holds the full name of a node."""
    try:
        single_instance(domain, node).close()
    except InputError:
        return True
    return False
