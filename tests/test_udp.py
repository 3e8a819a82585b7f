"""A controller at the other end of UDP: the example in C, and ones of either side that lie.

Datagrams are put together here from the table of docs/udp.md alone.
"""

import contextlib
import functools
import itertools
import random
import signal
import socket
import struct
import subprocess
import time
import zlib
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from graph_tools import PATIENCE, ROOT
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError
from seft_plant_sim.hardware import udp
from seft_plant_sim.hardware.udp import UDP_COUNTS, UDP_ROWS, UdpHardware

CLOSED, RUN = 0, 1
CLOCKS = ("controller", "host")
SILENCE = 1.5  # s, where a test waits for it
SOURCE = ROOT / "examples" / "udp_controller" / "controller.c"
MISTAKES = (
    *("lost", "repeated", "reordered", "late", "corrupted", "truncated", "too long"),
    *("stranger", "other magic", "other version", "other axes"),
)
COUNTED = {"too long": "truncated", **dict.fromkeys(MISTAKES[-4:], "foreign")}
_courses = st.lists(st.sampled_from(("good", *MISTAKES)), max_size=12)


def datagram(magic, step, mode, *values, version=1, axes=1):
    raw = bytearray(20 + 8 * len(values))
    struct.pack_into("<4sHHII", raw, 0, magic, version, axes, step % 2**32, mode)
    struct.pack_into(f"<{len(values)}d", raw, 16, *values)
    struct.pack_into("<I", raw, len(raw) - 4, zlib.crc32(raw[:-4]))
    return bytes(raw)


def sample(step, state=CLOSED, **changes):
    time = (step % 2**32) / 500.0
    return datagram(b"SEFS", step, state, time, step, 0.2, 0.3, np.nan, **changes)


def command(step, mode=RUN, drive=0.0, **changes):
    return datagram(b"SEFC", step, mode, drive, **changes)


def course(kinds, make, bad, first):
    """Make datagrams with mistakes, from a step on: (datagram, step or None for a mistake, kind).

    ``make`` makes one that is to be obeyed, ``bad`` one that is not.
    """
    step, sent = first + 1, [(make(first), first, "good")]
    other = {"other version": {"version": 2}, "other axes": {"axes": 2}}
    for place, kind in enumerate((*kinds, "good")):
        draw, raw = random.Random(place), bad(step)
        if kind in ("lost", "reordered", "late"):
            passed, step = step, step + 1
            for _ in range(1 + (kind == "late")):
                sent.append((make(step), step, "good"))
                step += 1
            raw = bad(passed)
        elif kind == "good":
            sent.append((make(step), step, kind))
            step += 1
        elif kind == "repeated":
            raw = bad(draw.choice([known for _, known, _ in sent if known is not None][-8:]))
        elif kind == "corrupted":
            bit = draw.randrange(8 * len(raw))
            raw = raw[: bit // 8] + bytes([raw[bit // 8] ^ 1 << bit % 8]) + raw[bit // 8 + 1 :]
        elif kind == "truncated":
            raw = raw[: draw.randrange(len(raw))]
        elif kind == "too long":
            raw = raw[:-4] + bytes(8)
            raw += struct.pack("<I", zlib.crc32(raw))
        elif kind == "other magic":
            raw = b"SEFX" + raw[4:-4]
            raw += struct.pack("<I", zlib.crc32(raw))
        elif kind in other:
            raw = bad(step, **other[kind])
        if kind not in ("good", "lost"):
            sent.append((raw, None, kind))
    return [*sent, (make(step), step, "good")]


def counts_of(kinds):
    """Count what a course has of each kind; what is overtaken is lost first."""
    counts = Counter(COUNTED.get(kind, kind) for kind in kinds if kind != "good")
    counts["lost"] += counts["reordered"] + counts["late"]
    return {kind: counts[kind] for kind in UDP_COUNTS}


class Peer:
    """A socket of this test, and one that is nobody's business."""

    def __init__(self):
        self.socket, self.stranger = (socket.socket(type=socket.SOCK_DGRAM) for _ in range(2))
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(PATIENCE)
        self.port = self.socket.getsockname()[1]

    def send(self, raw, port, kind="good"):
        sender = self.stranger if kind == "stranger" else self.socket
        sender.sendto(raw, ("127.0.0.1", port))

    def hear(self):
        """Wait for a datagram: step, mode and values."""
        raw = self.socket.recv(4096)
        assert struct.unpack_from("<I", raw, len(raw) - 4)[0] == zlib.crc32(raw[:-4])
        values = struct.unpack_from(f"<{len(raw) // 8 - 2}d", raw, 16)
        return *struct.unpack_from("<II", raw, 8), values

    def newest(self):
        """Give the last datagram that came."""
        found = self.hear()
        self.socket.settimeout(0.0)
        with contextlib.suppress(BlockingIOError):
            while True:
                found = self.hear()
        self.socket.settimeout(PATIENCE)
        return found

    def close(self):
        self.socket.close()
        self.stranger.close()


@pytest.fixture
def peer():
    made = Peer()
    yield made
    made.close()


@contextlib.contextmanager
def hosting(controller, clock, port=0, timeout=PATIENCE, axes=("x",), **settings):
    parameters = {row.name: row.default for row in UDP_ROWS}
    parameters |= {"rate": 500.0, "pace": "lockstep", "safe.valve_command": 0.5}
    address = controller if isinstance(controller, str) else f"127.0.0.1:{controller}"
    parameters |= {"udp.address": address, "udp.port": port, "udp.clock": clock}
    hardware = UdpHardware(parameters | {"udp.timeout": timeout} | settings, axes)
    yield hardware
    hardware.close()


def port_of(hardware):
    return hardware._socket.getsockname()[1]


def begin_test(peer, hardware):
    """Take a sample at rest, and answer it by the first command of a test."""
    peer.send(sample(1), port_of(hardware))
    hardware.read()
    hardware.write(np.ones(1))


@given(_courses)
def test_of_a_lying_controller_only_what_is_right_is_obeyed(kinds):
    peer, first = Peer(), 2**32 - 3
    with hosting(peer.port, "controller") as hardware:
        sent = course(kinds, lambda step: sample(step, RUN), sample, first)
        for place, (raw, _, kind) in enumerate(sent):
            peer.send(raw, port_of(hardware), kind)
            if place == 0:
                hardware.read()
                hardware.write(np.ones(1))
        obeyed = [step for _, step, _ in sent if step is not None]
        for step in range(first + 1, obeyed[-1] + 1):
            expected = [step, 0.2, 0.3, np.nan] if step in obeyed else [np.nan] * 4
            assert np.array_equal(hardware.read()[:, 0], expected, equal_nan=True)
            hardware.write(np.ones(1))
        assert hardware.counts == counts_of(kinds)
    peer.close()


@given(st.lists(st.sampled_from(("good", "repeated", *MISTAKES[4:])), max_size=12))
def test_by_this_host_s_clock_only_the_answer_to_its_command_is_obeyed(kinds):
    peer = Peer()
    with hosting(peer.port, "host") as hardware:
        sent = course(kinds, lambda step: sample(step, RUN), sample, first=1)
        for raw, step, kind in sent:
            peer.send(raw, port_of(hardware), kind)
            if step is not None:
                hardware.write(np.array([0.1 * step]))
                assert hardware.read()[0, 0] == step
                assert peer.hear() == (step, RUN, (0.1 * step,))
        assert hardware.counts == counts_of(kinds)
    peer.close()


def test_an_answer_to_a_command_that_is_not_the_newest_is_late(peer):
    with hosting(peer.port, "host") as hardware:
        hardware.write(np.ones(1))
        hardware.safe()
        for step in (3, 1, 2):
            peer.send(sample(step), port_of(hardware))
        assert hardware.read()[0, 0] == 2
        assert hardware.counts == dict.fromkeys(UDP_COUNTS, 0) | {"late": 1, "foreign": 1}


def test_a_lost_sample_of_a_test_keeps_its_place(peer):
    with hosting(peer.port, "controller") as hardware:
        begin_test(peer, hardware)
        for step in (2, 5):
            peer.send(sample(step, RUN), port_of(hardware))
        found = []
        for _ in range(4):
            found.append(hardware.read()[0, 0])
            hardware.write(np.ones(1))
        assert np.array_equal(found, [2, np.nan, np.nan, 5], equal_nan=True)
        said = [peer.hear()[:2] for _ in range(5)]
        assert said == [(1, CLOSED), (2, RUN), (3, RUN), (4, RUN), (5, RUN)]


def test_safe_answers_the_newest_sample_and_is_said_at_rest(peer):
    with hosting(peer.port, "controller") as hardware:
        begin_test(peer, hardware)
        peer.send(sample(2, RUN), port_of(hardware))
        peer.send(sample(3, RUN), port_of(hardware))
        hardware.safe()
        assert peer.newest() == (3, CLOSED, (0.5,))
        hardware.safe()
        for step in (4, 5, 6):
            peer.send(sample(step), port_of(hardware))
            assert hardware.read()[0, 0] == step
            assert peer.hear()[:2] == (step, CLOSED)  # at once: the next sample may be near


@pytest.mark.parametrize("clock", CLOCKS)
def test_silence_ends_a_test_and_closes(peer, clock):
    with hosting(peer.port, clock, timeout=0.1) as hardware:
        hardware.write(np.ones(1))
        with pytest.raises(TimeoutError, match="no sample from the controller") as caught:
            hardware.read()
        assert str(port_of(hardware)) in str(caught.value)
        if clock == "host":
            assert peer.newest()[1] == CLOSED


def test_unanswered_commands_are_missing_samples_until_it_is_silence(peer):
    with hosting(peer.port, "host", timeout=0.1, pace="realtime", rate=20.0) as hardware:
        hardware.write(np.ones(1))
        assert np.isnan(hardware.read()).all()
        hardware.write(np.ones(1))
        with pytest.raises(TimeoutError):
            hardware.read()


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_controller_that_closes_by_itself_ends_the_test(peer, clock):
    with hosting(peer.port, clock) as hardware:
        begin_test(peer, hardware)
        peer.send(sample(2, RUN), port_of(hardware))
        hardware.read()
        hardware.write(np.ones(1))
        peer.send(sample(3, CLOSED), port_of(hardware))
        with pytest.raises(ConnectionError, match="has closed its valve by itself"):
            hardware.read()
        hardware.write(np.ones(1))  # of the stop that follows
        peer.send(sample(4 + hardware.can_wait), port_of(hardware))
        hardware.read()
        assert peer.newest()[1] == CLOSED
        hardware.safe()
        hardware.write(np.ones(1))  # of another test
        peer.send(sample(*((7, RUN) if clock == "host" else (5, CLOSED))), port_of(hardware))
        hardware.read()
        hardware.write(np.ones(1))
        assert peer.newest()[1] == RUN


def test_a_controller_that_does_not_open_its_valve_ends_the_test(peer):
    with hosting(peer.port, "host") as hardware:
        hardware.write(np.ones(1))
        peer.send(sample(1), port_of(hardware))
        with pytest.raises(ConnectionError, match="does not open"):
            hardware.read()


def test_a_host_that_stood_still_obeys_nothing_that_waited(peer, monkeypatch):
    with hosting(peer.port, "controller") as hardware:
        begin_test(peer, hardware)
        for step in (2, 4, 5):
            peer.send(sample(step, RUN), port_of(hardware))
        hardware.read()
        hardware.read()  # of step 3, which was lost
        later = SimpleNamespace(monotonic=lambda: time.monotonic() + 2 * PATIENCE)
        monkeypatch.setattr(udp, "time", later)
        with pytest.raises(TimeoutError):
            hardware.read()
        assert peer.newest()[1] == CLOSED


def test_a_controller_of_another_rate_is_refused(peer):
    with hosting(peer.port, "controller", rate=100.0) as hardware:
        for step in (0, 99):
            peer.send(sample(step), port_of(hardware))
            hardware.read()
        peer.send(sample(100), port_of(hardware))
        with pytest.raises(ConnectionError, match=r"by 0\.2 in 100 steps"):
            hardware.read()


@pytest.mark.parametrize("address", ["127.0.0.1", "127.0.0.1:x", "127.0.0.1:0", "127.0.0.1:70000"])
def test_an_address_that_is_none_is_an_error(address):
    with pytest.raises(InputError, match=r"udp\.address"), hosting(address, "host"):
        pass


def test_a_port_that_another_has_is_an_error(peer):
    with pytest.raises(InputError, match="in use"), hosting(peer.port, "host", peer.port):
        pass


# ---- the example in C


@pytest.fixture(scope="module")
def compiled_controller(tmp_path_factory):
    """Compile the example for a number of axes."""

    def make(axes):
        file = tmp_path_factory.mktemp("controller") / "controller"
        flags = ("-std=c99", "-pedantic", "-O2", "-Wall", "-Wextra", "-Werror", f"-DAXES={axes}")
        subprocess.run(["gcc", *flags, SOURCE, "-o", file, "-lm"], check=True)
        return file

    return functools.cache(make)


@pytest.fixture
def controller(compiled_controller):
    """Start controllers, which end with this test."""
    with contextlib.ExitStack() as started:

        def start(port, host, clock, timeout=PATIENCE, axes=1):
            words = (port, f"127.0.0.1:{host}", 500, clock, timeout)
            process = subprocess.Popen(
                [compiled_controller(axes), *map(str, words)], stdout=subprocess.PIPE, text=True
            )
            started.enter_context(process)
            started.callback(process.kill)
            assert process.stdout.readline() == "ready\n"
            return process

        yield start


@pytest.fixture
def free_port():
    made = Peer()
    made.close()
    return made.port


def counts_at_exit(process):
    process.terminate()
    words = process.communicate(timeout=PATIENCE)[0].splitlines()[-1].split()
    return {kind: int(count) for kind, count in zip(words[::2], words[1::2], strict=True)}


def open_valve(hardware):
    """Begin a test after a while at rest: the piston moves."""
    for _ in range(5):
        hardware.read()
    displacement = 0.0
    while not displacement > 1e-3:
        hardware.write(np.full(1, 0.3))
        displacement = hardware.read()[0, 0]


def line_with(process, text):
    """Wait until a controller says something."""
    while text not in (line := process.stdout.readline()):
        assert line, f"it ended without {text}"
    return line


@pytest.mark.parametrize("clock", CLOCKS)
def test_the_controller_moves_its_piston_and_closes_when_told(controller, free_port, clock):
    with hosting(free_port, clock) as hardware:
        process = controller(free_port, port_of(hardware), clock)
        open_valve(hardware)
        hardware.safe()
        for _ in range(50):  # 0.1 s
            hardware.read()
        line_with(process, "closes: commanded")
        line_with(process, "valve at 0.5 V")


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("ended_by", [signal.SIGKILL, signal.SIGSTOP])
def test_a_controller_that_is_gone_ends_it_and_may_come_back(
    controller, free_port, clock, ended_by
):
    with hosting(free_port, clock, timeout=SILENCE) as hardware:
        process = controller(free_port, port_of(hardware), clock, SILENCE)
        open_valve(hardware)
        process.send_signal(ended_by)
        with pytest.raises(TimeoutError, match="no sample"):
            while True:
                hardware.write(np.full(1, 0.3))
                hardware.read()
        process.send_signal(signal.SIGCONT)
        if ended_by == signal.SIGSTOP:
            line_with(process, "closes: silence")
        else:
            process.wait()
            controller(free_port, port_of(hardware), clock, SILENCE)
        open_valve(hardware)


def exchanged(peer, port, clock, step, mode, drive=0.0):
    """Be a host for a step; give its number, the valve's state, and the displacement."""
    if clock == "host":
        peer.send(command(step + 1, mode, drive), port)
    step, state, values = peer.newest()
    if clock == "controller":
        peer.send(command(step, mode, drive), port)
    return step, state, values[1]


@pytest.mark.parametrize("clock", CLOCKS)
def test_who_lost_its_host_closes_and_no_old_command_opens(controller, peer, free_port, clock):
    process = controller(free_port, peer.port, clock, SILENCE)
    step = 0
    for mode in itertools.chain([CLOSED] * 50, itertools.repeat(RUN)):
        step, state, _ = exchanged(peer, free_port, clock, step, mode)
        if state == RUN:
            break
    line_with(process, "closes: silence")
    if clock == "controller":
        step, _, _ = peer.newest()  # of what waits since it was open
    for _ in range(20):
        step, state, displacement = exchanged(peer, free_port, clock, step, RUN, 9.0)
        assert state == CLOSED
        assert abs(displacement) < 1e-3
    found = counts_at_exit(process)
    assert found["unarmed"] + found["late"] >= 19


def test_of_a_lying_host_only_what_is_right_is_obeyed(controller, peer, free_port):
    process = controller(free_port, peer.port, "host")
    peer.send(command(1, CLOSED), free_port)
    peer.hear()
    kinds = random.Random(1).choices(("good", *MISTAKES), k=400)
    lie = functools.partial(command, drive=9.0)
    for raw, step, kind in course(kinds, command, lie, first=2):
        peer.send(raw, free_port, kind)
        if step is not None:
            last, state, values = peer.hear()
            assert (last, state) == (step, RUN)
            assert abs(values[1]) < 1e-3
    for raw in (command(last + 1, 2), command(last + 1, drive=np.nan), command(last + 1, drive=11)):
        peer.send(raw, free_port)
    peer.send(command(last + 1), free_port)
    peer.hear()
    expected = counts_of(kinds)
    expected["corrupted"] += 3
    assert counts_at_exit(process) == expected | {"unarmed": 0}


def test_by_the_controller_s_clock_the_newest_sample_s_answer_is_obeyed(
    controller, peer, free_port
):
    process = controller(free_port, peer.port, "controller")
    for _ in range(20):
        step = peer.newest()[0]
        peer.send(command(step - 1, CLOSED), free_port)
        peer.send(command(step - 1, RUN, 9.0), free_port)
    for _ in range(50):
        step, state, values = peer.newest()
        assert state == CLOSED
        assert abs(values[1]) < 1e-3
        for old in (command(step, CLOSED), command(step, RUN, 9.0), command(step - 1, RUN, 9.0)):
            peer.send(old, free_port)
        peer.send(command(step + 2**30, RUN, 9.0), free_port)
    seen = peer.newest()[0]
    while peer.newest()[0] < seen + 2:
        pass  # by then it has read all
    found = counts_at_exit(process)
    assert found["foreign"] == 50
    assert found["late"] >= 40
    assert found["repeated"] + found["reordered"] + found["late"] >= 140


def test_a_controller_of_other_axes_is_named(controller, free_port):
    with hosting(free_port, "controller", timeout=SILENCE) as hardware:
        controller(free_port, port_of(hardware), "controller", axes=2)
        with pytest.raises(TimeoutError, match="with 2 axes, not 1"):
            hardware.read()
