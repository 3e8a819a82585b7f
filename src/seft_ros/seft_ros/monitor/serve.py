"""The monitor's process: polls the graph ten times a second, and serves the page."""

import asyncio
import contextlib
import errno
import gc
import os
import signal
import socket
from collections.abc import Callable

from seft_msgs_py.errors import InputError
from tornado.httpserver import HTTPServer

from seft_ros.monitor.access import Tokens, is_loopback

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
    from seft_ros.monitor.graph import Graph
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
