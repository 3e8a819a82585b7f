"""Messages over a link and back at the rate of a test, and the assessment of link and test."""

import math
import os
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import EVERY_NODE
from seft_msgs_py.errors import ExperimentError, InputError, WireError
from seft_msgs_py.node.dds import DdsEndpoint
from seft_msgs_py.node.rclpy_interface import RclWaitSet, command_node, leave_graph
from seft_msgs_py.wire.messages import decode_string, encode_string
from seft_msgs_py.wire.topics import LINK_PING, LINK_PONG, TARGET, RigAxes, Topic, bare
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.design.stability_margins import MASS_RATIO_RESERVE as RESERVE
from seft_ros.drawing.style import Cell, Mark, Number, Texts, TextTable, rows_of
from seft_ros.reference_force.reference_force_parameters import horizon_steps, reference_force_topic

_Verdict = Literal["good", "marginal", "unusable"]

_PERCENTILES = (50, 90, 99, 99.9)
_MARGIN = 1
"""Steps of a loop's delay beyond the percentile: for its computation, and for rare delays."""
COUNTED = 99.0
"""Percentile of the round trips that a loop's delay covers; later values are predicted."""
SOME_LOST, TOO_MANY_LOST = 0.005, 0.2
"""Share of the messages lost from which a link is marginal, and unusable."""
_LONGEST_DELAY = 100
"""Steps that `loop_delay` may have."""


@dataclass(frozen=True)
class RoundTrips:
    """Round trips of messages sent at a steady rate.

    Attributes
    ----------
    rate : float
        Messages a second.
    sent : int
        Their number.
    times : ndarray
        Round trips of those that came back, in the order of arrival, shape (M,), s.
    numbers : ndarray of int
        Their numbers, shape (M,), from 0.
    """

    rate: float
    sent: int
    times: Floats
    numbers: npt.NDArray[np.int64]

    @property
    def lost(self) -> int:
        """Messages that did not come back."""
        return self.sent - len(np.unique(self.numbers))

    @property
    def longest_burst(self) -> int:
        """Most messages that were lost in a row."""
        return int(np.diff(np.union1d(self.numbers, [-1, self.sent])).max()) - 1

    @property
    def reordered(self) -> int:
        """Messages that came back after a message that was sent later."""
        return int((self.numbers < np.maximum.accumulate(self.numbers)).sum())

    @property
    def loop_delay(self) -> int:
        """Delay that a loop over this link needs, in steps at this rate."""
        return math.ceil(self._percentile(COUNTED) * self.rate - 1e-9) + _MARGIN

    def numbers_by_name(self) -> dict[str, Any]:
        """Give JSON values."""
        return {
            "rate_hz": self.rate,
            "sent": self.sent,
            "lost": self.lost,
            "longest_burst": self.longest_burst,
            "reordered": self.reordered,
            "round_trip_s": {
                **{f"p{p:g}": self._percentile(p) for p in _PERCENTILES},
                "least": float(self.times.min()),
                "largest": float(self.times.max()),
            },
            "loop_delay": self.loop_delay,
            "rate_within_a_step_hz": 1.0 / self._percentile(COUNTED),
        }

    def _percentile(self, percent: float) -> float:
        return float(np.percentile(self.times, percent))


@dataclass(frozen=True)
class Allowed:
    """Result of preflight for a test with the delay that its link needs.

    Attributes
    ----------
    mass_ratio : float
        As planned.
    critical_mass_ratio : float or None
        Least unstable one; None where there is none, or it is not known.
    stable : bool or None
        Whether it is stable as planned; None: not known.
    unknown : str or None
        Why preflight failed.
    """

    mass_ratio: float
    critical_mass_ratio: float | None
    stable: bool | None
    unknown: str | None = None


def with_loop_delay(experiment: Experiment, steps: int) -> Experiment:
    """Give the same experiment with another delay of the loop, in steps."""
    return experiment.changed({EVERY_NODE: {"loop_delay": steps}})


def message_size(experiment: Experiment) -> int:
    """Size of a reference force message over a link with a delay of ten steps, bytes."""
    section, axes = experiment["reference_force"], experiment.axes
    topic, points = reference_force_topic(section), 11
    if topic == TARGET:
        points += horizon_steps(section, experiment.timebase.dt)
    codec = TrajectoryCodec(topic, axes, experiment.timebase)
    return len(codec.encode_points(0, np.zeros((points, len(topic.quantities), len(axes)))))


def allowed(experiment: Experiment, loop_delay: int) -> Allowed:
    """Run preflight for a test with a delay of the loop, in steps."""
    from seft_ros.design.planned_tests import PlannedTest
    from seft_ros.design.stability_margins import critical_mass_ratio

    planned = float(experiment["reference_force"]["mass_ratio"])
    try:
        planned_test = PlannedTest(with_loop_delay(experiment, loop_delay))
        stable = planned_test.is_stable()
        critical = critical_mass_ratio(planned_test)
    except InputError as error:
        return Allowed(planned, None, None, str(error))
    return Allowed(planned, critical.value if critical else None, stable)


def assess_link(trips: RoundTrips, test: Allowed | None) -> tuple[_Verdict, list[str]]:
    """Assess a link, and a test over it.

    Returns
    -------
    verdict : str
        ``good``, ``marginal`` or ``unusable``.
    reasons : list of str
        Why it is not good.
    """
    lost, delay, bad, thin = trips.lost / trips.sent, trips.loop_delay, [], []
    if delay > _LONGEST_DELAY:
        bad.append(f"the loop would need a delay of {delay} steps, more than {_LONGEST_DELAY}")
    share = f"{100 * lost:.3g} % of the messages were lost"
    if lost > TOO_MANY_LOST:
        bad.append(share)
    elif lost > SOME_LOST:
        row = f"up to {trips.longest_burst} in a row"
        thin.append(f"{share}, {row}: they are bridged, with some error")
    if test is not None and test.stable is False:
        bad.append(f"mass ratio {test.mass_ratio:g} is unstable with a delay of {delay} steps")
    elif test is not None and test.unknown:
        thin.append(f"preflight could not be done: {test.unknown}")
    elif test is not None and (test.critical_mass_ratio or np.inf) < RESERVE * test.mass_ratio:
        least = f"{RESERVE:g} times the planned {test.mass_ratio:g}"
        thin.append(f"the critical mass ratio {test.critical_mass_ratio:.3g} is less than {least}")
    return "unusable" if bad else "marginal" if thin else "good", [*bad, *thin]


_MARKS = {"good": Mark.GOOD, "marginal": Mark.DOUBT, "unusable": Mark.BAD}
_LINK = (
    Number(
        "lost",
        form=lambda link: (
            f"{link['lost']} ({100 * link['lost'] / link['sent']:.3g} %), "
            f"at most {link['longest_burst']} in a row"
        ),
    ),
    Number("came out of order", "reordered", form=str),
    Number("loop_delay that it needs", "loop_delay", "steps", form=str),
    Number("rate up to which none is needed", "rate_within_a_step_hz", "Hz", form=".3g"),
)
_TEST = (
    Number("critical mass ratio", "critical_mass_ratio", form=".3g", missing="none found"),
    Number("planned mass ratio", "mass_ratio", form="g"),
)


def link_texts(summary: dict[str, Any]) -> Texts:
    """Show the summary of `seft link`, its verdict last."""
    verdict, trips, test = summary["verdict"], summary["round_trip_s"], summary["test"]
    rows = rows_of((Number(f"round trip, {name}", name, "ms", 1e3, ".3f") for name in trips), trips)
    rows += rows_of(_LINK, summary)
    if test is not None:
        unknown = {"critical_mass_ratio": "unknown"} if test["unknown"] else {}
        rows += rows_of(_TEST, test | unknown)
    sent = f"{summary['sent']} messages of {summary['size_bytes']} bytes"
    title = f"link: {sent} at {summary['rate_hz']:g} Hz"
    return [title, TextTable((), rows), Cell(verdict, _MARKS[verdict])]


_ECHO_TIMEOUT_S = 15.0  # s, until the other side is found
_POLL_PERIOD = 0.05  # s
_SETTLING = 0.5  # s that do not count: the first messages are the slowest
_FIRST, LAST = 5.0, 1.0  # s in which the first and the last message may come back
ECHO_PERIOD = 0.2  # s


class _LinkNode:
    """A node that publishes one topic and subscribes to another."""

    def __init__(self, name: str, sends: Topic, receives: Topic) -> None:
        self._node = command_node(name)
        self.endpoint = DdsEndpoint(self._node)
        self.publisher = self.endpoint.publish(sends)
        self.send = self.publisher.send
        self.subscription = self.endpoint.subscribe(receives, reliable=False)
        self._wait_set = RclWaitSet(self._node.context, [self.subscription])

    def listen(self, timeout: float) -> Iterator[bytes]:
        """Wait at most ``timeout`` s for messages, and give all that have come."""
        self._wait_set.wait(timeout)
        while (taken := self.subscription.take()) is not None:
            yield taken[0]

    def close(self) -> None:
        """Leave the graph."""
        leave_graph(self._node)


def echo(progress: Callable[[int], None]) -> None:
    """Send back each message as it is, until interrupted.

    Parameters
    ----------
    progress : callable
        Called with the number of messages sent back, several times a second; may raise to end.
    """
    with closing(_LinkNode("seft_link_echo", LINK_PONG, LINK_PING)) as link:
        count = 0
        while True:
            for raw in link.listen(ECHO_PERIOD):
                link.send(raw)
                count += 1
            progress(count)


def measure_link(
    rate: float,
    duration: float,
    size: int,
    progress: Callable[[str, int], None],
    rig: RigAxes | None = None,
) -> RoundTrips:
    """Measure the link to the node that echoes on this ROS domain.

    Parameters
    ----------
    rate : float
        Messages a second.
    duration : float
        Time for which they are sent, s.
    size : int
        Bytes of each.
    progress : callable
        Called with the present stage and the number of messages sent.
    rig : RigAxes, optional
        Of several rigs, the one whose force controller echoes.

    Raises
    ------
    InputError
        If nobody echoes, or several do.
    ExperimentError
        If nothing comes back.
    """
    ping, pong = (LINK_PING, LINK_PONG) if rig is None else (LINK_PING.of(rig), LINK_PONG.of(rig))
    first, count = -max(1, round(_SETTLING * rate)), max(2, round(duration * rate))
    own = uuid.uuid4().hex
    sent: dict[int, float] = {}
    back: list[tuple[int, float]] = []

    def listen_until(deadline: float) -> None:
        while (left := deadline - time.monotonic()) > 0:
            for raw in link.listen(left):
                now = time.monotonic()
                try:
                    name, number, *_ = decode_string(raw).split(" ")
                    if name == own:
                        back.append((int(number), now - sent[int(number)]))
                except (WireError, ValueError):
                    continue  # of another node

    def send(number: int) -> None:
        raw = encode_string(f"{own} {number} {'.' * size}"[:size])
        sent[number] = time.monotonic()
        link.send(raw)

    with closing(_LinkNode("seft_link", ping, pong)) as link:
        progress("looking for the other side", 0)
        _find_echo(link, pong)
        deadline = time.monotonic() + _FIRST
        while not back and time.monotonic() < deadline:  # this side may not be discovered there yet
            send(first - 1)
            listen_until(time.monotonic() + _POLL_PERIOD)
        start = time.monotonic() - first / rate
        for number in range(first, count):
            listen_until(start + number / rate)
            send(number)
            progress("measuring the link", max(number, 0))
        deadline = time.monotonic() + LAST
        while len({number for number, _ in back}) < len(sent) and time.monotonic() < deadline:
            listen_until(min(deadline, time.monotonic() + _POLL_PERIOD))
    progress("measured", count)
    counted = [(number, took) for number, took in back if number >= 0]
    if not counted:
        none = f"none of {count} messages came back over the link"
        raise ExperimentError(f"{none}; is a firewall between?")
    numbers, times = zip(*counted, strict=True)
    return RoundTrips(rate, count, np.array(times), np.array(numbers))


def _find_echo(link: _LinkNode, pong: Topic) -> None:
    """Wait for the one node that echoes."""
    deadline = time.monotonic() + _ECHO_TIMEOUT_S
    while True:
        echoes = link.endpoint.publishers(pong.name)
        if len(echoes) > 1:
            names = ", ".join(sorted(map(bare, echoes.values())))
            raise InputError(f"several nodes echo on this ROS domain: {names}; end all but one")
        if link.publisher.listener_count() and link.subscription.publisher_count():
            return
        if time.monotonic() > deadline:
            domain = os.environ.get("ROS_DOMAIN_ID", "0")
            raise InputError(
                f"nobody echoes on ROS domain {domain} within {_ECHO_TIMEOUT_S:g} s; on the other "
                "host start seft link --echo, or its force_controller with a loop_delay "
                "(docs/hosts.md has what two hosts need to find each other)"
            )
        time.sleep(_POLL_PERIOD)
