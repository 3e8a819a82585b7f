import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from seft_plant_sim.command import MessagesAhead

D = 3
NOTHING = np.zeros((1 + D, 1))


def points(step):
    return np.full((1 + D, 1), float(step))


@given(st.lists(st.integers(0, D), min_size=10, max_size=40))
def test_when_a_message_came_does_not_matter_if_it_came_in_time(late):
    """It is there by the step that uses it, and none overtakes another."""
    there = np.maximum.accumulate(np.arange(len(late)) + late)
    ahead = MessagesAhead(D, NOTHING)
    for step in range(len(late)):
        for sent in np.flatnonzero(there == step):
            ahead.add(int(sent), points(sent))
        age, found = ahead.of(step)
        assert age == min(D, step + 1)
        assert found[0, 0] == (step - D if step >= D else 0.0)


def test_where_one_is_missing_the_next_counts_and_then_the_last():
    ahead = MessagesAhead(D, NOTHING)
    for step in (0, 1, 3):
        ahead.add(step, points(step))
    assert ahead.of(D + 1)[0] == D
    assert ahead.of(D + 2)[0] == D - 1
    assert ahead.of(D + 3)[0] == D
    age, found = ahead.of(D + 10)
    assert age == D + 7
    assert found[0, 0] == 3.0
