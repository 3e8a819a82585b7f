"""The monitor's process: polls the graph ten times a second, and sends the news to its pages."""

import asyncio
import contextlib
import errno
import gc
import json
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire import topics
from seft_msgs_py.wire.experiment_state import decode_state
from seft_msgs_py.wire.messages import decode_description, decode_diagnostics

from seft_ros.monitor.history import RECENT_FRAME, Frame, envelope_frame, samples_frame
from seft_ros.monitor.intake import Intake
from seft_ros.monitor.session import Session

if TYPE_CHECKING:  # Watch itself needs no ROS
    from seft_ros.monitor.graph import Graph

PERIOD = 0.1  # s
LARGEST_REQUEST = 4096  # bytes
NICE = 3
"""The nodes precede the monitor, and it still answers a stop on a busy machine."""
_LATEST = 1.0  # s from a press to the supervisor


class Watch:
    """Moves messages from a graph to a `Session` and an `Intake`, and makes frames of them.

    Parameters
    ----------
    graph : Graph
        The watched graph.
    now : callable, optional
        Clock for the times of requests, s.
    """

    def __init__(self, graph: "Graph", now: Callable[[], float] = time.monotonic) -> None:
        self._graph, self._now = graph, now
        self.session = Session()
        self.intake: Intake | None = None
        self._sent: dict[str, str] = {}
        self._refused = 0

    def poll(self) -> list[Frame]:
        """Take the messages that have arrived; give the news, for pages that have the others."""
        self._receive_statuses()
        intake = self.intake
        if intake is None:
            return self._news()  # samples wait in the middleware until they can be read
        take, before = self._graph.take, intake.number
        intake.motion(take(topics.GROUND_MOTION))
        forces = take(topics.REFERENCE_FORCE)  # before the states: so the state of each has arrived
        new = intake.samples([take(topics.RIG_STATE.of(rig)) for rig in intake.rigs], forces)
        if intake.number != before:  # also without a message of the supervisor
            self.session.begin()
        return self._news() + [samples_frame(intake.number, stretch) for stretch in new]

    def everything(self) -> list[Frame]:
        """Give all frames for a newly opened page."""
        frames: list[Frame] = [*self._sent.values(), self._time()]
        if self.intake is not None and self.intake.number:
            history, number = self.intake.history, self.intake.number
            frames.append(envelope_frame(number, history.envelope))
            frames.append(samples_frame(number, history.recent(), RECENT_FRAME))
        return frames

    def lateness(self, state: int, at_ms: float) -> str:
        """Say why a request to start or reset is not carried out; empty if it may be.

        Parameters
        ----------
        state : int
            `Session.number` at the time of the request.
        at_ms : float
            Time of the request by the clock of this process, as known to the page, ms.
        """
        if not 0.0 <= (late := self._now() - at_ms / 1e3) <= _LATEST:
            return f"it arrived {late:.1f} s late, which only a stop may do; press it again"
        if state != self.session.number:
            return f"the test is now {self.session.summary()['state']}; check that, and press again"
        return ""

    def _receive_statuses(self) -> None:
        session = self.session
        session.poll()
        for node, description in self._decoded(topics.DESCRIPTION, decode_description):
            session.on_description(node, description["parameters"])
            self._follow_description()
        for test in self._decoded(topics.EXPERIMENT_STATE, decode_state):
            if session.on_state(test):
                session.begin()
                if self.intake is not None:
                    self.intake.clear()
        dt = self.intake.timebase.dt if self.intake else 0.0
        for _, statuses in self._decoded(topics.DIAGNOSTICS, decode_diagnostics):
            session.on_diagnostics(statuses, dt)

    def _decoded[Content](
        self, topic: topics.Topic, decode: Callable[[bytes], Content]
    ) -> Iterator[Content]:
        """Decode the messages of a topic, and count those that can't be decoded."""
        for raw, _ in self._graph.take(topic):
            try:
                yield decode(raw)
            except WireError:
                self._refused += 1

    def _follow_description(self) -> None:
        """Make a new `Intake` if rate or axes have changed."""
        sections, intake = self.session.sections, self.intake
        teller = next((node for node in topics.NODES if node in sections), None)  # all agree
        if teller is None:
            return
        try:
            timebase = topics.Timebase.from_rate(float(sections[teller]["rate"]))
            axes = tuple(str(axis) for axis in sections[teller]["axes"])
        except (InputError, KeyError, TypeError, ValueError):
            self._refused += 1
            return
        if intake is None or intake.timebase != timebase or intake.signals.axes != axes:
            intake = self.intake = Intake(axes, timebase, intake.number if intake else 0)
        intake.describe(dict(sections))

    def _news(self) -> list[Frame]:
        """Make the page's texts from the nodes' messages; give those that have changed."""
        session, intake = self.session, self.intake
        test: dict[str, Any] = {"domain": self._graph.domain}
        if intake is not None:
            test |= {"test": intake.number, "dt": intake.timebase.dt}
            test |= {"signals": intake.signals.layout(), "reference_note": intake.reference_note}
        refused = self._refused + (intake.refused if intake else 0)
        messages: dict[str, dict[str, Any]] = {
            "test": test,
            "status": {**session.summary(), "refused": refused},
            "events": {"events": list(session.events)},
            "motion": {"motion": intake.own_motion if intake else {}},
            "round_trips": {"round_trips": session.round_trips},
        }
        news: list[Frame] = []
        for kind, content in messages.items():
            text = json.dumps({"kind": kind, **content}, separators=(",", ":"))
            if self._sent.get(kind) != text:
                self._sent[kind] = text
                news.append(text)
        return [*news, self._time()]

    def _time(self) -> str:
        """Give the time of this process: a sign of life, and the age of a page's content."""
        return json.dumps({"kind": "time", "at": round(1e3 * self._now())})


def page_address(host: str, port: int, token: str) -> str:
    """Address of the page for a browser on this host."""
    if host in ("", "0.0.0.0", "::"):
        host = "127.0.0.1"
    text = f"[{host}]" if ":" in host else host
    return f"http://{text}:{port}/?token={token}"


def listen(host: str, port: int) -> socket.socket:
    """Take a port, 0 for any; of a name with several addresses the first IPv4 address.

    Raises
    ------
    InputError
        If it is not available.
    """
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, _, _, _, address = min(found, key=lambda each: each[0] != socket.AF_INET)
        listening = socket.create_server(address[:2], family=family, backlog=128)
    except (OSError, UnicodeError) as error:
        number = getattr(error, "errno", None) or 0
        reason = os.strerror(number) if number > 0 else getattr(error, "strerror", str(error))
        remedy = "another seft monitor may use it; give another port with --port"
        how = remedy if number == errno.EADDRINUSE else "see --host and --port"
        raise InputError(f"can't listen at {host}:{port} ({reason}); {how}") from None
    listening.setblocking(False)
    return listening


def keep_off_the_loop() -> None:
    """Keep off the loop's core, the first one, and have low priority on the others.

    Call this before other threads are started: they inherit both.
    """
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) > 1:
        os.sched_setaffinity(0, cores[1:])
    with contextlib.suppress(OSError):
        os.nice(NICE)


def serve_monitor(
    listening: socket.socket, token: str, namespace: str, ready: Callable[[], None]
) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Parameters
    ----------
    listening : socket
        From `listen`.
    token : str
        Of the pages.
    namespace : str
        Of the test's topics.
    ready : callable
        Called when the page can be opened.
    """
    from tornado.httpserver import HTTPServer

    from seft_ros.monitor.graph import Graph
    from seft_ros.monitor.web import Pages, application

    graph = Graph(namespace)
    try:
        watch = Watch(graph)
        pages = Pages(watch.everything)
        port = listening.getsockname()[1]
        web = application(token, port, pages, graph.call, watch.lateness)

        async def run() -> None:
            stopping = asyncio.Event()
            loop = asyncio.get_running_loop()
            for number in (signal.SIGINT, signal.SIGTERM):
                loop.add_signal_handler(number, stopping.set)
            server = HTTPServer(web, max_body_size=LARGEST_REQUEST)
            server.add_socket(listening)
            gc.collect()
            gc.freeze()  # later collections skip the existing objects
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
