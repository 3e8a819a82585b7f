"""The ROS graph for the monitor, and the supervisor's services.

Messages wait in the middleware until the monitor takes them, ten times a second: waking for each
message would cost more than all its other work. Lost messages of the loop are not sent again, so
that a slow monitor delays nobody.
"""

import asyncio
import os
import threading
from typing import Any

from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.subscription import Subscription
from seft_msgs_py.node.dds import DdsEndpoint
from seft_msgs_py.node.process import prepare_on_this_host
from seft_msgs_py.node.rclpy_interface import command_node, leave_graph, raw_subscription, take_all
from seft_msgs_py.node.senders import Follower
from seft_msgs_py.wire import topics
from std_srvs.srv import Trigger

from seft_ros.monitor.intake import Messages

_ANSWER_TIMEOUT_S = {"start": 1.0, "stop": 3.0, "estop": 3.0, "reset": 1.0}  # s, for an answer
_READ_DEPTH = 4096
_MAX_AT_ONCE = 8192
_TOPICS = (topics.GROUND_MOTION, topics.RIG_STATE, topics.REFERENCE_FORCE)
_DEPTHS = {topics.EXPERIMENT_STATE: 64, topics.DESCRIPTION: 64, topics.DIAGNOSTICS: 512}


class Graph:
    """A node that listens to a test.

    Parameters
    ----------
    namespace : str
        Of the test's topics and services; empty: none.

    Attributes
    ----------
    domain : int
        ROS domain.
    """

    def __init__(self, namespace: str = "") -> None:
        prepare_on_this_host()
        self._node = command_node(f"seft_monitor_{os.getpid()}", namespace or None)
        self.domain: int = self._node.context.get_domain_id()
        self._subscriptions: dict[str, Subscription] = {}
        self._test = Follower(DdsEndpoint(self._node), _DEPTHS)
        for topic in _TOPICS:
            self._subscribe(topic)
        # made now, so that discovery is complete when a stop is requested
        self._clients: dict[str, Any] = {
            name: self._node.create_client(Trigger, name) for name in _ANSWER_TIMEOUT_S
        }
        self._executor = SingleThreadedExecutor(context=self._node.context)
        self._executor.add_node(self._node)
        self._stopping = False
        self._thread = threading.Thread(target=self._serve_clients, daemon=True)
        self._thread.start()

    def take(self, topic: topics.Topic) -> Messages:
        """Take the new messages of a topic: bytes, and the wall-clock time in ns of their sending.

        Of the test's state and of what its nodes tell of themselves, strangers' messages are left
        out. A topic of one of several rigs is subscribed to at the first call.
        """
        if topic in _DEPTHS:
            return [(message.raw, message.at_ns) for message in self._test.take(topic)]
        if topic.name not in self._subscriptions:
            self._subscribe(topic)
        return take_all(self._subscriptions[topic.name], _MAX_AT_ONCE)

    def _subscribe(self, topic: topics.Topic) -> None:
        resent = topic.latched or not isinstance(topic, topics.LoopTopic)
        self._subscriptions[topic.name] = raw_subscription(self._node, topic, _READ_DEPTH, resent)

    async def call(self, service: str) -> tuple[bool, str]:
        """Call a service of the supervisor; return whether it was done, and its answer."""
        client = self._clients[service]
        if not client.service_is_ready():
            return False, f"{service} was not delivered: there is no supervisor on the graph"
        # on a thread of its own: it waits until the executor's thread has the answer
        patience = _ANSWER_TIMEOUT_S[service]
        response = await asyncio.to_thread(client.call, Trigger.Request(), patience)
        if response is None:
            return False, f"the supervisor did not answer {service} within {patience:g} s"
        return response.success, response.message

    def close(self) -> None:
        """Leave the graph."""
        self._stopping = True
        self._executor.wake()
        self._thread.join(timeout=3.0)
        self._executor.shutdown(timeout_sec=1.0)
        leave_graph(self._node)

    def _serve_clients(self) -> None:
        try:
            while not self._stopping and self._node.context.ok():
                self._executor.spin_once(timeout_sec=2.0)
        except (ExternalShutdownException, ShutdownException):
            return
