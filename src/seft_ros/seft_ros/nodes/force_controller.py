"""Node ``force_controller``: answers state and reference force with the valve command."""

import sys
import time
from collections.abc import Callable

import numpy as np
from seft_msgs_py.errors import WireError
from seft_msgs_py.messages import OK, Status, decode_status
from seft_msgs_py.node_main import NodeKind, run_node
from seft_msgs_py.node_process import MOST_AT_ONCE
from seft_msgs_py.node_shell import IDLE_WAIT, WARM_UP_STEPS, Handler, NodeShell
from seft_msgs_py.outcome import tripped_status
from seft_msgs_py.topics import EXPERIMENT_STATE, REFERENCE_FORCE, RIG_STATE, VALVE_COMMAND
from seft_msgs_py.trajectory import Floats, TrajectoryCodec

from seft_ros.experiment.sample_order import SampleOrder, check_magnitude
from seft_ros.experiment.state_machine import MOVING
from seft_ros.experiment.tables import TABLES
from seft_ros.force_controller.block import ForceController
from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.parameters import TABLE
from seft_ros.force_controller.silence import Silence

PENDING = 256  # steps kept while their other half has not come
STATE_WAIT = 0.0005  # s between looks for a state that comes after its reference force


class ForceControllerNode:
    """Matches states and reference forces by step and moves them through an `Interlock`.

    Once tripped it answers every state that still comes with 0 V, and is silent else: to a rig
    whose states have failed to come, 0 V of its last step would be stale.
    """

    def __init__(self, shell: NodeShell) -> None:
        experiment = shell.experiment
        section = experiment["force_controller"]
        self._shell = shell
        self._controller = Interlock.from_parameters(
            ForceController.from_parameters(section, experiment.axes, experiment.timebase),
            section,
            experiment.axes,
            experiment.timebase,
        )
        self._command_codec = TrajectoryCodec(VALVE_COMMAND, experiment.axes, experiment.timebase)
        self._publish = shell.publisher(VALVE_COMMAND)
        self._states: dict[int, Floats] = {}
        self._forces: dict[int, Floats] = {}
        self._order = SampleOrder(experiment.timebase)
        self._silence = Silence(section["watchdog.state_timeout"])
        self._refused_before = 0  # messages, until the last state came
        self._warm_up()
        shell.subscribe(EXPERIMENT_STATE, self._on_experiment_state, depth=16)
        # the state of a step is nearly always there before the force that answers it: only the
        # force is worth waking up for
        forces, states = (
            TrajectoryCodec(topic, experiment.axes, experiment.timebase)
            for topic in (REFERENCE_FORCE, RIG_STATE)
        )
        on_force, on_state = _decoded(forces, self._on_force), _decoded(states, self._on_state)
        shell.subscribe(REFERENCE_FORCE, on_force, reliable=False)
        self._read_state = shell.subscribe(RIG_STATE, on_state, wake=False, reliable=False)

    def _warm_up(self) -> None:
        axes = len(self._shell.experiment.axes)
        force, state = np.zeros(axes), np.zeros((4, axes))
        for step in range(WARM_UP_STEPS):
            raw = self._command_codec.encode(step, self._controller.step(step, force, state))
            self._command_codec.decode(raw)
        self._controller.reset()

    def begin(self) -> None:
        """Say that the node is ready."""
        self._tell()

    def run(self) -> None:
        """Answer until told to stop."""
        self._shell.spin(self.look, self._pause)

    def look(self) -> None:
        """See whether states have failed to come."""
        if self._silence.is_too_long(time.monotonic()):
            self._trip(
                f"no rig/state for {self._silence.longest:g} s (the last is of step "
                f"{self._order.last}); is rig running?{self._shell.company(self._refused_before)}"
            )

    def _pause(self) -> float:
        if self._forces:
            return STATE_WAIT
        return min(IDLE_WAIT, self._silence.pause) if self._silence.is_watching else IDLE_WAIT

    def _on_experiment_state(self, raw: bytes, _: int) -> None:
        status = decode_status(raw)
        self._order.follow(status)
        if status.message not in MOVING:
            self._silence.end()
        if status.message == "idle" and self._controller.reason:  # the operator knows
            self._controller.reset()
            self._tell()

    def _on_state(self, step: int, state: Floats) -> None:
        check_magnitude("rig/state of step", step, state)
        self._admit(RIG_STATE.name, step, self._states)
        if step + 1 < self._order.steps and not self._order.in_lockstep:
            self._silence.heard(time.monotonic())
            self._refused_before = self._shell.refused
        else:
            self._silence.end()  # of a test that is over, not known to run, or keeps no time
        if self._controller.reason:  # reference forces are not waited for any more
            self._answer(step, np.zeros(state.shape[1]), state)
            return
        self._states[step] = state
        self._answer_if_complete(step, self._states)

    def _on_force(self, step: int, values: Floats) -> None:
        if self._controller.reason and step <= self._order.last:
            return
        nonsense = self._controller.nonsense(values[0])
        if nonsense:
            raise WireError(f"{REFERENCE_FORCE.name} of step {step}: {nonsense}")
        self._admit(REFERENCE_FORCE.name, step, self._forces)
        self._forces[step] = values[0]
        for _ in range(MOST_AT_ONCE):  # the state of this step answers it
            if step <= self._order.last or step in self._states or self._read_state() is None:
                break
        if step > self._order.last:
            self._answer_if_complete(step, self._forces)

    def _admit(self, name: str, step: int, pending: dict[int, Floats]) -> None:
        """See that a sample may be taken in; the first of a test begins it."""
        if step == 0:
            self._shell.catch_up(EXPERIMENT_STATE)  # what was told before does not end this test
        if self._order.begins(step):
            self._states.clear()
            self._forces.clear()
            was_tripped = bool(self._controller.reason)
            self._controller.reset()
            conflict = self._shell.several_senders()
            if conflict:
                self._trip(conflict)
            elif was_tripped:
                self._tell()
        self._order.check(name, step)
        if step in pending:
            raise WireError(f"{name} of step {step} a second time")

    def _answer_if_complete(self, step: int, pending: dict[int, Floats]) -> None:
        if step in self._states and step in self._forces:
            self._answer(step, self._forces[step], self._states[step])
        elif len(pending) > PENDING:
            pending.pop(min(pending))

    def _answer(self, step: int, force: Floats, state: Floats) -> None:
        was_tripped = bool(self._controller.reason)
        command = self._controller.step(step, force, state)
        self._publish(self._command_codec.encode(step, command))
        self._order.last = step
        for pending in (self._states, self._forces):
            for passed in [other for other in pending if other <= step]:
                del pending[passed]
        if self._controller.reason and not was_tripped:
            self._tell()

    def _trip(self, reason: str) -> None:
        self._silence.end()
        self._controller.trip(max(self._order.last, 0), reason)
        self._tell()

    def _tell(self) -> None:
        reason, step = self._controller.reason, self._controller.step_index
        status = Status("force_controller", OK, "ready", values={"phase": "ready"})
        if reason:
            status = tripped_status("force_controller", reason, step)
        self._shell.report(status)


def _decoded(codec: TrajectoryCodec, receive: Callable[[int, Floats], None]) -> Handler:
    def handle(raw: bytes, _: int) -> None:
        step, values = codec.decode(raw)
        receive(step, values[0])

    return handle


def _build(shell: NodeShell) -> ForceControllerNode:
    node = ForceControllerNode(shell)
    shell.start()
    node.begin()
    return node


KIND = NodeKind(TABLE, TABLES, _build)


def main() -> int:
    """Entry point of ``ros2 run seft_ros force_controller``."""
    return run_node(KIND)


if __name__ == "__main__":
    sys.exit(main())
