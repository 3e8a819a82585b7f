"""The topics of one node: what it publishes and reads, and who else is on them."""

from collections.abc import Callable
from dataclasses import replace

from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError, SeftError, WireError
from seft_msgs_py.node.senders import Authors, Message, Senders, connected_listeners
from seft_msgs_py.node.transport import Endpoint, Publisher, Send
from seft_msgs_py.node.turns import NodeProcess, ReadOne, Receive, drain
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.topics import LoopTopic, RigAxes, Topic, with_rigs

_POLL_PERIOD = 0.2  # s between two looks for other publishers
WARN_PERIOD = 1.0  # s
Handler = Callable[[bytes, int], None]
"""Takes a message's bytes and the wall-clock time in ns of its arrival."""


class Wiring:
    """Publishers and readers of a node on the graph.

    Attributes
    ----------
    rig : RigAxes
        The rig that the node belongs to; all axes, if it serves all rigs.
    name : str
        The node's name, with its rig's name if the test has several.
    refused : int
        Messages that were not acted upon.
    handled_at : float
        Time of the last message of the loop, s, monotonic.
    senders : Senders
        Publishers of the topics that it reads.
    """

    def __init__(self, process: NodeProcess, endpoint: Endpoint, experiment: Experiment) -> None:
        self._process, self._endpoint, self._clock = process, endpoint, process.clock
        self.senders = Senders(endpoint)
        self.rig, self._test_namespace = rig_of(endpoint, experiment)
        self.name = self.rig.node(endpoint.name)
        self.refused, self.handled_at = 0, 0.0
        self._warning, self._warned_at = "", -WARN_PERIOD  # first reason since the last warning
        self._polled_at = 0.0
        self._publishers: dict[str, Publisher] = {}
        self._readers: dict[str, ReadOne] = {}
        self._nodes = with_rigs(topics.NODES, experiment.rigs)
        self._authors: list[tuple[Authors, Receive]] = []

    def publisher(self, topic: Topic) -> Send:
        """Make the publisher of a topic; return the function that publishes message bytes."""
        publisher = self._endpoint.publish(replace(topic, name=self._name_here(topic)))
        self._publishers[topic.name] = publisher
        if not isinstance(topic, LoopTopic):
            return publisher.send
        return self._process.bus.sender(publisher.topic_name, publisher.send)

    def subscribe(
        self,
        topic: Topic,
        handler: Handler,
        depth: int | None = None,
        wake: bool = True,
        reliable: bool = True,
    ) -> None:
        """Give every message of a topic to ``handler`` as bytes, in the main thread.

        Parameters
        ----------
        handler : callable
            A `WireError` it raises is counted and logged as a warning.
        depth : int, optional
            Messages kept while the node is busy; default the topic's.
        wake : bool
            Whether a message ends the waiting; otherwise it is handled when no other has ended it,
            or by `catch_up`.
        reliable : bool
            Whether a lost message is sent again. For the loop that would be too late, and
            acknowledging takes a tenth of a step.
        """
        here, receive = replace(topic, name=self._name_here(topic)), self._guarded(handler, topic)
        if self._process.bus.serves(topic):
            full_name = self._endpoint.full_name(here.name)
            self.senders.add(topic, full_name)
            self._process.bus.subscribe(full_name, self.name, receive)
        else:
            subscription = self._endpoint.subscribe(here, depth, reliable)
            self.senders.add(topic, subscription.topic_name, subscription)
            if topic in (topics.DIAGNOSTICS, topics.DESCRIPTION):
                receive = self._of_authors(topic, subscription.topic_name, receive)
            read_one = self._process.add_subscription(subscription, receive, wake)
            self._readers[topic.name] = read_one

    def catch_up(self, topic: Topic) -> None:
        """Handle all messages of a topic that have arrived."""
        if topic.name in self._readers:  # those of this process have been delivered already
            drain(self._readers[topic.name])

    def refuse(self, reason: str) -> None:
        """Count a message that was not acted upon; a warning follows, at most once a second."""
        self.refused += 1
        self._warning = self._warning or reason

    def matched(self) -> dict[str, str]:
        """Names of the listeners of each topic, separated by blanks; number of publishers."""
        found = {f"senders {name}": str(n) for name, n in self.senders.counts().items()}
        for name, publisher in self._publishers.items():
            outside = connected_listeners(self._endpoint, publisher, self._test_namespace)
            inside = self._process.bus.listeners(publisher.topic_name)
            found[f"matched {name}"] = " ".join(sorted({*outside, *inside}))
        return found

    def name_unexpected_publishers(self, refused_before: int) -> str:
        """Name unexpected nodes that may be the cause of missing messages, to append to a reason.

        ``refused_before`` is the value of `refused` when the last message arrived.
        """
        refused, conflict = self.refused - refused_before, self.senders.conflict()
        text = f"; {refused} messages were refused meanwhile" if refused else ""
        return f"{text}; {conflict}" if conflict else text

    def warn(self) -> None:
        """Log refused messages and unexpected publishers; a chore.

        A call of a logger takes a millisecond, even if its own throttle suppresses the message.
        """
        now = self._clock.monotonic()
        if self._warning and now - self._warned_at >= WARN_PERIOD:
            self._endpoint.log("warning", f"refused ({self.refused} so far): {self._warning}")
            self._warning, self._warned_at = "", now
        if now - self._polled_at >= _POLL_PERIOD:
            self._polled_at = now
            if news := self.senders.poll():
                self._endpoint.log("warning", news)
            for authors, receive in self._authors:
                for message in authors.poll():
                    receive(*message)

    def _name_here(self, topic: Topic) -> str:
        """Name of a topic for this node, whose namespace may be a level below the test's."""
        if not self.rig.name or topic.name.startswith("/"):
            return topic.name
        return f"{self._test_namespace}/{topic.name}"

    def _guarded(self, handler: Handler, topic: Topic) -> Receive:
        """Wrap a handler: refuse invalid messages, and note the time of the last sample."""
        is_of_each_step = isinstance(topic, LoopTopic) and not topic.latched
        name, senders, monotonic = topic.name, self.senders, self._clock.monotonic

        def receive(raw: bytes, received_ns: int, gid: bytes) -> bool:
            if is_of_each_step:
                self.handled_at = monotonic()
            if senders.is_unexpected(name, gid):
                self.refused += 1
                return False
            try:
                handler(raw, received_ns)
            except WireError as error:
                self.refuse(str(error))
                return False
            except SeftError:
                raise  # the reason for the user why the node can't continue
            except Exception as error:
                self._process.fault(f"{self.name}, {name}", error)
                return False
            if topic == topics.EXPERIMENT_STATE:
                self.senders.follow(decode_state(raw).state)
            return True

        return receive

    def _of_authors(self, topic: Topic, full_name: str, receive: Receive) -> Receive:
        """Let through what nodes of the test tell of themselves."""
        authors = Authors(self._endpoint, topic, full_name, self._test_namespace, self._nodes)

        def receive_own(raw: bytes, received_ns: int, gid: bytes) -> bool:
            try:
                counts = authors.check(Message(raw, received_ns, gid))
            except WireError as error:
                self.refuse(str(error))
                return False
            if counts is False:
                self.refused += 1
                self.senders.refuse(topic.name, gid, authors.name_of(gid))
            return bool(counts) and receive(raw, received_ns, gid)

        self.senders.authors.append(authors)
        self._authors.append((authors, receive_own))
        return receive_own


def rig_of(endpoint: Endpoint, experiment: Experiment) -> tuple[RigAxes, str]:
    """Rig that a node belongs to, and the test's namespace without a slash at its end.

    Raises
    ------
    InputError
        If the node's namespace does not fit the rigs of the experiment.
    """
    namespace, name = endpoint.namespace, endpoint.name
    above, _, last = namespace.rpartition("/")
    rigs = {rig.name: rig for rig in experiment.rigs}
    whole = RigAxes.whole(experiment.axes)
    if "" in rigs or (name not in topics.RIG_NODES and last not in rigs):
        return whole, namespace
    known = " or ".join(f"-r __ns:={above if last in rigs else namespace}/{rig}" for rig in rigs)
    if name not in topics.RIG_NODES:
        raise InputError(f"{name} serves all rigs and can't be in {namespace}, one rig's namespace")
    if last not in rigs:
        raise InputError(
            f"{name} is in namespace {namespace or '/'}, but the axes {list(experiment.axes)} are "
            f"of several rigs; name its rig: --ros-args {known}"
        )
    return rigs[last], above
