"""A loop with a delay: what the reference force tells of coming steps, and what that costs."""

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from seft_msgs_py.errors import InputError
from seft_ros.analysis.summary import summarise
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate_test

D = 7
FORCE_ALONE = (
    "reference_force:compensation.method:=model",
    "reference_force:compensation.delay:=0.012",
    "reference_force:mass_ratio:=0.3",
)


def experiment_of(*overrides, config="demo"):
    given = [f"reference_force:loop_delay:={D}", "ground_motion:synthetic.duration:=8.0"]
    return load(*given, *overrides, config=config)


class Sent:
    """A test, with the messages that its reference force would have sent."""

    def __init__(self, experiment):
        blocks = build_blocks(experiment)
        self.record = simulate_test(experiment, blocks)
        self.states = self.record.series["rig/state"].values
        self.told = self.record.series["reference_force"].values
        self.force, self.known = blocks.reference_force, blocks.ground_motion.known
        self.force.reset()
        self.messages = [self.step(k) for k in range(len(self.states))]

    def motion(self, k):
        return self.known[k : k + 1 + self.force.preview]

    def step(self, k):
        return self.force.step(self.motion(k), self.states[k])

    def largest_error_with_lost_states(self):
        """Largest change of the force of step k + D where of forty states four are lost."""
        self.force.reset()
        last, worst = -1, 0.0
        for k, state in enumerate(self.states):
            if k % 40 > 35:
                continue
            if k > last + 1:
                self.force.bridge([self.motion(lost) for lost in range(last + 1, k)], state)
            points, last = self.step(k), k
            worst = max(worst, np.abs(points[D, -1] - self.messages[k][D, -1]).max())
        return worst / np.abs(self.told[:, -1]).max()


@pytest.fixture(scope="module")
def of_a_force():
    return Sent(experiment_of(*FORCE_ALONE, config="jhu"))


@pytest.fixture(scope="module")
def of_a_target():
    return Sent(experiment_of())


def test_every_message_says_the_same_of_a_step_that_it_has_settled(of_a_force):
    assert not of_a_force.told[:D].any()
    for step, points in enumerate(of_a_force.messages[: -D - 1]):
        np.testing.assert_array_equal(points, of_a_force.told[step : step + 1 + D])


def test_a_target_is_told_as_it_will_be(of_a_target):
    told = of_a_target.told
    scale = np.abs(told).max(axis=(0, 2))
    for ahead, most in ((D, 0.02), (D + 10, 0.05)):
        coming = np.array([points[ahead] for points in of_a_target.messages[:-ahead]])
        assert (np.abs(coming - told[ahead:]).max(axis=(0, 2)) < most * scale).all()


def test_states_that_were_lost_are_bridged(of_a_force, of_a_target):
    assert of_a_force.largest_error_with_lost_states() < 0.1
    assert of_a_target.largest_error_with_lost_states() < 0.06


@pytest.mark.parametrize("alpha", [0.5, 1.0, 1.5])
def test_a_delay_of_the_loop_costs_a_target_no_accuracy(alpha):
    errors = []
    for loop_delay in (0, 5, 30):
        experiment = experiment_of(
            f"reference_force:loop_delay:={loop_delay}", f"reference_force:mass_ratio:={alpha}"
        )
        record = simulated(experiment)
        assert record.trip is None
        errors.append(summarise(record)["displacement"]["nrmse"])
    assert max(errors) < 0.008
    assert max(errors) < 1.1 * errors[0]


def test_the_delay_may_be_unknown_to_who_only_measures_it():
    with pytest.raises(InputError, match=r"seft link.*loop_delay:=STEPS"):
        build_blocks(experiment_of("reference_force:loop_delay:=-1"))


def test_the_ground_motion_must_be_known_as_far_ahead_as_the_target_is_told():
    with pytest.raises(InputError, match="make the lead longer"):
        build_blocks(experiment_of("reference_force:loop_delay:=50", "ground_motion:lead:=0.1"))


def test_a_controller_that_follows_a_target_needs_one():
    with pytest.raises(InputError, match=r"compensation\.method is none; make that target_motion"):
        build_blocks(experiment_of("reference_force:compensation.method:=none"))


def test_a_target_needs_a_controller_that_follows_it():
    with pytest.raises(InputError, match="does not follow; make that velocity_feedforward"):
        build_blocks(experiment_of("force_controller:method:=transfer_function"))
