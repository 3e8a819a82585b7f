"""A node that is none of the test's, and publishes what it likes on the test's topics."""

from collections.abc import Callable

import numpy as np
import rclpy
from bad_messages import bad_messages
from rclpy.context import Context
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.node.rclpy_interface import (
    RclWaitSet,
    leave_graph,
    message_class,
    qos_profile,
    raw_subscription,
    taker,
)
from seft_msgs_py.wire.messages import Status, encode_status, encode_string
from seft_msgs_py.wire.topics import (
    DESCRIPTION,
    DIAGNOSTICS,
    GROUND_MOTION,
    LOOP_TOPICS,
    REFERENCE_FORCE,
    RIG_STATE,
    VALVE_COMMAND,
    LoopTopic,
    Topic,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec


class Hostile:
    """Sends every bad kind of message, raw."""

    def __init__(self, experiment: Experiment) -> None:
        self._context = Context()  # an `Observer` beside it has the default one
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("hostile", context=self._context, start_parameter_services=False)
        self._publishers: dict[Topic, Publisher] = {}
        self._experiment = experiment

    def join(self, *topics: Topic) -> None:
        """Publish on topics from now on; default all that are read in a test."""
        for topic in topics or (*LOOP_TOPICS, DIAGNOSTICS, DESCRIPTION):
            self._publishers[topic] = self._node.create_publisher(
                message_class(topic), topic.name, qos_profile(topic, depth=64)
            )

    def leave(self, topic: Topic) -> None:
        """Publish on a topic no more."""
        self._node.destroy_publisher(self._publishers.pop(topic))

    def answer(self, value: float, until: Callable[[], bool]) -> int:
        """Answer each rig/state with a valve command of its step; return how many.

        The messages are as good as the force controller's; only the value is not.
        """
        axes, timebase = self._experiment.axes, self._experiment.timebase
        states, commands = (TrajectoryCodec(t, axes, timebase) for t in (RIG_STATE, VALVE_COMMAND))
        subscription = raw_subscription(self._node, RIG_STATE, reliable=False)
        waiting = RclWaitSet(self._node.context, [subscription])
        take, count = taker(subscription), 0
        while not until():
            waiting.wait(0.1)
            while (taken := take()) is not None:
                step, _ = states.decode(taken[0])
                self.send(VALVE_COMMAND, commands.encode(step, np.full(len(axes), value)))
                count += 1
        self._node.destroy_subscription(subscription)
        return count

    def flood(self, topic: LoopTopic, count: int) -> None:
        """Send many bad messages as fast as they go."""
        bad = list(self.bad_messages(topic).values())
        for index in range(count):
            self.send(topic, bad[index % len(bad)])

    def send(self, topic: Topic, raw: bytes, times: int = 1) -> None:
        """Publish bytes as they are."""
        for _ in range(times):
            self._publishers[topic].publish(raw)

    def listeners(self, topic: Topic) -> int:
        """How many nodes listen to what is published here on a topic."""
        return self._publishers[topic].get_subscription_count()

    def is_heard(self) -> bool:
        """Whether all of the loop listen."""
        expected = {RIG_STATE: 3, VALVE_COMMAND: 2, REFERENCE_FORCE: 2, GROUND_MOTION: 2}
        return all(self.listeners(topic) >= count for topic, count in expected.items())

    def bad_messages(self, topic: LoopTopic) -> dict[str, bytes]:
        """One of each bad kind; stale ones are of step 0, and no step is that of a real one."""
        return bad_messages(topic, self._experiment)

    def slow_messages(self) -> list[tuple[Topic, bytes]]:
        """Bad ones on the topics that supervisor and recorder read."""
        garbage = bytes(range(256))
        running = encode_status(Status("experiment", 0, "running", values={"steps": "x"}))
        return [
            (DIAGNOSTICS, garbage),
            (DIAGNOSTICS, running),
            (DIAGNOSTICS, b"\x00\x01\x00\x00"),
            (DESCRIPTION, garbage),
            (DESCRIPTION, encode_string("{")),
            (DESCRIPTION, encode_string('{"node": ["rig"]}')),
            (DESCRIPTION, encode_string("[" * 5000)),
        ]

    def close(self) -> None:
        """Leave the graph."""
        leave_graph(self._node)
