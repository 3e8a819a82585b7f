import pytest
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.node.realtime import LONGEST_GAP, AwakeClock


class Hand:
    """A clock that is set by hand."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def test_time_goes_on_while_one_looks():
    hand = Hand()
    clock = AwakeClock(hand)
    for _ in range(40):
        hand.now += 0.05
        last = clock.time()
    assert last == pytest.approx(2.0)


def test_a_long_sleep_counts_for_one_look():
    hand = Hand()
    clock = AwakeClock(hand)
    hand.now += 60.0
    assert clock.time() == LONGEST_GAP
    assert clock.time() == LONGEST_GAP


@given(st.lists(st.floats(0.0, 5.0), max_size=50))
def test_it_never_runs_back_and_never_ahead_of_the_time(gaps):
    hand = Hand()
    clock = AwakeClock(hand)
    last = 0.0
    for gap in gaps:
        hand.now += gap
        now = clock.time()
        assert last <= now <= hand.now - 100.0 + 1e-9
        last = now
