"""A node that is none of the test's, and publishes what it likes on the test's topics."""

import numpy as np
import rclpy
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
from seft_msgs_py.wire.topics import (
    RIG_STATE,
    VALVE_COMMAND,
    Topic,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec


class Hostile:
    """Sends what it likes, and valve commands that are as good as the true ones."""

    def __init__(self, experiment: Experiment) -> None:
        self._context = Context()  # an `Observer` beside it has the default one
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node("hostile", context=self._context, start_parameter_services=False)
        self._publishers: dict[Topic, Publisher] = {}
        self._experiment = experiment

    def join(self, *topics: Topic) -> None:
        """Publish on topics from now on."""
        for topic in topics:
            self._publishers[topic] = self._node.create_publisher(
                message_class(topic), topic.name, qos_profile(topic, depth=64)
            )

    def answer(self, value: float, count: int) -> None:
        """Answer so many rig/states, each with a valve command of its step.

        The messages are as good as the force controller's; only the value is not.
        """
        axes, timebase = self._experiment.axes, self._experiment.timebase
        states, commands = (TrajectoryCodec(t, axes, timebase) for t in (RIG_STATE, VALVE_COMMAND))
        subscription = raw_subscription(self._node, RIG_STATE, reliable=False)
        waiting = RclWaitSet(self._node.context, [subscription])
        take = taker(subscription)
        while count > 0:
            waiting.wait(0.1)
            while (taken := take()) is not None:
                step, _ = states.decode(taken[0])
                self.send(VALVE_COMMAND, commands.encode(step, np.full(len(axes), value)))
                count -= 1
        self._node.destroy_subscription(subscription)

    def send(self, topic: Topic, raw: bytes) -> None:
        """Publish bytes as they are."""
        self._publishers[topic].publish(raw)

    def listeners(self, topic: Topic) -> int:
        """How many nodes listen to what is published here on a topic."""
        return self._publishers[topic].get_subscription_count()

    def close(self) -> None:
        """Leave the graph."""
        leave_graph(self._node)
