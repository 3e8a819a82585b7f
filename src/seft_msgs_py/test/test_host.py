"""Priority, locked memory and a core: granted, or denied with a remedy."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.node import host
from seft_msgs_py.node.transport import LONGEST_GAP, AwakeClock

BY_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="rights are root's, also to give them up")
WISH = {"cpu_core": -1, "keep_awake": False, "lock_memory": False, "thread_priority": 0}
PROGRAM = """
import ctypes, json, os, resource, sys
from seft_msgs_py.node import host
host.granted()  # imports what nobody may not be allowed to read
if sys.argv[2] == "deny":
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
denied = host.apply(json.loads(sys.argv[1]))
print(json.dumps({"denied": denied, "granted": host.granted()}))
"""

OF_THE_LOOP = ("dds.udp.7411", "another")
ASIDE = ("dds.ev.0", "dds.asyn.0.0", "dds.udp.7410")
THREADS = """
import ctypes, json, os, sys, threading
from seft_msgs_py.node import host
names, ids, named, over = sys.argv[2:], [], threading.Semaphore(0), threading.Event()
def live(name):
    ctypes.CDLL(None).prctl(15, name.encode())  # PR_SET_NAME
    ids.append((name, threading.get_native_id()))
    named.release()
    over.wait()
for name in names:
    threading.Thread(target=live, args=[name], daemon=True).start()
    named.acquire()
assert host.apply(json.loads(sys.argv[1])) == []
print(json.dumps({
    name: [os.sched_getparam(each).sched_priority, sorted(os.sched_getaffinity(each))]
    for name, each in ids
}))
"""
GRAPH = """
from pathlib import Path
import rclpy
from rclpy.node import Node
from seft_msgs_py.node.process import prepare_on_this_host
from seft_msgs_py.node.host import side_threads
prepare_on_this_host()
rclpy.init(args=[])
node = Node("somebody")
names = [each.joinpath("comm").read_text() for each in Path("/proc/self/task").iterdir()]
print(len(side_threads()), sum(name.startswith("dds.") for name in names))
"""


def answer_of(program, wish, *words):
    """What a process of its own tells that has applied a wish."""
    words = [sys.executable, "-c", program, json.dumps({**WISH, **wish}), *words]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def ask(wish, how="as we are"):
    """What is denied and granted."""
    return answer_of(PROGRAM, wish, how)


def test_without_wishes_nothing_changes():
    answer = ask({})
    assert answer["denied"] == []
    assert answer["granted"]["priority"] == 0
    assert answer["granted"]["locked_kb"] == 0
    assert answer["granted"]["cores"] == sorted(os.sched_getaffinity(0))
    assert answer["granted"]["keeps_awake"] is False
    assert answer["granted"]["boot"] == host.boot()  # the same for all processes of a machine


def test_a_core_is_kept_to_and_one_that_is_not_there_is_reported():
    core = max(os.sched_getaffinity(0))
    assert ask({"cpu_core": core})["granted"]["cores"] == [core]
    answer = ask({"cpu_core": 4095})
    assert answer["denied"][0].startswith("core 4095 is not available; choose cpu_core among ")
    assert answer["granted"]["cores"] == sorted(os.sched_getaffinity(0))


@BY_ROOT
def test_what_is_denied_is_reported_with_its_remedy_and_the_process_goes_on():
    answer = ask({"thread_priority": 40, "lock_memory": True, "keep_awake": True}, "deny")
    awake, memory, priority = answer["denied"]
    assert "to keep the cores awake is denied" in awake
    assert 'udev rule `KERNEL=="cpu_dma_latency"' in awake
    assert "locked memory is denied" in memory
    assert "memlock unlimited` in /etc/security/limits.conf" in memory
    assert "real-time priority 40 is denied" in priority
    assert "rtprio 98` in /etc/security/limits.conf" in priority
    assert answer["granted"]["priority"] == 0
    assert answer["granted"]["keeps_awake"] is False


@pytest.mark.skipif(not host.may_keep_awake(), reason="cores may not be kept awake here")
def test_cores_are_kept_awake():
    answer = ask({"keep_awake": True})
    assert answer["denied"] == []
    assert answer["granted"]["keeps_awake"] is True


@BY_ROOT
def test_what_is_granted_is_reported():
    answer = ask({"thread_priority": 40, "lock_memory": True})
    assert answer["denied"] == []
    assert answer["granted"]["priority"] == 40
    assert answer["granted"]["locked_kb"] > 0


@pytest.mark.parametrize(
    ("priority", "aside"),
    [(0, 0), *(pytest.param(*both, marks=BY_ROOT) for both in ((40, 39), (1, 1)))],
)
def test_threads_of_the_middleware_without_messages_leave_the_core_and_give_way(priority, aside):
    cores = sorted(os.sched_getaffinity(0))
    wish = {"cpu_core": cores[0], "thread_priority": priority}
    found = answer_of(THREADS, wish, *OF_THE_LOOP, *ASIDE)
    for name, where in found.items():
        assert where == ([aside, cores] if name in ASIDE else [priority, cores[:1]])


def test_the_middleware_names_its_threads_as_is_read_here():
    done = subprocess.run([sys.executable, "-c", GRAPH], stdout=subprocess.PIPE, check=True)
    aside, named = map(int, done.stdout.split())
    assert 0 < aside < named


PRECEDENCE = """
import os, subprocess, sys
from pathlib import Path
from seft_msgs_py.node.host import take_precedence
if sys.argv[1] == "deny":
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
child = subprocess.Popen(["sleep", "600"], start_new_session=sys.argv[2] == "own")
before = Path("/proc/self/autogroup").read_text()
print(take_precedence(child.pid), os.getpriority(os.PRIO_PROCESS, child.pid))
session = Path(f"/proc/{child.pid}/autogroup")
if sys.argv[2] == "own":
    print(session.read_text().split()[-1])
assert Path("/proc/self/autogroup").read_text() == before
child.kill()
child.wait()
"""


@pytest.mark.skipif(
    os.geteuid() != 0 or not Path("/proc/self/autogroup").exists(),
    reason="rights are root's, and not every kernel weighs sessions",
)
@pytest.mark.parametrize(
    ("how", "session", "answer"),
    [
        ("", "own", ["True", "-20", "-20"]),
        ("", "shared", ["True", "-20"]),
        ("deny", "own", ["False", "0", "0"]),
    ],
)
def test_precedence_is_taken_where_it_is_allowed_and_for_a_session_of_its_own(how, session, answer):
    words = [sys.executable, "-c", PRECEDENCE, how, session]
    done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout.split() == answer


def test_threads_are_woken_on_time():
    program = (
        "import ctypes, threading; from seft_msgs_py.node.host import wake_on_time\n"
        "def tell(): print(ctypes.CDLL(None).prctl(30))  # PR_GET_TIMERSLACK\n"
        "tell(); wake_on_time(); tell(); t = threading.Thread(target=tell); t.start(); t.join()"
    )
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, check=True)
    before, own, of_a_thread = map(int, done.stdout.split())
    assert before > own == of_a_thread == 1


def test_a_long_sleep_counts_for_one_look():
    now = 100.0
    clock = AwakeClock(lambda: now)
    now += 60.0
    assert clock.time() == LONGEST_GAP
    assert clock.time() == LONGEST_GAP


@given(st.lists(st.floats(0.0, 5.0), max_size=50))
def test_it_never_runs_back_and_never_ahead_of_the_time(gaps):
    now = 100.0
    clock = AwakeClock(lambda: now)
    last = 0.0
    for gap in gaps:
        now += gap
        awake = clock.time()
        assert last <= awake <= now - 100.0 + 1e-9
        last = awake
