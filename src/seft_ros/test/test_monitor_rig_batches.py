"""States of several rigs, as a monitor puts them together."""

import numpy as np
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.topics import rigs_of
from seft_ros.monitor.history import RigBatches
from seft_ros.monitor.session import Session

RIGS = rigs_of(["west/x", "east/x", "west/y"])


def batch(rig, steps):
    steps = np.array(steps, np.int64)
    values = np.broadcast_to((10.0 * (rig + 1) + steps)[:, None, None], (len(steps), 4, 2 - rig))
    return steps, values.copy(), 1000 * steps + rig


def test_steps_are_given_once_all_have_sent_them():
    batches = RigBatches(RIGS)
    batches.take(0, batch(0, range(5)))
    assert len(batches.complete()[0]) == 0
    batches.take(1, batch(1, [1, 2]))
    steps, values, sent = batches.complete()
    assert steps.tolist() == [1, 2]
    np.testing.assert_array_equal(values[0, 0], [11.0, 21.0, 11.0])
    assert sent.tolist() == [1001, 2001]
    assert len(batches.complete()[0]) == 0
    batches.take(1, batch(1, [3, 5]))
    batches.take(0, batch(0, [5]))
    assert batches.complete()[0].tolist() == [3, 5]


def test_a_new_test_forgets_what_waits_of_the_old():
    batches = RigBatches(RIGS)
    batches.take(0, batch(0, [7, 8]))
    batches.take(0, batch(0, [9, 0, 1]))
    batches.take(1, batch(1, [7, 8, 9]))
    assert len(batches.complete()[0]) == 0
    batches.take(1, batch(1, [0, 1, 2]))
    assert batches.complete()[0].tolist() == [0, 1]


def test_what_rigs_tell_is_shown_together():
    session = Session()
    for rig, missed, margin in (("west", 3, 0.5), ("east", 4, 0.25)):
        values = {"phase": "running", "steps": "100", "missed": str(missed)}
        values |= {"margin force": str(margin), "round trip median (ms)": str(margin)}
        session.on_diagnostics([Status(f"{rig}/rig", 0, "running", values=values)], 0.002)
    told = session.summary()
    assert told["missed"] == 7
    assert told["margins"] == {"force": 0.25}
    assert told["round_trip"] == {"median (ms)": 0.5}
    assert [node["name"] for node in told["nodes"]] == ["east/rig", "west/rig"]
