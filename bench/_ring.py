"""A bare ring of three processes that hand on raw messages: the floor of the loop over DDS.

Run as a program it is one of the two that only hand on; `lap_times` is the third.
"""

import os
import statistics
import subprocess
import sys
import time

import rclpy
from _udp_ring import MESSAGE_SIZE
from rclpy.node import Node
from seft_msgs_py.node.process import PROFILES, RANGE
from seft_msgs_py.node.rclpy_interface import (
    WaitSet,
    message_class,
    qos_profile,
    raw_subscription,
    sender,
    taker,
)
from seft_msgs_py.wire.topics import JOINT_TRAJECTORY, Topic


class Station:
    """Receives on one topic and publishes on another."""

    def __init__(self, listens: str, speaks: str) -> None:
        rclpy.init(args=[])
        self.node = Node(f"ring_{speaks}")
        inward, outward = (Topic(name, JOINT_TRAJECTORY) for name in (listens, speaks))
        self.subscription = raw_subscription(self.node, inward, 64)
        self.publisher = self.node.create_publisher(
            message_class(outward), outward.name, qos_profile(outward)
        )
        self.send = sender(self.publisher)
        self._take = taker(self.subscription)
        self.wait_set = WaitSet(self.node.context, [self.subscription])

    def receive(self, timeout: float) -> bytes | None:
        """Wait for a message and take it."""
        taken = self._take() if self.wait_set.wait(timeout) else None
        return taken and taken[0]

    def matched(self) -> bool:
        """Whether both neighbours are there."""
        listeners = self.publisher.get_subscription_count()
        return listeners > 0 and self.subscription.get_publisher_count() > 0


def hand_on(listens: str, speaks: str) -> None:
    """Hand on messages until killed."""
    station = Station(listens, speaks)
    while True:
        raw = station.receive(1.0)
        if raw is not None:
            station.send(raw)


def lap_times(laps: int) -> list[float]:
    """Send a message round the ring ``laps`` times; return the times of the laps, s."""
    others = [
        subprocess.Popen([sys.executable, __file__, listens, speaks])
        for listens, speaks in (("ring_a", "ring_b"), ("ring_b", "ring_c"))
    ]
    try:
        station = Station("ring_c", "ring_a")
        message, times = os.urandom(MESSAGE_SIZE), []
        while not station.matched():
            time.sleep(0.05)
        time.sleep(0.5)  # the other two may still be finding each other
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
        hand_on(sys.argv[1], sys.argv[2])
