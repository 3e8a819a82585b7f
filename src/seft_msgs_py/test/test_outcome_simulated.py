"""The largest true motion of a simulated rig, in its last status."""

import pytest
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import decode_status, encode_status
from seft_msgs_py.wire.outcome import Outcome, Simulated, read_outcome, rig_status
from seft_msgs_py.wire.topics import Timebase

TIMEBASE = Timebase.from_rate(500.0)
PEAKS = Simulated(0.1 + 0.2, 1234.5, 1e-300)


def ended(simulated=None):
    return Outcome("finished", 9, 0, [], 1.0, simulated=simulated)


def read(status):
    return read_outcome(decode_status(encode_status(status)), TIMEBASE)


def test_it_survives_the_rigs_last_status_bit_for_bit():
    assert read(rig_status(ended(PEAKS))).simulated == PEAKS


def test_a_rig_that_is_not_simulated_says_nothing_of_it():
    status = rig_status(ended())
    assert "simulated" not in status.values
    assert read(status).simulated is None


@pytest.mark.parametrize(
    "text", ["", "3", "[]", "{}", '{"displacement_peak": 1, "force_peak": "no"}']
)
def test_other_text_is_refused(text):
    status = rig_status(ended(PEAKS))
    status.values["simulated"] = text
    with pytest.raises(WireError, match="status of the finished rig"):
        read_outcome(status, TIMEBASE)


def test_of_several_rigs_it_is_the_largest_of_any_if_all_are_simulated():
    other = Simulated(0.1, 2000.0, 5.0)
    both = Outcome.of_all([ended(PEAKS), ended(other)])
    assert both.simulated == Simulated(PEAKS.displacement_peak, 2000.0, 5.0)
    assert Outcome.of_all([ended(PEAKS), ended()]).simulated is None
