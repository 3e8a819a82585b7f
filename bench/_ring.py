"""A bare ring of three processes that hand on raw messages: the floor of the loop over DDS.

Run as a program it is one of those that only hand on or read; `lap_times` is the one that measures.
"""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence

import rclpy
from _udp_ring import MESSAGE_SIZE
from rclpy.node import Node
from seft_msgs_py.node.process import PROFILES, RANGE
from seft_msgs_py.node.rclpy_interface import (
    RclWaitSet,
    message_class,
    qos_profile,
    raw_subscription,
    taker,
)
from seft_msgs_py.wire.topics import JOINT_TRAJECTORY, Topic


class Station:
    """Receives on one topic and publishes on another; ``beside`` is read after each message."""

    def __init__(self, listens: str, speaks: str, beside: Sequence[str] = ()) -> None:
        rclpy.init(args=[])
        self.node = Node(f"ring_{speaks}")
        outward = Topic(speaks, JOINT_TRAJECTORY)
        self.subscription, *others = (
            raw_subscription(self.node, Topic(name, JOINT_TRAJECTORY), 64, reliable=False)
            for name in (listens, *beside)
        )
        self.publisher = self.node.create_publisher(
            message_class(outward), outward.name, qos_profile(outward)
        )
        self.send = self.publisher.handle.publish_raw
        self._take, self._others = taker(self.subscription), [taker(each) for each in others]
        self.wait_set = RclWaitSet(self.node.context, [self.subscription])

    def receive(self, timeout: float) -> bytes | None:
        """Wait for a message and take it."""
        taken = self._take() if self.wait_set.wait(timeout) else None
        for take in self._others:
            take()
        return taken and taken[0]

    def matched(self, listeners: int) -> bool:
        """Whether all neighbours are there."""
        found = self.publisher.get_subscription_count()
        return found == listeners and self.subscription.get_publisher_count() > 0


def hand_on(listens: str, speaks: str, *beside: str) -> None:
    """Hand on messages until killed."""
    station = Station(listens, speaks, beside)
    while True:
        raw = station.receive(1.0)
        if raw is not None:
            station.send(raw)


def record(*listens: str) -> None:
    """Read some topics until killed, as the recorder does."""
    rclpy.init(args=[])
    node = Node("ring_recorder")
    subscriptions = [raw_subscription(node, Topic(name, JOINT_TRAJECTORY), 64) for name in listens]
    takers = {each: taker(each) for each in subscriptions}
    wait_set = RclWaitSet(node.context, subscriptions)
    while True:
        for ready in wait_set.wait(1.0):
            takers[ready]()


def lap_times(laps: int, *, with_readers: bool = False) -> list[float]:
    """Send a message round the ring ``laps`` times; return the times of the laps, s.

    With readers, each message goes to all whom one of the loop goes to: the rig's also to the
    force controller, which takes it when it has the reference force, and all to a recorder, which
    may run on any core.
    """
    cores, here = os.sched_getaffinity(0), [sys.executable, __file__]
    commands = [["ring_a", "ring_b"], ["ring_b", "ring_c", *["ring_a"] * with_readers]]
    others = [subprocess.Popen([*here, "hand_on", *words]) for words in commands]
    if with_readers:
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
        others.append(subprocess.Popen([*here, "record", "ring_a", "ring_b", "ring_c"]))
        os.sched_setaffinity(0, cores)
    try:
        station = Station("ring_c", "ring_a")
        message, times = os.urandom(MESSAGE_SIZE), []
        while not station.matched(3 if with_readers else 1):
            time.sleep(0.05)
        time.sleep(1.0)  # the others may still be finding each other
        for _ in range(laps):
            start = time.perf_counter()
            station.send(message)
            while not station.receive(5.0):
                if any(other.poll() is not None for other in others):
                    raise RuntimeError("a station of the ring has ended")
            times.append(time.perf_counter() - start)
        station.node.destroy_node()
        rclpy.try_shutdown()
        return times
    finally:
        for other in others:
            other.kill()
            other.wait()


def median_over_shared_memory(laps: int) -> float:
    """Median lap of a ring with the settings that ROS comes with, s."""
    theirs = {name: value for name, value in os.environ.items() if name != PROFILES}
    theirs |= {RANGE: "LOCALHOST"}
    done = subprocess.run(
        [sys.executable, __file__, str(laps)], env=theirs, stdout=subprocess.PIPE, check=True
    )
    return float(done.stdout)


if __name__ == "__main__":
    if len(sys.argv) == 2:
        print(statistics.median(lap_times(int(sys.argv[1]))))
    else:
        {"hand_on": hand_on, "record": record}[sys.argv[1]](*sys.argv[2:])
