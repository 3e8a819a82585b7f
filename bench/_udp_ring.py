"""A ring of three processes that hand on datagrams: what the kernel itself costs.

Run as a program it is one of the two that only hand on; `lap_times` is the third.
"""

import os
import socket
import subprocess
import sys
import time

HOST = "127.0.0.1"
MESSAGE_SIZE = 140  # bytes, as rig/state with one axis


def _open() -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind((HOST, 0))
    return opened


def hand_on(to: int) -> None:
    """Tell the own port, then hand on datagrams until killed."""
    station = _open()
    print(station.getsockname()[1], flush=True)
    while True:
        station.sendto(station.recv(2048), (HOST, to))


def lap_times(laps: int) -> list[float]:
    """Send a datagram round the ring ``laps`` times; return the times of the laps, s."""
    station = _open()
    station.settimeout(5.0)
    others: list[subprocess.Popen[str]] = []
    try:
        to = station.getsockname()[1]
        for _ in range(2):
            command = [sys.executable, "-I", "-S", __file__, str(to)]
            others.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
            to = int(others[-1].stdout.readline())
        message, times = os.urandom(MESSAGE_SIZE), []
        for _ in range(laps):
            start = time.perf_counter()
            station.sendto(message, (HOST, to))
            station.recv(2048)
            times.append(time.perf_counter() - start)
        return times
    finally:
        station.close()
        for other in others:
            other.kill()
            other.communicate()


if __name__ == "__main__":
    hand_on(int(sys.argv[1]))
