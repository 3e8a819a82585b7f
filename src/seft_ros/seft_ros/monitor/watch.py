"""The graph polled again and again: what is new, for all pages that are open."""

import json
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.messages import decode_description, decode_diagnostics, decode_status
from seft_msgs_py.wire.timebase import Timebase
from seft_msgs_py.wire.topics import (
    DESCRIPTION,
    DIAGNOSTICS,
    EXPERIMENT_STATE,
    GROUND_MOTION,
    REFERENCE_FORCE,
    RIG_STATE,
    Topic,
)

from seft_ros.monitor.history import RECENT, envelope_frame, samples_frame
from seft_ros.monitor.intake import Intake
from seft_ros.monitor.session import Session

if TYPE_CHECKING:  # a watch needs no ROS
    from seft_ros.monitor.server import Graph

TELLERS = ("rig", "reference_force", "force_controller", "ground_motion", "supervisor")
"""Who is believed about rate and axes, the first first."""

LATEST = 1.0  # s from a press to the supervisor

Frame = str | bytes


class Watch:
    """Moves what comes from a graph to a `Session` and an `Intake`, and makes frames of it.

    Parameters
    ----------
    graph : Graph
        What is watched.
    now : callable, optional
        Time that requests of pages are dated by, s.
    """

    def __init__(self, graph: "Graph", now: Callable[[], float] = time.monotonic) -> None:
        self._graph, self._now = graph, now
        self.session = Session()
        self.intake: Intake | None = None
        self._told: dict[str, str] = {}
        self._refused = 0

    def poll(self) -> list[Frame]:
        """Take what has come; give what is new, for pages that know the rest."""
        self._hear_nodes()
        intake = self.intake
        if intake is None:
            return self._news()  # samples wait in the middleware until they can be read
        take, before = self._graph.take, intake.number
        intake.motion(take(GROUND_MOTION))
        forces = take(REFERENCE_FORCE)  # before the states: of each the state has come, too
        new = intake.samples([take(RIG_STATE.of(rig)) for rig in intake.rigs], forces)
        if intake.number != before:  # also without word of the supervisor
            self.session.begin()
        return self._news() + [samples_frame(intake.number, stretch) for stretch in new]

    def everything(self) -> list[Frame]:
        """Give all that a page needs which has just been opened."""
        frames: list[Frame] = [*self._told.values(), self._time()]
        if self.intake is not None and self.intake.number:
            history, number = self.intake.history, self.intake.number
            frames.append(envelope_frame(number, history.envelope))
            frames.append(samples_frame(number, history.recent(), RECENT))
        return frames

    def lateness(self, state: int, at_ms: float) -> str:
        """Say why a request to start or reset is not carried out; empty if it may be.

        Parameters
        ----------
        state : int
            `Session.number` when it was made.
        at_ms : float
            Time of this process when it was made, as the page knows it, ms.
        """
        if not 0.0 <= (late := self._now() - at_ms / 1e3) <= LATEST:
            return f"it came {late:.1f} s late, and only a stop may; press it again"
        if state != self.session.number:
            return f"the test is {self.session.summary()['state']} by now; look, and press it again"
        return ""

    def _hear_nodes(self) -> None:
        session = self.session
        session.poll()
        for node, description in self._decoded(DESCRIPTION, decode_description):
            session.on_description(node, description["parameters"])
            self._follow_description()
        for status in self._decoded(EXPERIMENT_STATE, decode_status):
            if session.on_state(status):
                session.begin()
                if self.intake is not None:
                    self.intake.clear()
        dt = self.intake.timebase.dt if self.intake else 0.0
        for _, statuses in self._decoded(DIAGNOSTICS, decode_diagnostics):
            session.on_diagnostics(statuses, dt)

    def _decoded[Content](
        self, topic: Topic, decode: Callable[[bytes], Content]
    ) -> Iterator[Content]:
        """Give what has come on a topic, and count what is not understood."""
        for raw, _ in self._graph.take(topic):
            try:
                content = decode(raw)
            except WireError:
                self._refused += 1
            else:
                yield content

    def _follow_description(self) -> None:
        """Make what takes in samples anew where rate or axes have changed."""
        sections = self.session.sections
        teller = next((node for node in TELLERS if node in sections), None)
        if teller is None:
            return
        try:
            timebase = Timebase.from_rate(float(sections[teller]["rate"]))
            axes = tuple(str(axis) for axis in sections[teller]["axes"])
        except (InputError, KeyError, TypeError, ValueError):
            self._refused += 1
            return
        intake = self.intake
        if intake is None or intake.timebase != timebase or intake.signals.axes != axes:
            intake = self.intake = Intake(axes, timebase, intake.number if intake else 0)
        intake.describe(dict(sections))

    def _news(self) -> list[Frame]:
        """Make texts of what the nodes say; give those that are not as they were."""
        session, intake = self.session, self.intake
        test: dict[str, Any] = {"domain": self._graph.domain}
        if intake is not None:
            test |= {
                "test": intake.number,
                "dt": intake.timebase.dt,
                "signals": intake.signals.layout(),
                "reference_note": intake.reference_note,
            }
        refused = self._refused + (intake.refused if intake else 0)
        messages: dict[str, dict[str, Any]] = {
            "test": test,
            "status": {**session.summary(), "refused": refused},
            "events": {"events": session.events()},
            "motion": {"motion": intake.own_motion if intake else {}},
            "round_trips": {"round_trips": session.round_trips},
        }
        news: list[Frame] = []
        for kind, content in messages.items():
            text = json.dumps({"kind": kind, **content}, separators=(",", ":"))
            if self._told.get(kind) != text:
                self._told[kind] = text
                news.append(text)
        return [*news, self._time()]

    def _time(self) -> str:
        """Tell the time of this process: that it lives, and when a page was told what it shows."""
        return json.dumps({"kind": "time", "at": round(1e3 * self._now())})
