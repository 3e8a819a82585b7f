import numpy as np
import pytest
from experiments_at_hand import load
from seft_msgs_py.wire.outcome import LinkReport
from seft_msgs_py.wire.topics import LOOP_TOPICS
from seft_ros.analysis.timing import link_numbers
from seft_ros.bags.recording import Recording, Series
from seft_ros.test_run.link import (
    Allowed,
    RoundTrips,
    allowed,
    assess_link,
    message_size,
    with_loop_delay,
)


def trips(numbers, times=0.011, sent=10, rate=500.0):
    times = np.broadcast_to(times, (len(numbers),)).astype(float)
    return RoundTrips(rate, sent, times, np.array(numbers, dtype=np.int64))


def test_what_comes_back_tells_of_loss_bursts_and_order():
    all_there = trips(range(10))
    assert (all_there.lost, all_there.longest_burst, all_there.reordered) == (0, 0, 0)
    some = trips([0, 1, 5, 4, 6])
    assert (some.lost, some.longest_burst, some.reordered) == (5, 3, 1)
    twice = trips([0, 1, 1, 2, 3, 4, 5, 6, 7, 8])
    assert (twice.lost, twice.longest_burst) == (1, 1)


def test_the_delay_covers_nearly_all_round_trips_and_one_step_more():
    assert trips(range(10), 0.0119).loop_delay == 6 + 1
    assert trips(range(10), 0.0121).loop_delay == 7 + 1
    rare = np.full(1000, 0.0119)
    rare[500] = 0.5
    assert trips(range(1000), rare, 1000).loop_delay == 7
    numbers = trips(range(10), 0.004).numbers_by_name()
    assert numbers["rate_within_a_step_hz"] == pytest.approx(250.0)


def test_the_delay_of_the_loop_lowers_the_mass_ratio_that_preflight_allows():
    plain = load()
    far, near = (allowed(plain, steps) for steps in (10, 1))
    assert far.critical_mass_ratio < near.critical_mass_ratio
    assert allowed(plain, 10) == far  # the experiment is left as it was
    assert plain["reference_force"]["loop_delay"] == 0
    assert with_loop_delay(plain, 4)["force_controller"]["loop_delay"] == 4


@pytest.mark.parametrize(
    ("found", "test", "verdict", "words"),
    [
        (trips(range(10)), None, "good", ""),
        (trips(range(10)), Allowed(1.0, 2.0, stable=True), "good", ""),
        (trips(range(10)), Allowed(1.0, 1.1, stable=True), "marginal", "critical mass ratio 1.1"),
        (trips(range(10)), Allowed(1.0, None, None, unknown="x"), "marginal", "preflight"),
        (trips(range(10)), Allowed(1.0, 0.5, stable=False), "unusable", "delay of 7 steps"),
        (trips(range(9)), None, "marginal", "10 % of the messages were lost, up to 1 in a row"),
        (trips(range(5)), None, "unusable", "50 % of the messages were lost"),
        (trips(range(10), 0.3), None, "unusable", "more than 100"),
    ],
)
def test_the_verdict_says_why(found, test, verdict, words):
    said, reasons = assess_link(found, test)
    assert said == verdict
    assert bool(reasons) == bool(words)
    assert words in " ".join(reasons)


def test_messages_are_as_large_as_those_of_a_test():
    alone = message_size(load())
    assert 300 < alone < 1472  # one packet
    assert message_size(load("/**:axes:=[a, b, c]")) > alone
    target = message_size(load("reference_force:compensation.method:=target_motion"))
    assert target > 2 * alone


def test_a_recording_over_a_link_counts_what_was_predicted():
    report = LinkReport({5: 90, 7: 8, 9: 2}, held=1)
    assert LinkReport.from_json(report.to_json()) == report
    with pytest.raises(ValueError, match="link"):
        LinkReport.from_json('{"ages": 3}')
    nothing = Series(np.empty(0, np.int64), np.empty((0, 1, 1)))
    series = {topic.name: nothing for topic in LOOP_TOPICS}
    recording = Recording(load("/**:loop_delay:=7"), series, link=report)
    numbers = {"loop_delay": 7, "late": 2, "held": 1, "forces": 100}
    assert link_numbers(recording) == numbers | {"age": {"p50": 5, "p99": 9, "largest": 9}}
    assert link_numbers(Recording(load(), series, link=report)) is None
