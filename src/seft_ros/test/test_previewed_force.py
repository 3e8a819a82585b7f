import numpy as np
import pytest
from seft_msgs_py.errors import InputError
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.parameter_file import parse_override
from seft_ros.experiment.blocks import build_blocks
from seft_ros.experiment.offline import simulate
from seft_ros.experiment.tables import TABLES
from seft_ros.interlock.protected_force import ProtectedForce
from seft_ros.reference_force.continuation import Continuation
from seft_ros.reference_force.previewed_force import PreviewedForce

DEMO = "config/demo.yaml"
D = 7


def experiment_of(*overrides, config=DEMO):
    return Experiment.load(TABLES, [config], [parse_override(text) for text in overrides])


def previewed(experiment):
    section, axes, timebase = experiment["reference_force"], experiment.axes, experiment.timebase
    force = ProtectedForce.from_parameters(section, axes, timebase)
    return PreviewedForce.from_parameters(force, section, axes, timebase), force


@pytest.fixture(scope="module")
def test_at_one():
    """A test at mass ratio 1, with the messages that its reference force would have sent."""
    experiment = experiment_of(
        f"reference_force:loop_delay:={D}",
        "reference_force:mass_ratio:=1.0",
        "ground_motion:synthetic.duration:=8.0",
    )
    blocks = build_blocks(experiment)
    record = simulate(experiment, blocks)
    states = record.series["rig/state"].values
    force, _ = previewed(experiment)
    window, known = 1 + force.preview, blocks.ground_motion.known
    messages = [force.step(known[k : k + window], state) for k, state in enumerate(states)]
    return experiment, record, known, messages


def test_every_message_says_the_same_of_a_step_that_it_has_settled(test_at_one):
    _, record, _, messages = test_at_one
    forces = record.series["reference_force"].values[:, 0]
    assert not forces[:D].any()
    for step, points in enumerate(messages[: -D - 1]):
        np.testing.assert_array_equal(points[: 1 + D], forces[step : step + 1 + D])


def test_the_force_goes_on_as_it_was_expected_to(test_at_one):
    _, record, _, messages = test_at_one
    forces = record.series["reference_force"].values[:, 0]
    for ahead, least in ((2, 1.5), (5, 2.0), (15, 2.0)):
        expected, held = (
            [points[D + at] - forces[step + D + ahead] for step, points in enumerate(told)]
            for told, at in ((messages[: -D - ahead], ahead), (messages[: -D - ahead], 0))
        )
        assert least * np.sqrt(np.mean(np.square(expected))) < np.sqrt(np.mean(np.square(held)))


def test_states_that_were_lost_are_bridged(test_at_one):
    experiment, record, known, messages = test_at_one
    states = record.series["rig/state"].values
    force, _ = previewed(experiment)
    window, last = 1 + force.preview, -1
    worst = 0.0
    for step, state in enumerate(states):
        if step % 40 > 35:
            continue
        lost = [known[k : k + window] for k in range(last + 1, step)]
        if lost:
            force.bridge(lost, state)
        points = force.step(known[step : step + window], state)
        worst = max(worst, np.abs(points[D] - messages[step][D]).max())
        last = step
    assert worst < 0.1 * np.abs(record.series["reference_force"].values).max()


def test_the_ramp_is_in_the_previews(test_at_one):
    experiment, record, known, messages = test_at_one
    states = record.series["rig/state"].values
    force, protected = previewed(experiment)
    window, begin = 1 + force.preview, 600
    for step, state in enumerate(states[:begin]):
        force.step(known[step : step + window], state)
    protected.ramp_down()
    ramp = round(experiment["reference_force"]["ramp_down_time"] / experiment.timebase.dt)
    for step in range(begin, begin + ramp + D):
        points = force.step(known[step : step + window], states[step])
        assert protected.at_rest == (step == begin + ramp + D - 1)
        left = begin + ramp - 1 - step  # points from the last of the ramp on are zero
        assert not points[max(0, D + left) :].any()
    assert not points.any()
    assert np.abs(messages[begin][D]).max() > 10


def test_expected_forces_stay_plausible(test_at_one):
    experiment = test_at_one[0]
    section = {**experiment["reference_force"], "limits.force": 50.0}
    axes, timebase = experiment.axes, experiment.timebase
    continuation = Continuation(section, axes, timebase)
    force = ProtectedForce.from_parameters(section, axes, timebase)
    changes = np.linspace(0.0, 100.0, continuation.steps)[:, np.newaxis]
    within = changes[changes <= 50.0]
    coming = force.coming(changes)[:, 0]
    np.testing.assert_array_equal(coming[: len(within)], within)
    assert set(coming[len(within) :]) == {within[-1]}


@pytest.mark.parametrize("alpha", [0.5, 1.0, 1.5])
def test_a_delay_of_the_loop_hardly_costs_accuracy(alpha):
    from seft_ros.analysis.summary import summarise

    errors = []
    for loop_delay in (0, 5, 12):
        experiment = experiment_of(
            f"reference_force:loop_delay:={loop_delay}", f"reference_force:mass_ratio:={alpha}"
        )
        record = simulate(experiment, build_blocks(experiment))
        assert record.trip is None
        errors.append(summarise(record)["displacement"]["nrmse"])
    assert max(errors) < 0.011
    assert max(errors) < 1.4 * errors[0]


def test_the_delay_may_be_unknown_to_who_only_measures_it():
    with pytest.raises(InputError, match=r"seft link.*loop_delay:=STEPS"):
        build_blocks(experiment_of("reference_force:loop_delay:=-1"))


def test_the_ground_motion_must_be_known_as_far_ahead_as_the_previews_reach():
    with pytest.raises(InputError, match="make the lead longer"):
        build_blocks(
            experiment_of(
                "reference_force:loop_delay:=30",
                "reference_force:compensation.method:=none",
                "ground_motion:lead:=0.1",
            )
        )


def test_a_specimen_that_yields_is_followed_at_the_pace_the_delay_allows():
    from seft_ros.analysis.summary import summarise

    experiment = experiment_of(
        "reference_force:loop_delay:=9",
        "reference_force:mass_ratio:=1.0",
        "rig:specimen.kind:=bilinear",
        "rig:specimen.yield_displacement:=0.001",
    )
    record = simulate(experiment, build_blocks(experiment))
    assert record.trip is None
    assert summarise(record)["displacement"]["nrmse"] < 0.2
