"""Whether the nodes of a test have found each other, and keep its rate in a rehearsal."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from seft_msgs_py.config.facts import CHANNELS, FACTS, SETTINGS, agree
from seft_msgs_py.config.parameter_table import group, parameter_rows
from seft_msgs_py.wire import outcome
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.topics import LOOP_NODES, RigAxes, topics_of, with_rigs

REHEARSAL_PARAMETERS = parameter_rows(
    """
    rehearsal.duration | float | 2.0 | s | 0 .. 60 |
        duration of the rehearsal before a test in realtime, with the valve at its safe value and
        the ground at rest; 0: none. A loop that does not keep its rate is refused
    """
)
UNFIT = "a rehearsal without fault: "
"""Start of the text if the rehearsal, or what the rig measured at rest, prevents a test."""
RUNS = "the rehearsal of the loop"
"""What is missing while the rehearsal runs."""

REFUSED = 0.1  # of the steps missed: a test of such a loop is another
WARNED = 0.001
ROOM = 0.8  # of a period, that the slowest hundredth may take at a rate that is proposed
_RATES = (5000.0, 2000.0, 1000.0, 500.0, 250.0, 200.0, 100.0, 50.0)  # Hz


@dataclass(frozen=True)
class Rehearsed:
    """Result of a rehearsal: reasons to refuse a test, and to warn; empty if there are none.

    If there was no rehearsal yet, ``asked`` is its duration, s; else 0.
    """

    refusal: str = ""
    warning: str = ""
    asked: float = 0.0


def check_peers(duration: float, nodes: Mapping[str, Mapping[str, Any]]) -> Rehearsed:
    """Check the rehearsal of a loop.

    Parameters
    ----------
    duration : float
        That a rehearsal shall take, s; 0: none is wanted.
    nodes : mapping
        Name of each node of the test -> its description, in which one that can rehearse says so.
        There is a rehearsal if all nodes of one loop can: none over a link or with several rigs.
    """
    if not duration or not all(nodes.get(name, {}).get(outcome.REHEARSES) for name in LOOP_NODES):
        return Rehearsed()
    found = nodes["rig"].get(outcome.REHEARSED)
    if found is None:
        return Rehearsed(asked=duration)
    try:
        steps, missed, rate = (float(found[key]) for key in ("steps", "missed", "rate_hz"))
        slowest = float(found["round_trip_alone_s"].get("p99", 0.0))
    except (KeyError, TypeError, ValueError, AttributeError):
        return Rehearsed("the rig reports a rehearsal that can't be read; see docs/hardware.md")
    if missed <= WARNED * steps:
        return Rehearsed()
    share = f"{missed:.0f} of {steps:.0f} steps without a command in time"
    trip = f"round trip p99 {1e3 * slowest:.2g} ms" if slowest else "no answer came"
    if missed < REFUSED * steps:
        return Rehearsed(warning=f"{rate:g} Hz is hard to keep here: {trip}, {share}")
    fits = [f"{r:g} Hz does" for r in _RATES if slowest and r < rate and slowest <= ROOM / r]
    remedy = [*fits[:1], "seft run --composed, --priority or another host may (docs/realtime.md)"]
    return Rehearsed(f"{rate:g} Hz does not fit here: {trip}, {share}; {'; '.join(remedy)}")


def with_biases(found: Rehearsed, rigs: Iterable[Mapping[str, Any]]) -> Rehearsed:
    """Add what the descriptions of rigs say of their biases to the result of a rehearsal."""
    from seft_plant_sim.calibration import check_biases  # numba, which the tables do not need

    if found.asked:
        return found
    for described in rigs:
        limits = group(described.get("parameters", {}), "limits")
        if not set(CHANNELS) <= set(limits):
            continue
        biases = check_biases(described.get(outcome.ZEROED), limits)
        texts = [text for text in (found.warning, biases.warning) if text]
        found = Rehearsed(found.refusal or biases.refusal, "; ".join(texts))
    return found


RAMPING_DOWN, AT_REST_KEY = "ramping_down", "at_rest"  # phases of the reference force
ALL_ANSWERED = "ended"
"""Its phase when the test has ended and it has answered the last state."""
RECORDING = "recording"
"""Phase of the recorder as long as the bag of a test is open, also after that test's end."""
CONFLICT = "one "
"""Start of the text if nodes were started with contradictory parameters."""
_OF_THE_TEST = [name for name, node in SETTINGS.items() if node == "reference_force"]
_IN_A_TEST = ("running", outcome.FINISHED, outcome.TRIPPED)  # phases of the rig


@dataclass(frozen=True)
class LastStatus:
    """The last status of a node, and when it came: s of an `AwakeClock`, and s of the test."""

    status: Status
    at: float
    test_s: float = 0.0

    @property
    def phase(self) -> str:
        """Phase that the node reports; empty if none."""
        return self.status.values.get("phase", "")


def missing(
    peers: Sequence[str],
    statuses: Mapping[str, LastStatus],
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
    statuses : mapping
        Node name -> last status; holds the supervisor's own too.
    descriptions : mapping
        Node name -> description with the node's parameters.
    now : float
        Time on the clock of `LastStatus.at`, s.
    timeout : float
        Silence after which a node counts as absent, s.
    rigs : sequence of RigAxes
        The test's.
    """
    absent = [n for n in peers if n not in statuses] + silent(peers, statuses, now, timeout)
    if absent:
        return "node " + ", ".join(sorted(absent, key=list(peers).index))
    undescribed = [node for node in peers if node not in descriptions]
    if undescribed:
        return "the parameters of " + ", ".join(undescribed)
    rig_nodes = [node for node in with_rigs([outcome.RIG], rigs) if node in peers]
    if conflict := _conflict(peers, descriptions, rig_nodes):
        return conflict
    topics = topics_of(rigs)
    for publisher in (*peers, "supervisor"):
        for topic in topics:
            if topic.publisher not in (publisher, ""):
                continue
            known = statuses[publisher].status.values.get(f"matched {topic.name}", "").split()
            wanted = {node for node in topic.subscribers if node in (*peers, "supervisor")}
            wanted.update(n for n in rig_nodes if descriptions[n].get("drive") == topic.name)
            if topic.recorded and "recorder" in peers:
                wanted.add("recorder")
            lost = sorted(wanted - set(known) - {publisher})
            if lost:
                return f"{publisher} to reach {', '.join(lost)} on {topic.name}"
            for node in sorted(wanted & set(statuses)):
                if statuses[node].status.values.get(f"senders {topic.name}") == "0":
                    return f"{node} to receive from {publisher} on {topic.name}"
    for node in rig_nodes:
        if statuses[node].phase in _IN_A_TEST:
            return f"the {node} to leave the last test"  # its end would count for the next one
    phases = {node: statuses[node].phase for node in statuses}
    if phases.get("reference_force") in (RAMPING_DOWN, AT_REST_KEY, ALL_ANSWERED):
        return "the reference force to leave the last test"
    if "recorder" in peers and phases["recorder"] == RECORDING:
        return "the recorder to save the last test"
    for node in peers:
        if why := statuses[node].status.values.get(outcome.WAITS):
            return f"the {node}, as {why}"
    return "" if phases.get("ground_motion") == "primed" else "the first of the ground motion"


def silent(
    peers: Sequence[str], statuses: Mapping[str, LastStatus], now: float, timeout: float
) -> list[str]:
    """List nodes that have been heard from, but not for longer than ``timeout`` seconds."""
    return [node for node in peers if node in statuses and now - statuses[node].at > timeout]


def silence(node: str, statuses: Mapping[str, LastStatus]) -> str:
    """Say since when a node has been silent, by the time of the test."""
    return f"node {node} has been silent since {statuses[node].test_s:.2f} s"


def _conflict(
    peers: Sequence[str], descriptions: Mapping[str, Mapping[str, Any]], rig_nodes: Sequence[str]
) -> str:
    """Name parameters of nodes that contradict each other; empty if none do."""

    def parameter(node: str, name: str) -> Any:
        return descriptions[node]["parameters"].get(name)

    for name, nodes in (*((name, peers) for name in (*FACTS, *_OF_THE_TEST)), ("pace", rig_nodes)):
        known = {node: parameter(node, name) for node in nodes}
        known = {node: value for node, value in known.items() if value is not None}
        for node, value in known.items():
            first = next(iter(known))
            if not agree(name, value, known[first]):
                return f"{CONFLICT}{name}: {first} has {known[first]}, {node} has {value}"
    return ""
