"""Messages that a node must not act upon."""

import struct

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import LoopTopic
from seft_msgs_py.wire.trajectory import TrajectoryCodec

FAR = 10**9  # a step that no test reaches


def bad_messages(topic: LoopTopic, experiment: Experiment) -> dict[str, bytes]:
    """One of each bad kind; stale ones are of step 0, and no step is that of a real one."""
    axes, timebase = experiment.axes, experiment.timebase
    codec = TrajectoryCodec(topic, axes, timebase)
    q = len(topic.quantities)

    def of(step: int, value: float, codec: TrajectoryCodec = codec) -> bytes:
        return codec.encode(step, np.full((q, len(codec.axes)), value))

    mark = np.float64(1234.5).tobytes()
    good = of(FAR, 1234.5)
    assert good.count(mark) == q * len(axes)
    return {
        "nan": of(0, 1234.5).replace(mark, struct.pack("<d", float("nan"))),
        "inf": of(0, 1234.5).replace(mark, struct.pack("<d", float("inf"))),
        "absurd": of(FAR, 1e30),
        "more axes": of(0, 1.0, TrajectoryCodec(topic, (*axes, "more"), timebase)),
        "wrong axis": of(0, 1.0, TrajectoryCodec(topic, ("wrong",), timebase)),
        "stale": of(0, 1.0),
        "future": of(FAR, 1.0),
        "between steps": good[:8] + struct.pack("<I", 1) + good[12:],
        "negative stamp": struct.pack("<4si", good[:4], -5) + good[8:],
        "big-endian": b"\x00\x00\x00\x00" + good[4:],
        "truncated": good[: len(good) // 2],
        "garbage": bytes(range(256)),
        "short": b"\x00",
    }
