"""Priority, locked memory and a core: granted, or denied with a remedy."""

import json
import os
import subprocess
import sys

import pytest
from seft_msgs_py import realtime

EQUAL_ADDRESSES = pytest.mark.skipif(
    subprocess.run(["setarch", "-R", "true"], stderr=subprocess.DEVNULL).returncode != 0,
    reason="a container's filter denies equal addresses",
)
WISH = {"cpu_core": -1, "lock_memory": False, "thread_priority": 0}
PROGRAM = """
import ctypes, json, os, resource, sys
from seft_msgs_py import realtime
realtime.granted()  # imports what nobody may not be allowed to read
if sys.argv[2] == "deny":
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
denied = realtime.apply(json.loads(sys.argv[1]))
print(json.dumps({"denied": denied, "granted": realtime.granted()}))
"""


def ask(wish, how="as we are"):
    """Apply wishes in a process of its own."""
    words = [sys.executable, "-c", PROGRAM, json.dumps({**WISH, **wish}), how]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_without_wishes_nothing_changes():
    told = ask({})
    assert told["denied"] == []
    assert told["granted"]["priority"] == 0
    assert told["granted"]["locked_kb"] == 0
    assert told["granted"]["cores"] == sorted(os.sched_getaffinity(0))


def test_a_core_is_kept_to_and_one_that_is_not_there_is_told():
    core = max(os.sched_getaffinity(0))
    assert ask({"cpu_core": core})["granted"]["cores"] == [core]
    told = ask({"cpu_core": 4095})
    assert told["denied"][0].startswith("core 4095 is not to be had; choose cpu_core among ")
    assert told["granted"]["cores"] == sorted(os.sched_getaffinity(0))


@pytest.mark.skipif(os.geteuid() != 0, reason="rights can only be given up by root")
def test_what_is_denied_is_told_with_its_remedy_and_the_process_goes_on():
    told = ask({"thread_priority": 40, "lock_memory": True}, "deny")
    memory, priority = told["denied"]
    assert "locked memory is denied" in memory
    assert "memlock unlimited` in /etc/security/limits.conf" in memory
    assert "real-time priority 40 is denied" in priority
    assert "rtprio 98` in /etc/security/limits.conf" in priority
    assert told["granted"]["priority"] == 0


@pytest.mark.skipif(os.geteuid() != 0, reason="rights are root's")
def test_what_is_granted_is_told():
    told = ask({"thread_priority": 40, "lock_memory": True})
    assert told["denied"] == []
    assert told["granted"]["priority"] == 40
    assert told["granted"]["locked_kb"] > 0


@EQUAL_ADDRESSES
def test_programs_at_equal_addresses_have_their_parts_in_the_same_places():
    def places(how):
        words = [sys.executable, "-c", "print(open('/proc/self/maps').read())"]
        done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True, preexec_fn=how)
        return sorted(line.split()[0] for line in done.stdout.splitlines() if ".so" in line)

    equal = places(realtime.take_equal_addresses)
    assert equal
    assert equal == places(realtime.take_equal_addresses)
    assert equal != places(None)


@EQUAL_ADDRESSES
@pytest.mark.parametrize("equal", [False, True])
def test_equal_addresses_are_told(equal):
    words = [sys.executable, "-c", PROGRAM, json.dumps(WISH), ""]
    how = realtime.take_equal_addresses if equal else None
    done = subprocess.run(words, stdout=subprocess.PIPE, check=True, preexec_fn=how)
    assert json.loads(done.stdout)["granted"]["equal_addresses"] is equal


def test_threads_are_woken_on_time():
    program = (
        "import ctypes, threading; from seft_msgs_py.realtime import wake_on_time\n"
        "def tell(): print(ctypes.CDLL(None).prctl(30))  # PR_GET_TIMERSLACK\n"
        "tell(); wake_on_time(); tell(); t = threading.Thread(target=tell); t.start(); t.join()"
    )
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, check=True)
    before, own, of_a_thread = map(int, done.stdout.split())
    assert before > own == of_a_thread == 1


def test_all_processes_of_a_machine_tell_the_same_boot():
    assert ask({})["granted"]["boot"] == realtime.boot()
