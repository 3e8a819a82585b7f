"""What a method identifies on line, as the offline loop and the node show it."""

from types import SimpleNamespace

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from hypothesis import given
from hypothesis import strategies as st
from quiet_shell import Shell
from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import Status, encode_status
from seft_msgs_py.wire.topics import (
    ESTIMATES,
    EXPERIMENT_STATE,
    GROUND_MOTION,
    JUDGED,
    REFERENCE_FORCE,
    Timebase,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec
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
    return EstimateSampler(
        ReferenceForce(SimpleNamespace(preview=0, estimates=estimates)), Timebase.from_rate(rate)
    )


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
    record = simulated(watched)
    states = record.series[JUDGED.name].values
    estimates = record.estimates
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


def start_node(experiment):
    """Make a reference-force node; it must have tried itself out in silence."""
    shell = Shell(experiment, "reference_force")
    pytest.importorskip("seft_ros.nodes.reference_force_node").ReferenceForceNode(shell)
    assert shell.sent == []
    return shell


def feed(shell, record):
    """Hand a record's ground motion and states to the node."""
    axes, timebase = record.experiment.axes, record.experiment.timebase
    motion = TrajectoryCodec(GROUND_MOTION, axes, timebase)
    state = TrajectoryCodec(JUDGED, axes, timebase)
    samples = record.series[GROUND_MOTION.name].values
    for first in range(0, len(samples), 100):
        chunk = samples[first : first + 100]
        shell.handlers[GROUND_MOTION.name](motion.encode_points(first, chunk), 0)
    for step, sample in enumerate(record.series[JUDGED.name].values):
        shell.handlers[JUDGED.name](state.encode(step, sample), 0)


def test_a_state_that_is_faster_than_its_ground_motion_is_answered_when_that_has_come(watched):
    axes, timebase = watched.axes, watched.timebase
    shell = start_node(watched)
    running = Status("experiment", 0, "running", values={"steps": "900"})
    shell.handlers[EXPERIMENT_STATE.name](encode_status(running), 0)
    state = TrajectoryCodec(JUDGED, axes, timebase).encode(0, np.zeros((4, 2)))
    shell.handlers[JUDGED.name](state, 0)
    assert shell.sent == []
    motion = TrajectoryCodec(GROUND_MOTION, axes, timebase).encode_points(0, np.ones((100, 2)))
    shell.handlers[GROUND_MOTION.name](motion, 0)
    assert REFERENCE_FORCE in [topic for topic, _ in shell.sent]
    with pytest.raises(WireError, match="in the middle of a test"):
        shell.handlers[GROUND_MOTION.name](motion, 0)


def test_an_estimate_that_is_not_finite_is_refused_and_the_test_goes_on(watched, monkeypatch):
    record = simulated(watched)
    real = Watcher.estimates

    def later_nan(self):
        found = real(self)
        return found if found["largest"][1] < 5.0 else {**found, "least": np.full(2, np.nan)}

    monkeypatch.setattr(Watcher, "estimates", later_nan)
    shell = start_node(watched)
    feed(shell, record)
    sent = [topic for topic, _ in shell.sent]
    assert sent.count(REFERENCE_FORCE) == len(record.series[JUDGED.name].steps)
    assert 0 < sent.count(ESTIMATES) < len(record.estimates.steps)
    assert len(shell.refusals) == len(record.estimates.steps) - sent.count(ESTIMATES)
    assert set(shell.refusals) == {
        "reference_force/estimates: least of reference_force: north is nan, but must be a finite "
        "number"
    }
