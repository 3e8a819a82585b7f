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


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["/**:loop_delay:=-1"], r"seft link.*loop_delay:=STEPS"),  # who measures it needs none
        (["/**:loop_delay:=50", "ground_motion:lead:=0.1"], "make the lead longer"),
        (["reference_force:compensation.method:=none"], r"method is none; make that target_motion"),
        (["force_controller:method:=transfer_function"], "follow; make that velocity_feedforward"),
    ],
)
def test_what_does_not_fit_a_delay_or_a_target_is_refused(words, remedy):
    with pytest.raises(InputError, match=remedy):
        build_blocks(experiment_of(*words))
