"""``seft start``, ``stop``, ``reset`` and ``status``: a test whose nodes run already."""

import os
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from seft_msgs_py.errors import ExperimentError

from seft_ros.cli.options import Json, option, show

if TYPE_CHECKING:
    from seft_ros.test_run.observer import Observer

PATIENCE = 5.0  # s, in which a supervisor that runs is heard
POLL_PERIOD = 0.05  # s


def start() -> int:
    """Start the test whose nodes run and are ready.

    For nodes that were started one by one. The supervisor's log, and seft status, say which node
    it waits for.

    Exit status 1: there is no supervisor, or it refuses.

    Examples:

        seft status

        seft start
    """
    return _request("start")


def stop(
    at_once: bool = option(False, "Trip instead: the rig goes to its safe position.", "--at-once"),
) -> int:
    """Ramp the reference force of the running test down, and end the test.

    This is software. People and hydraulics are protected by the emergency stop in hardware.

    Exit status 1: there is no supervisor, or no test runs.

    Examples:

        seft stop

        seft stop --at-once
    """
    return _request("estop" if at_once else "stop")


def reset() -> int:
    """Make the next test possible after one that is done or has tripped.

    Exit status 1: there is no supervisor, or it refuses.

    Examples:

        seft reset
    """
    return _request("reset")


def status(json: Json = False) -> int:
    """Print the state of the test, why it is in it, and the time of the test.

    Exit status 1: there is no supervisor, or the test has tripped.

    Examples:

        seft status

        seft status --json
    """
    from seft_msgs_py.wire.outcome import MOVING, State

    with _supervised() as observer:
        state, detail = observer.state, observer.values.get("detail", "")
        if state in MOVING:
            observer.spin(2 * POLL_PERIOD)
        found = {"state": state, "detail": detail, "time_s": observer.time_ns / 1e9}
        if "steps" in observer.values:
            found["steps"] = int(observer.values["steps"])
    name = state.replace("_", " ")
    text = name if detail == name else f"{name}: {detail}"
    show(found, json, [f"{text} ({found['time_s']:.1f} s)" if state in MOVING else text])
    return 1 if state == State.TRIPPED else 0


def _request(service: str) -> int:
    with _supervised() as observer:
        accepted, answer = observer.call(service)
    if not accepted:
        raise ExperimentError(answer)
    print(answer)
    return 0


@contextmanager
def _supervised() -> Iterator["Observer"]:
    """Observe the test whose supervisor is heard."""
    from seft_msgs_py.node.process import prepare_on_this_host

    from seft_ros.test_run.observer import Observer

    prepare_on_this_host()
    with closing(Observer()) as observer:
        deadline = time.monotonic() + PATIENCE
        while not observer.state:
            if time.monotonic() > deadline:
                domain = os.environ.get("ROS_DOMAIN_ID", "0")
                raise ExperimentError(
                    f"no supervisor is in ROS domain {domain}: start the nodes; if they run, set "
                    "ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE as they have them"
                )
            observer.spin(POLL_PERIOD)
        yield observer
