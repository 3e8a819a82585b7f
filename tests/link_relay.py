"""A link between two network interfaces, in user space: delay, jitter, loss, and a cut.

Run as ``python link_relay.py INTERFACE INTERFACE SEED``. Frames go through as they are. Reads
commands on stdin, a JSON object a line, and answers each with the counts so far:

- ``delay``, ``jitter``: s each way, jitter uniform to either side
- ``loss``: share of the frames that are lost, each by itself
- ``burst``: s for which all frames of a direction are lost, every ``burst_period`` s
- ``cut``: whether nothing goes through
"""

import json
import random
import select
import socket
import sys
import time
from collections import deque

ALL_PROTOCOLS = 0x0003
OUTGOING = 4  # what this host itself sends on the interface
LARGEST = 65_536


class Way:
    """Frames in one direction."""

    def __init__(self, source, target, rng):
        self.source, self.target, self.rng = source, target, rng
        self.queue, self.last = deque(), 0.0
        self.counts = {"passed": 0, "lost": 0}

    def take(self, link, now):
        while True:
            try:
                frame, address = self.source.recvfrom(LARGEST)
            except BlockingIOError:
                return
            if address[2] == OUTGOING:
                continue
            in_burst = link["burst"] and now % link["burst_period"] < link["burst"]
            if link["cut"] or in_burst or self.rng.random() < link["loss"]:
                self.counts["lost"] += 1
                continue
            due = now + link["delay"] + self.rng.uniform(-1.0, 1.0) * link["jitter"]
            self.last = max(due, self.last)
            self.queue.append((self.last, frame))

    def give(self, now):
        while self.queue and self.queue[0][0] <= now:
            self.target.send(self.queue.popleft()[1])
            self.counts["passed"] += 1


def opened(interface):
    link = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ALL_PROTOCOLS))
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    link.bind((interface, 0))
    link.setblocking(False)
    return link


def main():
    one, other = opened(sys.argv[1]), opened(sys.argv[2])
    rng = random.Random(int(sys.argv[3]))
    ways = [Way(one, other, rng), Way(other, one, rng)]
    link = {"delay": 0.0, "jitter": 0.0, "loss": 0.0}
    link |= {"burst": 0.0, "burst_period": 1.0, "cut": False}
    print("ready", flush=True)
    while True:
        due = [way.queue[0][0] for way in ways if way.queue]
        wait = max(0.0, min(due) - time.monotonic()) if due else 1.0
        readable, _, _ = select.select([one, other, sys.stdin], [], [], wait)
        now = time.monotonic()
        for way in ways:
            way.take(link, now)
            way.give(time.monotonic())
        if sys.stdin in readable:
            line = sys.stdin.readline()
            if not line:
                return
            link |= json.loads(line)
            print(json.dumps([way.counts for way in ways]), flush=True)


if __name__ == "__main__":
    main()
