"""Node ``recorder``: writes every message of a test, as it came, into a bag.

It keeps what is needed from before the start (descriptions, ground motion ahead), opens a bag
when the test runs, and closes it when the test has ended and the topics have fallen silent. The
next test waits for that.
"""

import json
import sys
import time
from collections import deque
from datetime import datetime
from pathlib import Path

from seft_msgs_py.node.node_main import NodeKind, run_node
from seft_msgs_py.node.node_shell import Handler, NodeShell
from seft_msgs_py.node.realtime import FIRST, boot
from seft_msgs_py.wire.messages import (
    Status,
    decode_description,
    decode_diagnostics,
    decode_status,
    encode_string,
)
from seft_msgs_py.wire.outcome import RIG
from seft_msgs_py.wire.topics import (
    DESCRIPTION,
    DIAGNOSTICS,
    ESTIMATES,
    EXPERIMENT_STATE,
    GROUND_MOTION,
    RIG_STATE,
    LoopTopic,
    Topic,
    topics_of,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.experiment.peers import ALL_ANSWERED, RECORDING, SILENT, WAITS
from seft_ros.experiment.state_machine import ENDED, MOVING, State
from seft_ros.experiment.tables import TABLES
from seft_ros.experiment.watching import RECORDER
from seft_ros.recording.bag_writer import BagWriter
from seft_ros.recording.environment import describe_environment
from seft_ros.recording.stall_watch import StallWatch

SILENCE = 0.3  # s without a message of a step: the test's last message has come
LONG_SILENCE = 3.5  # s, where something lacks: DDS may send it again every 3 s only
LONGEST_DRAIN = 15.0  # s
TICK = 0.02  # s
READ_DEPTH = (
    4096  # messages that may wait while the recorder is held up; depth decides what is lost
)


class RecorderNode:
    """Moves bytes from topics to a `BagWriter`."""

    def __init__(self, shell: NodeShell) -> None:
        self._shell = shell
        self._section = shell.experiment["recorder"]
        self._motion_codec = TrajectoryCodec(
            GROUND_MOTION, shell.experiment.axes, shell.experiment.timebase
        )
        self._descriptions: dict[str, tuple[Topic, bytes, int]] = {}
        self._before: deque[tuple[Topic, bytes, int]] = deque(maxlen=20_000)
        self._bag: BagWriter | None = None
        self._phase = "idle"
        self._ended_at: float | None = None
        self._next_began = False  # ground motion of the next test has come
        self._values = {"phase": "idle"}
        self._told_in_full = True  # how the test ended
        self._force_phase = ""  # of the reference force
        self._step_message_at = 0.0
        self._samples, self._expected = 0, 0  # of the rig
        self._environment = describe_environment("run")  # asks git once, before a test runs
        self._watch: StallWatch | None = None
        rigs = shell.experiment.rigs
        self._rig_states = [RIG_STATE.of(rig) for rig in rigs]
        self._paced_by = rigs[0].node(RIG)
        for topic in topics_of(rigs):
            if not topic.recorded:
                continue
            depth = 64 if topic.latched and topic != GROUND_MOTION else READ_DEPTH
            shell.subscribe(topic, self._receiver(topic), depth=depth, wake=False)

    def run(self) -> None:
        """Record until told to stop; a bag that is open then is closed."""
        try:
            self._shell.spin(self.look, TICK)
        finally:
            self._shell.spin_once(0.0)  # what has come
            self._close()

    def look(self) -> None:
        """Keep the bag flushed, and close it when the test has ended."""
        if self._bag is None:
            self._look_at_the_place()
            return
        self._bag.flush_if_due()
        if self._ended_at is not None:
            now = time.monotonic()
            complete = self._samples >= self._expected and self._told_in_full
            if self._phase == State.DONE and "reference_force" in self._descriptions:
                complete &= self._force_phase == ALL_ANSWERED
            patience = SILENCE if complete else LONG_SILENCE
            silent = now - max(self._step_message_at, self._ended_at) > patience
            if silent or now - self._ended_at > LONGEST_DRAIN:
                self._close()

    def _receiver(self, topic: Topic) -> Handler:
        of_a_step = topic == ESTIMATES or isinstance(topic, LoopTopic)

        def receive(raw: bytes, now: int) -> None:
            if of_a_step:
                self._step_message_at = time.monotonic()
            if topic == DESCRIPTION:
                node, _ = decode_description(raw)
                self._descriptions[node] = (topic, raw, now)
            if topic == EXPERIMENT_STATE:
                self._follow(decode_status(raw))
            if topic == GROUND_MOTION and self._is_of_the_next_test(raw):
                self._keep(topic, raw, now)
            elif self._bag is not None:
                self._bag.write(topic, raw, now)
                self._samples += topic in self._rig_states
            elif of_a_step:
                self._keep(topic, raw, now)
            if topic == DIAGNOSTICS:
                for status in decode_diagnostics(raw)[1]:
                    if status.name == "reference_force":
                        self._force_phase = status.values.get("phase", "")

        return receive

    def _keep(self, topic: Topic, raw: bytes, now: int) -> None:
        """Hold what comes before the bag is open; a new ground motion replaces an old one."""
        if topic == GROUND_MOTION and self._motion_codec.decode(raw)[0] == 0:
            self._before.clear()
        self._before.append((topic, raw, now))

    def _is_of_the_next_test(self, motion: bytes) -> bool:
        """Tell whether a chunk belongs to a test that comes after the one of the open bag."""
        if self._ended_at is None or self._bag is None:
            return False
        self._next_began |= self._motion_codec.decode(motion)[0] == 0
        return self._next_began

    def _follow(self, test: Status) -> None:
        phase = test.message
        if phase == State.READY and self._watch is None:
            self._watch = StallWatch()
        if phase in MOVING and self._phase not in MOVING:
            self._close()  # of a test whose successor did not wait
            self._open()
        elif phase in ENDED and self._bag is not None:
            # a trip is only told in full when it is known who has fallen silent
            self._told_in_full = phase != State.TRIPPED or SILENT in test.values
            if self._ended_at is not None:
                return
            self._ended_at = time.monotonic()
            last = test.values.get("step", "")  # where it tripped
            steps = test.values.get("steps", "") if phase == "done" else ""
            steps = steps if steps.isdecimal() else "0"
            expected = int(last) + 1 if last.isdecimal() else int(steps)
            self._expected = expected * len(self._rig_states)
        self._phase = phase

    def _open(self) -> None:
        self._bag = BagWriter(self._place(), self._section["storage"])
        self._ended_at, self._next_began = None, False
        now = time.time_ns()
        self._environment = describe_environment("run")
        self._write_environment(self._bag)
        for topic, raw, _ in self._descriptions.values():
            self._bag.write(topic, raw, now)
        self._watch_the_machine()
        self._samples = sum(topic in self._rig_states for topic, _, _ in self._before)
        while self._before:
            self._bag.write(*self._before.popleft())
        self._bag.flush()
        self._report(RECORDING)

    def _close(self) -> None:
        bag, self._bag = self._bag, None
        if bag is not None:
            if self._watch is not None:
                self._environment["stalls"] = self._watch.end()
                self._watch = None
                self._write_environment(bag)
            bag.close({})
            self._report("saved", bag=str(bag.path))

    def _write_environment(self, bag: BagWriter) -> None:
        text = json.dumps({"environment": self._environment})
        bag.write(DESCRIPTION, encode_string(text), time.time_ns())

    def _watch_the_machine(self) -> None:
        """Have stalls of the loop's core noted, where the rig keeps a pace and is on this host."""
        if self._watch is None or self._paced_by not in self._descriptions:
            return
        _, rig = decode_description(self._descriptions[self._paced_by][1])
        there = rig.get("realtime", {})
        if rig["parameters"].get("pace") == "realtime" and there.get("boot") == boot():
            period = self._shell.experiment.timebase.dt
            first = there.get("nice") == FIRST
            self._watch.begin(there["cores"], period, there["priority"], first=first)

    def _place(self) -> Path:
        """Folder of the next bag; one that has no name of its own takes none that is taken."""
        directory = Path(self._section["directory"])
        if self._section["name"]:
            return directory / self._section["name"]
        name = datetime.now().strftime("seft_%Y-%m-%d_%H-%M-%S")
        number = 1
        while (place := directory / (f"{name}_{number}" if number > 1 else name)).exists():
            number += 1
        return place

    def _look_at_the_place(self) -> None:
        """Have the next test wait as long as its bag can't be made."""
        place = self._place() if self._section["name"] else None
        is_taken = place is not None and place.exists()
        why = f"{place} exists already; set its parameter name to another" if is_taken else ""
        if why != self._values.get(WAITS, ""):
            self._report(**{**self._values, WAITS: why})

    def _report(self, phase: str, **values: str) -> None:
        self._values = {"phase": phase, **values}
        self._shell.report(Status("recorder", 0, phase, values=self._values))


def _build(shell: NodeShell) -> RecorderNode:
    node = RecorderNode(shell)
    shell.start()
    shell.report(Status("recorder", 0, "idle", values={"phase": "idle"}))
    return node


KIND = NodeKind(RECORDER, TABLES, _build)


def main() -> int:
    """Entry point of ``ros2 run seft_ros recorder``."""
    return run_node(KIND)


if __name__ == "__main__":
    sys.exit(main())
