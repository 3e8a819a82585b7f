"""No parameter of any node may be what is no number, and no field of any message of the loop."""

import struct

import numpy as np
import pytest
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.topics import LOOP_TOPICS, TARGET, Timebase
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.test_run.parameter_tables import TABLES

NOT_FINITE = (float("nan"), float("inf"), float("-inf"))
ROWS = [(t.node, row) for t in TABLES for row in t.rows.values() if row.kind.startswith("float")]
TIMEBASE = Timebase.from_rate(500.0)


@pytest.mark.parametrize("bad", NOT_FINITE)
def test_no_parameter_takes_what_is_no_number(bad):
    assert len(ROWS) > 100
    for node, row in ROWS:
        values = [bad] if row.kind == "float" else [bad, [bad], [1.0, bad], [bad] * 1000]
        for value in values:
            with pytest.raises(InputError, match=row.name.rpartition(".")[2]):
                row.check(value, node)


@pytest.mark.parametrize("topic", [*LOOP_TOPICS, TARGET], ids=lambda topic: str(topic.units))
def test_no_field_of_a_message_takes_what_is_no_number(topic):
    codec = TrajectoryCodec(topic, ("x", "y"), TIMEBASE)
    fields = np.arange(1, 1 + 2 * len(codec.topic.quantities)) * 1234.5
    good = codec.encode(3, fields.reshape(-1, 2))
    for value in fields:
        for bad in NOT_FINITE:
            mark = struct.pack("<d", value)
            assert good.count(mark) == 1
            with pytest.raises(WireError):
                codec.decode(good.replace(mark, struct.pack("<d", bad)))
