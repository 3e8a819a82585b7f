"""Turns of a process of nodes."""

import subprocess
import sys

import pytest

PROGRAM = """
from seft_msgs_py.node.dds import DdsTransport
from seft_msgs_py.node.turns import NodeProcess
process = NodeProcess([], ["somebody"], DdsTransport)
called = []
process.polls.append(lambda: called.append("look"))
process.chores.append(lambda: called.append("chore"))
process.spin_once(0.0)
for _ in range(50):
    process.spin_once(0.0)
print(called.count("look"), called.count("chore"))
process.spin_once(0.06)
print(called.count("look"), called.count("chore"))
process.close()
"""


def test_a_look_is_taken_after_each_turn_and_chores_are_done_now_and_then():
    done = subprocess.run([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, check=True)
    looks, chores, more_looks, more_chores = map(int, done.stdout.split())
    assert (looks, more_looks) == (51, 52)
    assert 1 <= chores < 25
    assert more_chores == chores + 1


ENDED = """
import os, pty, signal, sys, threading
from seft_msgs_py.node.dds import DdsTransport
from seft_msgs_py.node.turns import NodeProcess
ignored = signal.SIG_IGN if sys.argv[1] == "nohup" else signal.SIG_DFL
signal.signal(signal.SIGHUP, ignored)  # whatever this test itself was started with
report = os.dup(1)
keyboard, terminal = pty.openpty()
os.dup2(terminal, 1)
os.close(terminal)
process = NodeProcess([], ["somebody"], DdsTransport)
os.close(keyboard)
# to the thread that runs handlers: by os.kill another one may take it, and that is later
signal.pthread_kill(threading.main_thread().ident, getattr(signal, sys.argv[2]))
if sys.argv[2] == "SIGHUP" and sys.argv[1] != "nohup":
    print("the terminal is gone", flush=True)  # which is no fault
os.write(report, str(process.stopping).encode())
os.dup2(report, 1)
process.close()
"""


@pytest.mark.parametrize(
    ("how", "number", "stops"),
    [("run", "SIGTERM", True), ("run", "SIGHUP", True), ("nohup", "SIGHUP", False)],
)
def test_a_process_ends_when_it_is_asked_to_or_its_terminal_is_closed(how, number, stops):
    words = [sys.executable, "-c", ENDED, how, number]
    done = subprocess.run(words, stdout=subprocess.PIPE, check=True)
    assert done.stdout.decode() == str(stops)


FAULTY = """
import time
from seft_msgs_py.errors import ExperimentError, WireError
from seft_msgs_py.node.dds import DdsTransport
from seft_msgs_py.node.turns import NodeProcess
process = NodeProcess([], ["somebody"], DdsTransport)
heard = []
process.fault_listeners.append(heard.append)
process.fault_listeners.append(lambda reason: heard.missing)  # who can't hear it
def fails():
    raise KeyError("name")
process.polls.append(fails)
process.spin_once(0.0)
print(process.faults, len(heard), heard[-1])
process.polls.clear()
process._take_turn = fails  # whatever the middleware may raise
process.spin_once(0.0)
print(process.faults, len(heard))
print(process.attempt("this", lambda: {}["x"]), process.attempt("this", lambda: 3))
try:
    process.attempt("this", lambda: (_ for _ in ()).throw(ExperimentError("a message")))
except ExperimentError as error:
    print(error)
process.close()
"""


def test_a_fault_is_counted_and_reported_and_the_process_goes_on():
    done = subprocess.run([sys.executable, "-c", FAULTY], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    fault = "2 1 a fault of the program in a poll: KeyError: 'name'"
    assert done.stdout.splitlines() == [fault, "4 2", "None 3", "a message"]
    assert done.stderr.count("Traceback") == 1  # a second one is logged a second later
