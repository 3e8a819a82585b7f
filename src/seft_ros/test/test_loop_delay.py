"""A loop with a delay: what the reference force tells of coming steps, and what that costs."""

import pytest
from experiments_at_hand import error_of, load, simulated
from seft_msgs_py.errors import InputError
from seft_ros.test_run.blocks import build_blocks


def experiment_of(*overrides, config="demo"):
    given = ["/**:loop_delay:=7", "ground_motion:synthetic.duration:=8.0"]
    return load(*given, *overrides, config=config)


@pytest.mark.parametrize("alpha", [0.5, 1.0, 1.5])
def test_a_delay_of_the_loop_costs_a_target_no_accuracy(alpha):
    errors = []
    for loop_delay in (0, 5, 30):
        experiment = experiment_of(
            f"/**:loop_delay:={loop_delay}", f"reference_force:mass_ratio:={alpha}"
        )
        recording = simulated(experiment)
        assert recording.trip is None
        errors.append(error_of(recording))
    assert max(errors) < 0.008
    assert max(errors) < 1.1 * errors[0]


def test_the_delay_may_be_unknown_to_who_only_measures_it():
    with pytest.raises(InputError, match=r"seft link.*loop_delay:=STEPS"):
        build_blocks(experiment_of("/**:loop_delay:=-1"))


def test_the_ground_motion_must_be_known_as_far_ahead_as_the_target_is_known():
    with pytest.raises(InputError, match="make the lead longer"):
        build_blocks(experiment_of("/**:loop_delay:=50", "ground_motion:lead:=0.1"))


def test_a_controller_that_follows_a_target_needs_one():
    with pytest.raises(InputError, match=r"compensation\.method is none; make that target_motion"):
        build_blocks(experiment_of("reference_force:compensation.method:=none"))


def test_a_target_needs_a_controller_that_follows_it():
    with pytest.raises(InputError, match="does not follow; make that velocity_feedforward"):
        build_blocks(experiment_of("force_controller:method:=transfer_function"))
