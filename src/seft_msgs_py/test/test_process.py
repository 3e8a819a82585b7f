"""A full /dev/shm is reported in one line, where rclpy would be killed."""

import errno
import os
import signal
import subprocess
import sys

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from seft_msgs_py.errors import InputError
from seft_msgs_py.node.process import (
    NETWORK,
    ONE_HOST,
    PROFILES,
    RANGE,
    check_environment,
    check_shared_memory,
    is_running,
    prepare_middleware,
    single_instance,
)
from seft_msgs_py.node.rclpy_interface import leave_graph


@pytest.mark.parametrize(
    ("given", "profiles", "reach"),
    [
        ({}, str(NETWORK), None),
        ({RANGE: "SUBNET"}, str(NETWORK), "SUBNET"),
        ({RANGE: "LOCALHOST"}, str(ONE_HOST), "SYSTEM_DEFAULT"),
        ({PROFILES: "own.xml"}, "own.xml", None),
        ({PROFILES: "own.xml", RANGE: "LOCALHOST"}, "own.xml", "LOCALHOST"),
        ({RANGE: "LOCALHOST", "ROS_STATIC_PEERS": "192.0.2.1"}, None, "LOCALHOST"),
        # inherited, and asked for once more
        ({PROFILES: str(ONE_HOST), RANGE: "LOCALHOST"}, str(ONE_HOST), "SYSTEM_DEFAULT"),
        ({PROFILES: str(ONE_HOST), RANGE: "SYSTEM_DEFAULT"}, str(ONE_HOST), "SYSTEM_DEFAULT"),
        ({PROFILES: str(NETWORK), RANGE: "LOCALHOST"}, str(ONE_HOST), "SYSTEM_DEFAULT"),
    ],
)
def test_what_the_environment_asks_for_is_what_fastdds_reads(monkeypatch, given, profiles, reach):
    environment = dict(given)
    monkeypatch.setattr("os.environ", environment)
    for _ in range(2):
        prepare_middleware()
        assert (environment.get(PROFILES), environment.get(RANGE)) == (profiles, reach)


WRONG = {
    "ROS_DOMAIN_ID": ["9999", "233", "-1", "abc", "7.0", "0x7"],
    "RMW_IMPLEMENTATION": ["rmw_cyclonedds_cpp", "rmw_x", "fastrtps"],
    "ROS_AUTOMATIC_DISCOVERY_RANGE": ["OFF", "LOCAL", "subnet"],
    "FASTRTPS_DEFAULT_PROFILES_FILE": ["nowhere.xml"],
    "RCUTILS_COLORIZED_OUTPUT": ["yes"],
}


def test_a_variable_with_which_ros_can_not_work_is_named_before_it_starts():
    program = [sys.executable, "-c", "import seft_msgs_py.node.dds"]
    environment = {**os.environ, "ROS_DOMAIN_ID": "9999"}
    done = subprocess.run(program, env=environment, capture_output=True, text=True)
    assert "InputError: ROS_DOMAIN_ID is 9999, but must be" in done.stderr


@pytest.mark.parametrize(("name", "values"), WRONG.items())
def test_what_the_environment_says_is_checked(monkeypatch, name, values):
    monkeypatch.setattr("os.environ", environment := {})
    for text in values:
        environment[name] = text
        with pytest.raises(InputError, match=rf"{name} is {text}, but must be .*, or unset it"):
            check_environment()
    right = {"ROS_DOMAIN_ID": "232", RANGE: "SUBNET", PROFILES: str(NETWORK), name: ""}
    environment.update({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"} | right)
    check_environment()


@pytest.fixture
def is_full(monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", refuse)


def test_a_full_folder_is_reported(tmp_path, is_full):
    with pytest.raises(InputError, match="is full, and no ROS process can start"):
        check_shared_memory(tmp_path)
    (tmp_path / "lttng-ust-wait-6").touch()  # it has no page yet
    with pytest.raises(InputError):
        check_shared_memory(tmp_path)


def test_what_the_tracer_has_already_is_enough(tmp_path, is_full):
    (tmp_path / "lttng-ust-wait-6").write_bytes(bytes(4096))
    check_shared_memory(tmp_path)


def test_a_folder_with_space_is_left_as_it_was(tmp_path):
    check_shared_memory(tmp_path)
    assert list(tmp_path.iterdir()) == []
    check_shared_memory(tmp_path / "nowhere")


NODE = f"/test_{os.getpid()}/rig"


def test_a_name_is_taken_once_on_a_domain():
    held = single_instance(7, NODE)
    with pytest.raises(InputError, match=f"domain 7 already has a node {NODE} on this host"):
        single_instance(7, NODE)
    assert is_running(7, NODE)
    assert not is_running(8, NODE)
    assert not is_running(7, f"{NODE}_2")
    held.close()
    assert not is_running(7, NODE)


def test_the_name_of_a_killed_process_is_free():
    program = (
        "import time; from seft_msgs_py.node.process import single_instance; "
        f"held = single_instance(7, {NODE!r}); print('held', flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        assert is_running(7, NODE)
        process.kill()
        process.wait()
    assert not is_running(7, NODE)


HELD = """
import ctypes, sys
from seft_msgs_py.node.process import exit_watchdog
with exit_watchdog(0.2, {status}, {message!r}):
    while True:
        ctypes.PyDLL(None).usleep(10_000_000)  # holds the interpreter, as a stuck library does
"""


@pytest.mark.parametrize(("status", "message"), [(0, ""), (2, "it is stuck")])
def test_a_process_that_is_stuck_in_a_library_ends_with_its_status(status, message):
    code = HELD.format(status=status, message=message)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr.strip()) == (status, message)


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
