"""Whether the nodes of a test have found each other, from what each says of itself."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.outcome import FINISHED, RIG, TRIPPED
from seft_msgs_py.wire.topics import RigAxes, bare, topics_of, with_rigs

RAMPING_DOWN, AT_REST = "ramping_down", "at_rest"  # phases of the reference force
ALL_ANSWERED = "ended"
"""Its phase when the test has ended and it has answered the last state."""
SILENT = "silent"
"""Key of a trip's values: the nodes that had fallen silent, once that is known; may be empty."""
RECORDING = "recording"
"""Phase of the recorder as long as the bag of a test is open, also after that test's end."""
WAITS = "waits"
"""Key of the recorder's values: why it can't record a test now; empty if it can."""
CONFLICT = "one "
"""Start of what is missing where nodes were started with parameters that contradict."""
_IN_A_TEST = ("running", FINISHED, TRIPPED)  # phases of the rig


@dataclass(frozen=True)
class Heard:
    """The last status of a node.

    Attributes
    ----------
    status : Status
        What it said.
    at : float
        When, s of an `AwakeClock`.
    test_s : float
        When, s of the test.
    """

    status: Status
    at: float
    test_s: float = 0.0


def missing(
    peers: Sequence[str],
    heard: Mapping[str, Heard],
    descriptions: Mapping[str, Mapping[str, Any]],
    now: float,
    timeout: float,
    rigs: Sequence[RigAxes],
) -> str:
    """Say what a test still lacks before it can start; empty if nothing.

    Parameters
    ----------
    peers : sequence of str
        Nodes that the test needs, each rig's own among them.
    heard : mapping
        Node name -> last status; holds the supervisor's own too.
    descriptions : mapping
        Node name -> what it says of its parameters.
    now : float
        Time on the clock of `Heard.at`, s.
    timeout : float
        Silence after which a node counts as absent, s.
    rigs : sequence of RigAxes
        The test's.
    """
    absent = [n for n in peers if n not in heard] + silent(peers, heard, now, timeout)
    if absent:
        return "node " + ", ".join(sorted(absent, key=list(peers).index))
    undescribed = [node for node in peers if node not in descriptions]
    if undescribed:
        return "the parameters of " + ", ".join(undescribed)
    rig_nodes = [node for node in with_rigs([RIG], rigs) if node in peers]
    conflict = _conflict(peers, descriptions, rig_nodes)
    if conflict:
        return conflict
    topics = topics_of(rigs)
    for publisher in (*peers, "supervisor"):
        for topic in topics:
            if topic.publisher not in (publisher, ""):
                continue
            known = heard[publisher].status.values.get(f"matched {topic.name}", "").split()
            wanted = {node for node in topic.subscribers if node in (*peers, "supervisor")}
            wanted.update(n for n in rig_nodes if descriptions[n].get("drive") == topic.name)
            if topic.recorded and "recorder" in peers:
                wanted.add("recorder")
            lost = sorted(wanted - set(known) - {publisher})
            if lost:
                return f"{publisher} to reach {', '.join(lost)} on {topic.name}"
            for node in sorted(wanted & set(heard)):
                if heard[node].status.values.get(f"senders {topic.name}") == "0":
                    return f"{node} to hear {publisher} on {topic.name}"
    for node in rig_nodes:
        if heard[node].status.values.get("phase") in _IN_A_TEST:
            return f"the {node} to leave the last test"  # else its end would count for the next
    force = heard.get("reference_force")
    phase = force.status.values.get("phase") if force is not None else ""
    if phase in (RAMPING_DOWN, AT_REST, ALL_ANSWERED):
        return "the reference force to leave the last test"
    recorder = heard["recorder"].status.values if "recorder" in peers else {}
    if recorder.get("phase") == RECORDING:
        return "the recorder to save the last test"
    if recorder.get(WAITS):
        return f"the recorder, as {recorder[WAITS]}"
    motion = heard.get("ground_motion")
    if motion is None or motion.status.values.get("phase") != "primed":
        return "the first of the ground motion"
    return ""


def silent(
    peers: Sequence[str], heard: Mapping[str, Heard], now: float, timeout: float
) -> list[str]:
    """Nodes that have been heard, but not for longer than ``timeout`` seconds."""
    return [node for node in peers if node in heard and now - heard[node].at > timeout]


def silence(node: str, heard: Mapping[str, Heard]) -> str:
    """Say since when a node has been silent, by the time of the test."""
    return f"node {node} has been silent since {heard[node].test_s:.2f} s"


def _conflict(
    peers: Sequence[str], descriptions: Mapping[str, Mapping[str, Any]], rig_nodes: Sequence[str]
) -> str:
    """Nodes that were started with different rates or axes can't work together."""
    for name, nodes in (("rate", peers), ("axes", peers), ("pace", rig_nodes)):
        if len(nodes) < 2:
            continue
        first, *others = nodes
        value = descriptions[first]["parameters"].get(name)
        for node in others:
            other = descriptions[node]["parameters"].get(name)
            if other != value:
                return f"{CONFLICT}{name}: {first} has {value}, {node} has {other}"
    return _other_delay(peers, descriptions)


def _other_delay(peers: Sequence[str], descriptions: Mapping[str, Mapping[str, Any]]) -> str:
    """Delays of the loop that contradict; below zero is whatever the other side has measured."""
    if "reference_force" not in peers:
        return ""
    sent = descriptions["reference_force"]["parameters"].get("loop_delay", 0)
    for node in peers:
        if bare(node) != "force_controller":
            continue
        taken = descriptions[node]["parameters"].get("loop_delay", 0)
        if sent != taken and not (taken < 0 and sent > 0):
            return f"{CONFLICT}loop_delay: reference_force has {sent}, {node} has {taken}"
    return ""
