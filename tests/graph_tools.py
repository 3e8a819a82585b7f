"""What the tests of whole graphs share."""

import contextlib
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from seft_msgs_py.config.facts import CHANNELS
from seft_ros.test_run.processes import COMPOSED, MODULES

ROOT = Path(__file__).parent.parent
JHU = ROOT / "config" / "jhu.yaml"
DEMO = ROOT / "config" / "demo.yaml"
BRIDGE = ROOT / "config" / "two_pier_bridge.yaml"
THOROUGH = pytest.mark.thorough
"""Takes its time for what another test looks at in short; only `make thorough` runs these."""
PATIENCE = 400.0  # s; far beyond what anything here takes, also where eight others run
STALLS_ALLOWED = (
    *("-p", "rig:watchdog.command_timeout:=60.0"),
    *("-p", "supervisor:watchdog.peer_timeout:=60.0"),
    *("-p", "supervisor:watchdog.missed_share:=1.0"),
    *("-p", "force_controller:watchdog.reference_timeout:=60.0"),
    *("-p", "rig:watchdog.supervisor_timeout:=60.0"),
    *("-p", "supervisor:rehearsal.duration:=0.0"),
)
"""Lets a test in realtime outlive a machine that stands still for a while."""


MISSES_ALLOWED = (
    *("-p", "reference_force:instability.ratio:=0.0"),
    *("-p", "rig:detectors.warn_only:=all"),
)
"""Lets it outlive what many missed commands make: vibration, and flow that nobody commanded."""
GENTLE = (  # with sensors of unlimited range: it uses next to nothing of theirs
    *("-p", "ground_motion:peak_force:=20.0", "-p", "/**:sensors.adc_bits:=0"),
    *(word for name in CHANNELS for word in ("-p", f"sensors.{name}_range:=0.0")),
)
"""Lets a rig stay far from its limits though it holds old commands for long."""


def wait_for(condition: Callable[[], object], what: str) -> object:
    """Wait until a condition holds; return what it gives."""
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.02)
    return found


def hear_hang_ups() -> None:
    """Be ended by a hang-up, also below nohup: for a child, before it becomes another program."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def children(pid: int) -> dict[str, int]:
    """Node processes that a `seft run` has had started: node, with its rig's name -> pid."""
    found: dict[str, int] = {}
    try:
        starters = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:  # it has ended
        return found
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            if (entry / "stat").read_text().rsplit(")", 1)[1].split()[1] not in starters:
                continue
            words = (entry / "cmdline").read_text().rstrip("\0").split(" ")
        except (OSError, ValueError):
            continue
        below = [word.removeprefix("__ns:=/") + "/" for word in words if word.startswith("__ns:=/")]
        for node, module in MODULES.items():
            if module in words or (COMPOSED in words and node in words):
                found["".join([*below, node])] = int(entry.name)
    return found


def shared_memory(pid: int) -> list[str]:
    """Files of the middleware in /dev/shm that a process has mapped."""
    with contextlib.suppress(OSError):  # it has ended
        lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
        return sorted({line.split()[-1] for line in lines if "/dev/shm/fastrtps" in line})
    return []
