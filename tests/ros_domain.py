"""ROS domains of tests that run at the same time, also of other checkouts on this machine."""

import fcntl
import itertools
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DOMAINS = 100
"""They are numbered from 1; higher ones' ports may be taken by passing connections."""
_turns = itertools.count(os.getpid())  # a domain that was left a moment ago comes last


def reserve_domain() -> tuple[int, int]:
    """Reserve a domain as long as a file is open.

    Returns
    -------
    number : int
        Of the domain.
    lock : int
        Descriptor of the file; nobody inherits it, and it is closed with the process at the latest.

    Raises
    ------
    RuntimeError
        If all are reserved.
    """
    for _ in range(DOMAINS):
        number = 1 + next(_turns) % DOMAINS
        path = Path(tempfile.gettempdir()) / f"seft_test_domain_{number}.lock"
        lock = None
        try:
            lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:  # somebody else has it
            if lock is not None:
                os.close(lock)
        else:
            return number, lock
    raise RuntimeError(f"all {DOMAINS} ROS domains are reserved by tests that run now")


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Have this process, and those that it starts, use a domain that nobody else has."""
    before = os.environ["ROS_DOMAIN_ID"]
    number, lock = reserve_domain()
    os.environ["ROS_DOMAIN_ID"] = str(number)
    try:
        yield number
    finally:
        os.environ["ROS_DOMAIN_ID"] = before
        os.close(lock)
