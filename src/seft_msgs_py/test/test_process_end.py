import signal
import subprocess
import sys

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from seft_msgs_py.node.rclpy_interface import leave_graph

HELD = """
import ctypes, sys
from seft_msgs_py.node.process import exit_watchdog
with exit_watchdog(0.2, {status}, {told!r}):
    while True:
        ctypes.PyDLL(None).usleep(10_000_000)  # holds the interpreter, as a stuck library does
"""


@pytest.mark.parametrize(("status", "told"), [(0, ""), (2, "it is stuck")])
def test_a_process_that_is_stuck_in_a_library_ends_with_its_status(status, told):
    code = HELD.format(status=status, told=told)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr.strip()) == (status, told)


def test_what_ends_in_time_leaves_no_alarm_behind():
    from seft_msgs_py.node.process import exit_watchdog

    with exit_watchdog(1000.0, 3):
        assert signal.getitimer(signal.ITIMER_REAL)[0] > 0
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert signal.getsignal(signal.SIGALRM) is signal.SIG_DFL


def test_a_node_leaves_and_its_context_ends():
    here, beside = Context(), Context()
    for context in (here, beside):
        rclpy.init(args=[], context=context)
    node, other = Node("here", context=here), Node("beside", context=beside)
    leave_graph(node)
    assert not here.ok()
    assert beside.ok()
    leave_graph(other)


def test_what_used_the_default_context_can_come_back():
    for _ in range(2):
        rclpy.init(args=[])
        leave_graph(Node("here"))
