"""One look after another at a graph: what is new, for all pages that are open."""

import json
from typing import Any, Protocol

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

from seft_ros.monitor.frames import RECENT, envelope_frame, samples_frame
from seft_ros.monitor.intake import Intake, Messages
from seft_ros.monitor.session import Session

TELLERS = ("rig", "reference_force", "force_controller", "ground_motion", "supervisor")
"""Who is believed about rate and axes, the first first."""

Frame = str | bytes


class Source(Protocol):
    """Where messages come from."""

    domain: int

    def take(self, topic: Topic) -> Messages:
        """Take what has come on a topic."""


class Watch:
    """Moves what comes from a graph to a `Session` and an `Intake`, and makes frames of it.

    Parameters
    ----------
    graph : Source
        What is watched.
    """

    def __init__(self, graph: Source) -> None:
        self._graph = graph
        self.session = Session()
        self.intake: Intake | None = None
        self._told: dict[str, str] = {}
        self._refused = 0

    def look(self) -> list[Frame]:
        """Take what has come; give what is new, for pages that know the rest."""
        self._hear_nodes()
        intake = self.intake
        if intake is None:
            return self._news()  # samples wait in the middleware until they can be read
        take = self._graph.take
        rigs = [RIG_STATE.of(rig) for rig in intake.rigs]
        motion, forces = take(GROUND_MOTION), take(REFERENCE_FORCE)
        states = [take(topic) for topic in rigs]
        before = intake.number
        intake.motion(motion)
        new = intake.samples(states, forces)
        if intake.number != before:
            self.session.begin()
        return self._news() + [samples_frame(intake.number, stretch) for stretch in new]

    def everything(self) -> list[Frame]:
        """Give all that a page needs which has just been opened."""
        frames: list[Frame] = list(self._told.values())
        if self.intake is not None and self.intake.number:
            history, number = self.intake.history, self.intake.number
            frames.append(envelope_frame(number, history.envelope))
            frames.append(samples_frame(number, history.recent(), RECENT))
        return frames

    def _hear_nodes(self) -> None:
        session, take = self.session, self._graph.take
        session.look()
        for raw, _ in take(DESCRIPTION):
            try:
                node, description = decode_description(raw)
                session.on_description(node, description["parameters"])
            except WireError:
                self._refused += 1
            else:
                self._follow_description()
        for raw, _ in take(EXPERIMENT_STATE):
            try:
                begins = session.on_state(decode_status(raw))
            except WireError:
                self._refused += 1
            else:
                if begins and self.intake is not None:
                    self.intake.expect()
        dt = self.intake.timebase.dt if self.intake else 0.0
        for raw, _ in take(DIAGNOSTICS):
            try:
                session.on_diagnostics(decode_diagnostics(raw)[1], dt)
            except WireError:
                self._refused += 1

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
        messages: dict[str, dict[str, Any]] = {
            "test": self._test(),
            "status": {**self.session.told(), "refused": self._refused_messages()},
            "events": {"events": self.session.events()},
            "motion": {"motion": self.intake.own_motion if self.intake else {}},
            "round_trips": {"round_trips": self.session.round_trips},
        }
        news: list[Frame] = []
        for kind, content in messages.items():
            text = json.dumps({"kind": kind, **content}, separators=(",", ":"))
            if self._told.get(kind) != text:
                self._told[kind] = text
                news.append(text)
        return news

    def _test(self) -> dict[str, Any]:
        told: dict[str, Any] = {"domain": self._graph.domain}
        if (intake := self.intake) is not None:
            told |= {
                "test": intake.number,
                "dt": intake.timebase.dt,
                "signals": intake.signals.told(),
                "reference_note": intake.reference_note,
            }
        return told

    def _refused_messages(self) -> int:
        return self._refused + (self.intake.refused if self.intake else 0)
