"""Whatever bytes come on a topic, decoders give a value or the project's own error."""

import contextlib
import json

import numpy as np
import pytest
from damaged_messages import damaged
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.experiment_state import ExperimentState, decode_state, encode_state
from seft_msgs_py.wire.messages import (
    EstimatesCodec,
    Status,
    decode_clock,
    decode_description,
    decode_diagnostics,
    decode_status,
    decode_string,
    encode_clock,
    encode_diagnostics,
    encode_status,
    encode_string,
)
from seft_msgs_py.wire.outcome import State
from seft_msgs_py.wire.topics import GROUND_MOTION, LOOP_TOPICS, MEASURED, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec, parse_trajectory

TIMEBASE = Timebase.from_rate(500.0)
AXES = ("east", "north")
CODECS = [TrajectoryCodec(topic, AXES, TIMEBASE) for topic in LOOP_TOPICS]
ESTIMATES = EstimatesCodec(AXES, TIMEBASE)
STATUS = Status("rig", 1, "a message", "hardware", {"phase": "running", "steps": "7"})
DESCRIBED = json.dumps({"node": "rig", "parameters": {"rate": 500.0}})

DECODERS = {
    "status": (decode_status, encode_status(STATUS)),
    "state": (decode_state, encode_state(ExperimentState(State.RUNNING, "running", 9))),
    "diagnostics": (decode_diagnostics, encode_diagnostics(5, [STATUS, STATUS])),
    "string": (decode_string, encode_string("some text")),
    "clock": (decode_clock, encode_clock(10**9)),
    "description": (decode_description, encode_string(DESCRIBED)),
    "estimates": (ESTIMATES.decode, ESTIMATES.encode(3, {"delay": np.array([0.1, 0.2])})),
    "trajectory": (parse_trajectory, CODECS[1].encode(3, np.ones((6, 2)))),
    **{
        codec.topic.name: (codec.decode, codec.encode(3, np.ones((len(codec.topic.quantities), 2))))
        for codec in CODECS
    },
    "motion ahead": (CODECS[0].decode, CODECS[0].encode_points(3, np.ones((5, 1, 2)))),
}
LOOP_DECODERS = [codec.decode for codec in CODECS]
assert CODECS[0].topic is GROUND_MOTION

few = settings(max_examples=60, suppress_health_check=list(HealthCheck))


@few
@pytest.mark.parametrize("name", DECODERS)
@given(data=st.data(), raw=st.binary(max_size=200))
def test_decoders_raise_nothing_but_wire_errors(name, data, raw):
    decode, good = DECODERS[name]
    for one in (raw, good[:4] + raw, damaged(data, good)):
        with contextlib.suppress(WireError):
            found = decode(one)
            if decode in LOOP_DECODERS:
                step, values = found
                assert step >= 0
                assert name == MEASURED.name or np.isfinite(values).all()  # a sensor may fail
