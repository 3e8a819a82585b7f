"""What a method identifies on line, as the offline loop and the node show it."""

from types import SimpleNamespace

import numpy as np
import pytest
from experiments_at_hand import JHU, load, simulated
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import WireError
from seft_msgs_py.virtual import LocalGraph
from seft_msgs_py.wire.topics import ESTIMATES, GROUND_MOTION, REFERENCE_FORCE, Timebase
from seft_ros.nodes.loop_node import NODE_KINDS
from seft_ros.reference_force.compensation_methods import COMPENSATION_METHODS, none
from seft_ros.reference_force.reference_force_block import EstimateSampler, ReferenceForce

WORDS = (
    "axes:=[north, east]",
    "ground_motion:influence:=[1.0, 0.5]",
    "ground_motion:synthetic.duration:=1.5",
    "ground_motion:tail:=0.3",
    "reference_force:mass_ratio:=0.4",
)


class Watcher:
    """No compensation; its estimates are the least and the largest force so far."""

    def __init__(self, known):
        self._none = none(known)
        self.preview = 0
        self.range = np.zeros((2, known.axes))

    def reset(self):
        self._none.reset()
        self.range[:] = 0.0

    def step(self, ground_motion, state):
        np.minimum(self.range[0], state[3], out=self.range[0])
        np.maximum(self.range[1], state[3], out=self.range[1])
        return self._none.step(ground_motion, state)

    def estimates(self):
        return {"least": self.range[0], "largest": self.range[1]}  # its own arrays, not copies

    def linear(self):
        return self._none.linear()


@pytest.fixture
def watched(monkeypatch):
    """An experiment whose method identifies something."""
    monkeypatch.setitem(COMPENSATION_METHODS, "none", Watcher)
    return load(*WORDS)


def sampler(rate, estimates=dict):
    method = SimpleNamespace(preview=0, estimates=estimates)
    return EstimateSampler(ReferenceForce(method), Timebase.from_rate(rate))


@pytest.mark.parametrize(("rate", "every"), [(500.0, 50), (512.0, 51), (25.0, 2), (4.0, 1)])
def test_samples_are_due_at_step_0_and_every_tenth_of_a_second(rate, every):
    samples, due = sampler(rate), []
    for step in range(10 * every):
        if step >= samples.due:
            samples.sample(step)
            due.append(step)
    assert due == list(range(0, 10 * every, every))


@given(st.sets(st.integers(0, 1000)))
def test_where_the_due_step_was_lost_the_next_one_counts(steps):
    samples, sampled = sampler(500.0), []
    for step in sorted(steps):
        if step >= samples.due:
            samples.sample(step)
            sampled.append(step)
    firsts = {}
    for step in sorted(steps):
        firsts.setdefault(step // 50, step)
    assert sampled == list(firsts.values())


def test_the_offline_loop_keeps_what_the_method_knew_after_each_of_these_steps(watched):
    recording = simulated(watched)
    states = recording.states.values
    estimates = recording.estimates
    assert estimates.names == ("least", "largest")
    assert estimates.steps.tolist() == list(range(0, len(states), 50))
    force = states[:, 3]
    for row, step in enumerate(estimates.steps):
        so_far = np.vstack([np.zeros((1, 2)), force[: step + 1]])
        np.testing.assert_array_equal(estimates.values[row, 0], so_far.min(axis=0))
        np.testing.assert_array_equal(estimates.values[row, 1], so_far.max(axis=0))


def test_estimates_may_not_change_their_names(watched, monkeypatch):
    names = iter([*[{"delay": np.zeros(2)}] * 3, {"stiffness": np.zeros(2)}])
    monkeypatch.setattr(Watcher, "estimates", lambda self: next(names))
    with pytest.raises(WireError, match="step 50 are stiffness, but were delay"):
        simulated(watched)


@pytest.fixture
def graph(watched):
    """The nodes of a test with this method, in virtual time."""
    words = ("rig:pace:=lockstep", "supervisor:rehearsal.duration:=0.0")
    with LocalGraph(NODE_KINDS, [JHU], *WORDS, *words) as made:
        yield made


def test_a_state_that_is_faster_than_its_ground_motion_is_answered_when_that_has_come(graph):
    graph.delay(GROUND_MOTION, 3.0)
    graph.until("ready")
    graph.call("start")
    graph.run(1.0)
    assert (graph.state, len(graph.samples(REFERENCE_FORCE)[0])) == ("running", 0)
    graph.until(lambda: graph.samples(REFERENCE_FORCE)[0])
    motion = next(each.raw for each in graph.graph.sent if each.topic == GROUND_MOTION.name)
    graph.graph.rules.clear()
    graph.inject(GROUND_MOTION, motion, "ground_motion")
    graph.until("done")
    assert any("in the middle of a test" in line.text for line in graph.graph.lines)


def test_an_estimate_that_is_not_finite_is_refused_and_the_test_goes_on(graph, monkeypatch):
    real = Watcher.estimates

    def later_nan(self):
        found = real(self)
        return found if found["largest"][1] < 5.0 else {**found, "least": np.full(2, np.nan)}

    recording = simulated(graph.experiment)
    monkeypatch.setattr(Watcher, "estimates", later_nan)
    graph.until("ready")
    graph.call("start")
    graph.until("done")
    sent = [each.topic for each in graph.graph.sent].count(ESTIMATES.name)
    assert 0 < sent < len(recording.estimates.steps)
    message = "least of reference_force: north is nan, but must be a finite number"
    assert any(message in line.text for line in graph.graph.lines)
    assert graph.status("reference_force")["refused"] == str(len(recording.estimates.steps) - sent)
