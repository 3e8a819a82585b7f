"""States of several rigs are put together by step."""

import numpy as np
import pytest
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.topics import rigs_of
from seft_ros.reference_force.reference_force_block import StateGathering

RIGS = rigs_of(["west/x", "east/x", "west/y"])
WEST, EAST = np.arange(8.0).reshape(4, 2), -np.ones((4, 1))


def test_a_step_is_complete_when_all_have_sent_it():
    gathering = StateGathering(RIGS, 0.01)
    assert gathering.take(0, 0, WEST, 0.0) is None
    assert gathering.is_waiting
    whole = gathering.take(1, 0, EAST, 0.001)
    np.testing.assert_array_equal(whole, np.column_stack([WEST[:, 0], EAST, WEST[:, 1]]))
    assert not gathering.is_waiting


def test_a_complete_step_ends_the_waiting_for_those_before():
    gathering = StateGathering(RIGS, 0.01)
    assert gathering.take(0, 0, WEST, 0.0) is None
    assert gathering.take(0, 1, WEST, 0.002) is None
    assert gathering.take(1, 1, EAST, 0.003) is not None
    assert not gathering.is_waiting
    assert gathering.lost(100.0) == ""


def test_who_fails_to_send_is_named():
    gathering = StateGathering(RIGS, 0.01)
    gathering.take(0, 0, WEST, 5.0)
    assert gathering.lost(5.01) == ""
    expected = "no rig/state of east for 0.01 s (none has arrived; west is at step 0)"
    assert expected in gathering.lost(6)
    gathering.take(1, 0, EAST, 6.0)
    gathering.take(1, 1, EAST, 7.0)
    assert "of west for 0.01 s (the last is of step 0; east is at step 1)" in gathering.lost(8.0)
    gathering.reset()
    assert gathering.lost(9.0) == ""


def test_a_second_state_of_a_step_is_refused():
    gathering = StateGathering(RIGS, 0.01)
    gathering.take(0, 3, WEST, 0.0)
    with pytest.raises(WireError, match="state of step 3 of west a second time"):
        gathering.take(0, 3, WEST, 0.0)
