"""Node ``recorder``: writes every message of a test, as received, into a bag.

It keeps the messages before the start that belong to the test (descriptions, ground motion), opens
a bag when the test runs, and closes it when the test has ended and its topics are silent. The next
test waits for that, and for a place where its bag can be made. The parameter ``on_loss`` says
whether a test continues if its bag is lost; it is recorded in any case.
"""

import json
from collections import Counter, deque

from seft_msgs_py.errors import ExperimentError
from seft_msgs_py.node.host import FIRST_NICENESS, boot
from seft_msgs_py.node.node_shell import NodeBody, NodeKind, NodeShell
from seft_msgs_py.node.wiring import Handler
from seft_msgs_py.wire import messages, topics
from seft_msgs_py.wire.experiment_state import ExperimentState, decode_state
from seft_msgs_py.wire.outcome import ENDED, MOVING, RECORDED, RIG, WAITS, State
from seft_msgs_py.wire.topics import LoopTopic, Topic, topics_of
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.bags.bag_writer import BagWriter, bag_place, why_not_writable
from seft_ros.bags.recording import describe_environment
from seft_ros.test_run.parameter_tables import RECORDER_TABLE, TABLES
from seft_ros.test_run.peers import ALL_ANSWERED, RECORDING
from seft_ros.test_run.stall_watch import StallWatch

_SILENCE = 0.3  # s without a message of a step: the last one has arrived
LONG_SILENCE = 3.5  # s, if messages are missing: DDS may resend them every 3 s only
LONGEST_DRAIN = 15.0  # s
TICK = 0.02  # s
PLACE_PERIOD = 0.5  # s between two checks of the next bag's place, or of a place to save it
_READ_DEPTH = 4096  # messages that may wait while the recorder stalls


class RecorderNode(NodeBody):
    """Moves bytes from topics to a bag."""

    def __init__(self, shell: NodeShell) -> None:
        super().__init__(shell)
        self._section = shell.experiment["recorder"]
        axes, timebase = shell.experiment.axes, shell.experiment.timebase
        self._motion_codec = TrajectoryCodec(topics.GROUND_MOTION, axes, timebase)
        self._descriptions: dict[str, bytes] = {}
        self._before: deque[tuple[Topic, bytes, int]] = deque(maxlen=20_000)
        self._bag: BagWriter | None = None
        self._reason = self._unsaved = ""  # to ramp the test down; why its bag can't be saved
        self._checked_at = -PLACE_PERIOD
        self._steps = 0  # of the next test
        self._phase = "idle"
        self._ended_at: float | None = None
        self._next_began = False  # ground motion of the next test has arrived
        self._values = {"phase": "idle"}
        self._is_trip_complete = True  # whether the reason of a trip is complete
        self._force_phase = ""  # of the reference force
        self._step_message_at = 0.0
        self._samples = Counter[str]()  # by topic
        self._expected = 0  # of each
        self._environment = describe_environment("run")  # asks git once, before a test runs
        self._watch: StallWatch | None = None
        rigs = shell.experiment.rigs
        self._rig_states = [topics.RIG_STATE.of(rig).name for rig in rigs]
        self._paced_by = rigs[0].node(RIG)
        # the state first: it says to which test a ground motion belongs that waits with it
        found = sorted(topics_of(rigs), key=lambda topic: topic != topics.EXPERIMENT_STATE)
        self._topics = [topic for topic in found if topic.recorded]
        for topic in self._topics:
            shell.subscribe(topic, self._receiver(topic), depth=_READ_DEPTH, wake=False)

    def run(self) -> None:
        """Record until the node ends; then close an open bag, and end the watch of a next test."""
        try:
            super().run()
        finally:
            for topic in self._topics:
                self._shell.catch_up(topic)
            self._close_or_lose()
            if self._watch is not None:
                self._watch.end()

    def period(self) -> float:
        """Time between two polls, s."""
        return TICK

    def begin(self) -> None:
        """Report that no test runs."""
        self._report("idle")

    def poll(self) -> None:
        """Keep the bag flushed, and close it when the test has ended."""
        if self._bag is None:
            self._check_place()
            return
        self._bag.flush_if_due()
        self._report_trouble(self._bag)
        self._values = {**self._values, RECORDED: str(self._recorded())}
        self._shell.note(self._status())
        if self._ended_at is None:
            return
        now = self._clock.monotonic()
        complete = self._recorded() >= self._expected and self._is_trip_complete
        if self._phase == State.DONE and "reference_force" in self._descriptions:
            complete &= self._force_phase == ALL_ANSWERED
        patience = _SILENCE if complete else LONG_SILENCE
        silent = now - max(self._step_message_at, self._ended_at) > patience
        over = silent or now - self._ended_at > LONGEST_DRAIN
        if over and now - self._checked_at >= PLACE_PERIOD:
            self._checked_at = now
            self._close()

    def _report_trouble(self, bag: BagWriter) -> None:
        """Report trouble with the bag; as a reason to end the test, if ``on_loss`` says so."""
        if bag.trouble and (self._section["on_loss"] == "stop" or bag.is_full):
            self._reason = f"the recorder's bag is lost: {bag.trouble}"
        found = {"reason": self._reason, "problem": self._unsaved or bag.trouble}
        if not found.items() <= self._values.items():
            self._report(RECORDING, **found)

    def _receiver(self, topic: Topic) -> Handler:
        of_a_step = topic == topics.ESTIMATES or isinstance(topic, LoopTopic)

        def receive(raw: bytes, now: int) -> None:
            if of_a_step:
                self._step_message_at = self._clock.monotonic()
            if topic == topics.DESCRIPTION:
                node, _ = messages.decode_description(raw)
                self._descriptions[node] = raw
            if topic == topics.EXPERIMENT_STATE:
                self._follow(decode_state(raw))
            if topic == topics.GROUND_MOTION and self._is_of_the_next_test(raw):
                self._keep(topic, raw, now)
            elif self._bag is not None:
                self._bag.write(topic, raw, now)
                self._samples[topic.name] += 1
            elif of_a_step:
                self._keep(topic, raw, now)
            if topic == topics.DIAGNOSTICS:
                for status in messages.decode_diagnostics(raw)[1]:
                    if status.name == "reference_force":
                        self._force_phase = status.values.get("phase", "")

        return receive

    def _keep(self, topic: Topic, raw: bytes, now: int) -> None:
        """Keep messages before the bag is open; a new ground motion replaces an old one."""
        if topic == topics.GROUND_MOTION and self._motion_codec.decode(raw)[0] == 0:
            self._before.clear()
        self._before.append((topic, raw, now))

    def _is_of_the_next_test(self, motion: bytes) -> bool:
        """Say whether a chunk belongs to a test after that of the open bag."""
        if self._ended_at is None or self._bag is None:
            return False
        self._next_began |= self._motion_codec.decode(motion)[0] == 0
        return self._next_began

    def _follow(self, test: ExperimentState) -> None:
        phase = test.state
        self._steps = test.steps or 0
        if phase == State.READY and self._watch is None:
            self._watch = StallWatch()
        if phase in MOVING and self._phase not in MOVING:
            self._close_or_lose()  # the next test did not wait
            self._open()
        elif phase in ENDED and self._bag is not None:
            # a trip is complete only when the silent nodes are known
            self._is_trip_complete = phase != State.TRIPPED or test.silent is not None
            if self._ended_at is not None:
                return
            self._ended_at = self._clock.monotonic()
            steps = self._steps if phase == State.DONE else 0
            self._expected = steps if test.step is None else test.step + 1
        self._phase = phase

    def _open(self) -> None:
        self._bag = BagWriter(bag_place(self._section))
        self._reason = self._unsaved = ""
        self._ended_at, self._next_began = None, False
        self._environment = describe_environment("run")
        self._write_environment(self._bag)
        self._write_descriptions(self._bag)
        self._watch_the_machine()
        self._samples = Counter(topic.name for topic, _, _ in self._before)
        while self._before:
            self._bag.write(*self._before.popleft())
        self._report(RECORDING, reason="", problem="")

    def _close_or_lose(self) -> None:
        """Save the bag, if one is open; if that fails, it is lost."""
        self._close()
        if self._bag is not None:
            self._shell.log("error", f"a test is lost: {self._unsaved}")

    def _close(self) -> None:
        """Save the bag, if one is open; if that fails, it stays open."""
        if (bag := self._bag) is None:
            return
        if self._watch is not None:
            self._environment["stalls"] = self._watch.end()
            self._watch = None
        self._write_environment(bag)
        self._write_descriptions(bag)  # again, for one of the two places may be damaged
        try:
            path = bag.save()
        except ExperimentError as error:
            self._unsaved = str(error)
            return
        self._bag, self._checked_at = None, -PLACE_PERIOD  # is there a place for the next one?
        self._report("saved", bag=str(path))

    def _write_environment(self, bag: BagWriter) -> None:
        text = json.dumps({"environment": self._environment})
        bag.write(topics.DESCRIPTION, messages.encode_string(text), self._clock.time_ns())

    def _write_descriptions(self, bag: BagWriter) -> None:
        for raw in self._descriptions.values():
            bag.write(topics.DESCRIPTION, raw, self._clock.time_ns())

    def _watch_the_machine(self) -> None:
        """Watch for stalls of the loop's core, if the rig runs in realtime on this host."""
        if self._watch is None or self._paced_by not in self._descriptions:
            return
        _, rig = messages.decode_description(self._descriptions[self._paced_by])
        there = rig.get("realtime", {})
        if rig["parameters"].get("pace") == "realtime" and there.get("boot") == boot():
            period = self._shell.experiment.timebase.dt
            first = there.get("nice") == FIRST_NICENESS
            self._watch.begin(there["cores"], period, there["priority"], first=first)

    def _check_place(self) -> None:
        """Make the next test wait while its bag can't be made."""
        if (now := self._clock.monotonic()) - self._checked_at < PLACE_PERIOD:
            return
        self._checked_at = now
        if why := why_not_writable(bag_place(self._section)):
            why += "; correct that, or set its parameter name or directory to another"
        if why != self._values.get(WAITS, ""):
            self._report(**(self._values | {WAITS: why}))

    def _recorded(self) -> int:
        """Count the samples recorded of every rig."""
        return min(self._samples[name] for name in self._rig_states)

    def _report(self, phase: str, **values: str) -> None:
        self._values = {"phase": phase, **values}
        self._shell.report(self._status())

    def _status(self) -> messages.Status:
        problem = self._values.get("problem", "")
        text, level = problem or self._values["phase"], messages.ERROR if problem else messages.OK
        return messages.Status(self._shell.name, level, text, values=self._values)


RECORDER_NODE = NodeKind(RECORDER_TABLE, TABLES, RecorderNode)
main = RECORDER_NODE.main


if __name__ == "__main__":
    raise SystemExit(main())
