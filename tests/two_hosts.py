"""Two hosts on this machine: network namespaces, joined by a link that delays and loses.

Needs root (or the capabilities to make namespaces) and iproute2.
"""

import array
import contextlib
import fcntl
import itertools
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from seft_msgs_py.node.process import NETWORK

RELAY = Path(__file__).with_name("link_relay.py")
_SIOCETHTOOL = 0x8946
_OFFLOADS = (0x15, 0x17, 0x19, 0x1F, 0x24, 0x2C)  # rx and tx checksums, sg, tso, gso, gro
_counter = itertools.count()


def why_not():
    """Say why two hosts can't be had here; empty if they can."""
    if shutil.which("ip") is None:
        return "iproute2 is not installed"
    name = f"seft{os.getpid()}probe"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True)
    if made.returncode:
        return f"no network namespaces: {made.stderr.strip()}"
    mount = ["mount", "-t", "tmpfs", "tmpfs", "/dev/shm"]
    words = ["ip", "netns", "exec", name, *mount]
    entered = subprocess.run(words, capture_output=True, text=True)
    subprocess.run(["ip", "netns", "del", name], check=True)
    return f"no mounts of one's own: {entered.stderr.strip()}" if entered.returncode else ""


def promptly(pid):
    """Have a process, all its threads, run before what else this machine does, where allowed."""
    with contextlib.suppress(OSError):  # not allowed, or ended meanwhile
        for task in Path(f"/proc/{pid}/task").iterdir():
            os.sched_setscheduler(int(task.name), os.SCHED_RR, os.sched_param(10))


class TwoHosts:
    """Hosts ``a`` and ``b``, each with its own network and shared memory, and the link."""

    def __init__(self, folder, seed=1):
        self.folder = folder
        number = next(_counter)
        self._tag = f"{os.getpid() % 1_000_000}{chr(97 + number % 26)}"
        self._cleanup = contextlib.ExitStack()
        self._processes, self._holders = [], {}
        try:
            self._make()
            self._relay = subprocess.Popen(
                [sys.executable, str(RELAY), self._outer("a"), self._outer("b"), str(seed)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            self._cleanup.callback(_end, self._relay)
            promptly(self._relay.pid)
            assert self._relay.stdout.readline() == "ready\n"
        except BaseException:
            self._cleanup.close()
            raise

    def namespace(self, host):
        return f"seft{self._tag}{host}"

    def link(self, **how):
        """Change the link; give the frames passed and lost so far, from a to b and from b to a."""
        self._relay.stdin.write(json.dumps(how) + "\n")
        self._relay.stdin.flush()
        return json.loads(self._relay.stdout.readline())

    def start(self, host, *words, prompt=False):
        """Start a Python module on a host; a prompt one runs before what else is there."""
        command = ["nsenter", "--target", str(self._holders[host].pid), "--net", "--mount"]
        command += [f"--wd={self.folder}", sys.executable, "-m"]
        here = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
        ros = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
        ros["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(NETWORK)
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        environment = os.environ | {"PYTHONPATH": here} | ros
        process = subprocess.Popen([*command, *map(str, words)], env=environment, **pipes)
        self._processes.append(process)
        if prompt:
            promptly(process.pid)  # it has one thread yet; its others and its children inherit it
        return process

    def close(self):
        for process in self._processes:
            if process.poll() is None:
                process.kill()
            process.communicate()
        self._cleanup.close()

    def _outer(self, host):
        return f"sf{self._tag}{host}"

    def _make(self):
        for host, address in (("a", 1), ("b", 2)):
            outer, inner, space = self._outer(host), f"si{self._tag}{host}", self.namespace(host)
            _ip("netns", "add", space)
            self._cleanup.callback(_ip, "netns", "del", space)
            _ip("link", "add", outer, "type", "veth", "peer", "name", inner)
            self._cleanup.callback(_ip, "link", "del", outer)
            for interface in (outer, inner):
                _without_offloads(interface)
                _ip("link", "set", interface, "addrgenmode", "none")  # of this host nothing
            _ip("link", "set", outer, "up")
            _ip("link", "set", inner, "netns", space)
            inside = ("-n", space)
            _ip(*inside, "addr", "add", f"10.213.7.{address}/24", "dev", inner)
            _ip(*inside, "link", "set", inner, "up")
            _ip(*inside, "link", "set", "lo", "up")
            _ip(*inside, "route", "add", "224.0.0.0/4", "dev", inner)
            self._hold(host)

    def _hold(self, host):
        """Give a host a shared memory of its own, which lasts as long as this process."""
        command = ["ip", "netns", "exec", self.namespace(host), "sh", "-c"]
        command += ["mount -t tmpfs tmpfs /dev/shm && echo ready && exec cat"]
        holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._cleanup.callback(_end, holder)
        assert holder.stdout.readline() == "ready\n"
        self._holders[host] = holder


def _end(process):
    """End a process that lasts until its stdin is closed."""
    process.stdin.close()
    process.wait()
    process.stdout.close()


def _ip(*words):
    done = subprocess.run(["ip", *words], capture_output=True, text=True)
    assert done.returncode == 0, f"ip {' '.join(words)}: {done.stderr}"


def _without_offloads(interface):
    """Have the kernel compute checksums and cut packets itself: the relay sees what is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for command in _OFFLOADS:
            value = array.array("I", [command, 0])
            request = struct.pack("16sP", interface.encode(), value.buffer_info()[0]) + bytes(16)
            with contextlib.suppress(OSError):  # what it does not have can't be switched off
                fcntl.ioctl(any_socket, _SIOCETHTOOL, request)


@pytest.fixture
def two_hosts(domain, tmp_path):
    """Hosts of a test; skipped where they can't be had."""
    if reason := why_not():
        pytest.skip(reason)
    with (Path(tempfile.gettempdir()) / "seft_two_hosts.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # two side by side are too much for two cores
        hosts = TwoHosts(tmp_path)
        yield hosts
        hosts.close()
