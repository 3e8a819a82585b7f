"""The graph as the monitor hears it, and the supervisor's services.

Messages wait in the middleware until they are asked for, ten times a second: waking for each
would cost more than all else that the monitor does. What comes in each step is not sent again
when it is lost, so that a monitor that is held up holds up nobody.

The monitor's process: polls the graph ten times a second, and serves the page.
"""

import asyncio
import contextlib
import errno
import gc
import os
import signal
import socket
import threading
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.client import Client
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from seft_msgs_py.errors import InputError
from seft_msgs_py.node.exit_watchdog import leave_graph
from seft_msgs_py.node.middleware import prepare_on_this_host
from seft_msgs_py.node.wait_set import raw_subscription, take_all
from seft_msgs_py.wire.topics import (
    DESCRIPTION,
    DIAGNOSTICS,
    EXPERIMENT_STATE,
    GROUND_MOTION,
    REFERENCE_FORCE,
    RIG_STATE,
    LoopTopic,
    Topic,
)
from std_srvs.srv import Trigger
from tornado.httpserver import HTTPServer

from seft_ros.monitor.access import Tokens, is_loopback
from seft_ros.monitor.intake import Messages

SERVICES = ("start", "stop", "estop", "reset")
PATIENCE = {"start": 1.0, "stop": 3.0, "estop": 3.0, "reset": 1.0}  # s for an answer
READ_DEPTH = 4096
MOST_AT_ONCE = 8192
_TOPICS = (EXPERIMENT_STATE, DESCRIPTION, DIAGNOSTICS, GROUND_MOTION, RIG_STATE, REFERENCE_FORCE)
_DEPTHS = {EXPERIMENT_STATE: 64, DESCRIPTION: 64, DIAGNOSTICS: 512}


class Graph:
    """A node that listens to a test.

    Parameters
    ----------
    namespace : str
        In which the test's topics and services are; empty: none.

    Attributes
    ----------
    domain : int
        ROS domain.
    """

    def __init__(self, namespace: str = "") -> None:
        prepare_on_this_host()
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = Node(
            f"seft_monitor_{os.getpid()}",
            namespace=namespace or None,
            start_parameter_services=False,
            enable_rosout=False,
        )
        self.domain: int = self._node.context.get_domain_id()
        self._subscriptions: dict[str, Subscription] = {}
        for topic in _TOPICS:
            self._subscribe(topic)
        # made now, and so found by the time that a stop is wanted
        self._clients: dict[str, Client] = {
            name: self._node.create_client(Trigger, name) for name in SERVICES
        }
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._stopping = False
        self._thread = threading.Thread(target=self._serve_clients, daemon=True)
        self._thread.start()

    def take(self, topic: Topic) -> Messages:
        """Take what has come on a topic: bytes, and the wall-clock time in ns of their sending.

        A topic of one of several rigs is listened to from the first time on.
        """
        if topic.name not in self._subscriptions:
            self._subscribe(topic)
        return take_all(self._subscriptions[topic.name], MOST_AT_ONCE)

    def _subscribe(self, topic: Topic) -> None:
        of_each_step = isinstance(topic, LoopTopic) and not topic.latched
        self._subscriptions[topic.name] = raw_subscription(
            self._node, topic, _DEPTHS.get(topic, READ_DEPTH), not of_each_step
        )

    async def call(self, service: str) -> tuple[bool, str]:
        """Call a service of the supervisor; return whether it was done, and its answer."""
        client = self._clients[service]
        if not client.service_is_ready():
            return False, f"{service} was not delivered: there is no supervisor on the graph"
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[Any] = loop.create_future()

        def answer(response: Any) -> None:
            if not answered.done():
                answered.set_result(response)

        pending = client.call_async(Trigger.Request())
        pending.add_done_callback(lambda done: loop.call_soon_threadsafe(answer, done.result()))
        try:
            response = await asyncio.wait_for(answered, PATIENCE[service])
        except TimeoutError:
            client.remove_pending_request(pending)
            return False, f"the supervisor did not answer {service} within {PATIENCE[service]:g} s"
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
            while not self._stopping and rclpy.ok():
                self._executor.spin_once(timeout_sec=2.0)
        except (ExternalShutdownException, ShutdownException):
            return


PERIOD = 0.1  # s
NICE = 3
"""Gives way to the nodes, and still answers a stop on a busy machine."""


def listen(host: str, port: int) -> socket.socket:
    """Take a port, 0 for any; a name that stands for several addresses means the first of IPv4.

    Raises
    ------
    InputError
        If it can't be had.
    """
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, _, _, _, address = min(found, key=lambda each: each[0] != socket.AF_INET)
        listening = socket.create_server(address[:2], family=family, backlog=128)
    except (OSError, UnicodeError) as error:
        number = getattr(error, "errno", None) or 0
        reason = os.strerror(number) if number > 0 else getattr(error, "strerror", str(error))
        mend = "another seft monitor may have it; name another port with --port"
        how = mend if number == errno.EADDRINUSE else "see --host and --port"
        raise InputError(f"can't listen at {host}:{port} ({reason}); {how}") from None
    listening.setblocking(False)
    return listening


def keep_off_the_loop() -> None:
    """Leave the loop's core, the first one, to the loop, and the others to it where it needs them.

    To be called before other threads are there: they inherit both.
    """
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) > 1:
        os.sched_setaffinity(0, cores[1:])
    with contextlib.suppress(OSError):
        os.nice(NICE)


def serve(
    listening: socket.socket, host: str, tokens: Tokens, namespace: str, ready: Callable[[], None]
) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Parameters
    ----------
    listening : socket
        As `listen` gives it for ``host``.
    tokens : Tokens
        What pages must know.
    namespace : str
        Of the test's topics.
    ready : callable
        Called when the page can be opened.
    """
    from seft_ros.monitor.server import Graph
    from seft_ros.monitor.watch import Watch
    from seft_ros.monitor.web import Pages, application

    graph = Graph(namespace)
    try:
        watch = Watch(graph)
        pages = Pages(watch.everything)
        port = listening.getsockname()[1]
        local = is_loopback(host)
        web = application(tokens, local, port, pages, graph.call, watch.lateness)

        async def run() -> None:
            stopping = asyncio.Event()
            loop = asyncio.get_running_loop()
            for number in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(number, stopping.set)
            server = HTTPServer(web, idle_connection_timeout=60)
            server.add_socket(listening)
            gc.collect()
            gc.freeze()  # what is here stays: no later collection looks at it
            ready()
            while not stopping.is_set():
                pages.send(watch.poll())
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(stopping.wait(), PERIOD)
            server.stop()
            pages.close()
            await server.close_all_connections()

        asyncio.run(run())
    finally:
        graph.close()
