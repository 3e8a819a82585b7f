"""Node ``supervisor``: starts, watches and ends a test.

It holds the state machine, publishes it latched on experiment/state, and serves start, stop,
estop and reset.
"""

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from seft_msgs_py.description import decode_description
from seft_msgs_py.messages import (
    Status,
    decode_diagnostics,
    encode_status,
)
from seft_msgs_py.node_shell import NodeShell, run_node
from seft_msgs_py.topics import DESCRIPTION, DIAGNOSTICS, EXPERIMENT_STATE
from std_srvs.srv import Trigger

from seft_ros.experiment.peers import Heard, missing
from seft_ros.experiment.state_machine import Answer, State, StateMachine
from seft_ros.experiment.tables import TABLES
from seft_ros.experiment.watching import SUPERVISOR

LEVELS = {State.TRIPPED: 2}


class SupervisorNode:
    """Drives a `StateMachine` by what the nodes say and the operator asks."""

    def __init__(self, shell: NodeShell) -> None:
        self._shell = shell
        self._section = shell.experiment["supervisor"]
        self._machine = StateMachine()
        self._lock = threading.Lock()
        self._heard: dict[str, Heard] = {}
        self._descriptions: dict[str, dict[str, Any]] = {}
        self._publish = shell.publisher(EXPERIMENT_STATE)
        self._published: Status | None = None
        shell.subscribe(DIAGNOSTICS, self._on_diagnostics)
        shell.subscribe(DESCRIPTION, self._on_description, depth=64)
        machine = self._machine
        for name, request in (
            ("start", machine.start),
            ("stop", machine.stop),
            ("estop", machine.estop),
            ("reset", machine.reset),
        ):
            shell.node.create_service(Trigger, name, self._service(request))

    def tick(self) -> None:
        """Look at the peers, and publish the state if it has changed."""
        now = time.monotonic()
        own = Status("supervisor", 0, "watching", values=self._shell.matched())
        self._heard["supervisor"] = Heard(own, now)
        with self._lock:
            if self._machine.state in (State.IDLE, State.READY):
                self._machine.peers(
                    missing(self._section["peers"], self._heard, self._descriptions, now)
                )
            elif self._machine.state is State.RUNNING:
                timeout = self._section["watchdog.peer_timeout"]
                for node in self._section["peers"]:
                    if now - self._heard[node].at > timeout:
                        self._machine.trip(f"node {node} has been silent for {timeout:g} s")
            self._publish_if_changed()

    def _service(self, request: Callable[[], Answer]) -> Callable[[Any, Any], Any]:
        def serve(_: Any, response: Any) -> Any:
            with self._lock:
                answer = request()
                self._publish_if_changed()
            response.success, response.message = answer.accepted, answer.text
            return response

        return serve

    def _publish_if_changed(self) -> None:
        machine = self._machine
        values = {"detail": machine.detail}
        if machine.step is not None:
            values["step"] = str(machine.step)
        ground_motion = self._heard.get("ground_motion")
        if ground_motion is not None:
            values["steps"] = ground_motion.status.values.get("steps", "0")
        level = LEVELS.get(machine.state, 0)
        status = Status("experiment", level, str(machine.state), values=values)
        if status != self._published:
            self._published = status
            self._publish(encode_status(status))

    def _on_diagnostics(self, raw: bytes, _: int) -> None:
        for status in decode_diagnostics(raw)[1]:
            self._heard[status.name] = Heard(status, time.monotonic())
            if status.name == "rig":
                self._follow_rig(status)

    def _follow_rig(self, status: Status) -> None:
        phase = status.values.get("phase")
        if phase not in ("finished", "tripped"):
            return
        with self._lock:
            if phase == "finished":
                self._machine.finish(f"{status.values.get('steps')} steps done")
            else:
                step = status.values.get("step", "")
                reason = status.values.get("reason") or status.message
                self._machine.trip(reason, int(step) if step.isdecimal() else None)
            self._publish_if_changed()

    def _on_description(self, raw: bytes, _: int) -> None:
        node, description = decode_description(raw)
        self._descriptions[node] = description


def _serve(shell: NodeShell) -> None:
    node = SupervisorNode(shell)
    shell.start()
    shell.report(Status("supervisor", 0, "watching", values={"phase": "watching"}))
    shell.spin(node.tick)


def main() -> int:
    """Entry point of ``ros2 run seft_ros supervisor``."""
    return run_node(SUPERVISOR, TABLES, _serve)


if __name__ == "__main__":
    sys.exit(main())
