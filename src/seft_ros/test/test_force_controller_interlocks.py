"""The interlocks of a test with several rigs, each on its own axes."""

import numpy as np
from experiments_at_hand import load
from seft_plant_sim.judge.detection import detector_shares, detectors_of
from seft_plant_sim.judge.detector_list import DETECTORS
from seft_plant_sim.judge.detector_step import begin_detectors, detect_all
from seft_ros.force_controller.interlock import Interlock, Interlocks, interlock_of


def of_rigs(*words):
    return load(*words, config="two_pier_bridge")


def stepped(interlock, step, points, raw):
    """Judge a sample, and step."""
    return interlock.step(step, points, interlock.judge(step, raw))


def test_each_rig_has_an_interlock_that_sees_its_own_axes():
    both = interlock_of(of_rigs())
    alone = [interlock_of(of_rigs()) for _ in range(2)]
    rng = np.random.default_rng(3)
    for step in range(50):
        points = 1e-5 * rng.normal(size=(26, 3, 2))
        state = np.array([[5e-6], [1e-3], [0.05], [3.0]]) * rng.normal(size=(4, 2))
        state = np.vstack([state, rng.normal(size=2)])
        drive = stepped(both, step, points, state)
        for axis, one in enumerate(alone):  # what the other axis does is of no effect
            other = points.copy(), state.copy()
            for values in other:
                values[..., 1 - axis] = 0.0
            assert stepped(one, step, *other)[axis] == drive[axis] != 0.0
    assert both.reason == ""


def test_the_first_rig_that_trips_gives_the_reason_and_a_reset_is_for_all():
    both = interlock_of(of_rigs("rig:safe.close_time:=0.0"))
    points, rest = np.zeros((26, 3, 2)), np.zeros((5, 2))
    points[0, 2] = 0.0, 1e6
    assert np.array_equal(stepped(both, 0, points, rest), [0.0, 0.0])
    assert both.reason.startswith("reference force 1e+06 N on axis east/pier is beyond")
    points[0, 2] = -1e6, 1e6
    stepped(both, 1, points, rest)
    assert both.reason.startswith("reference force -1e+06 N on axis west/pier is beyond")
    both.reset()
    assert both.reason == ""
    points[0, 2] = 0.0
    stepped(both, 0, points, rest)
    assert both.reason == ""


def test_one_rig_needs_one_interlock():
    assert isinstance(interlock_of(load(config="demo")), Interlock)
    assert isinstance(interlock_of(of_rigs()), Interlocks)


def test_shares_of_a_test_are_the_largest_of_all_its_rigs():
    experiment = of_rigs("/**:limits.command:=0.5")
    section, axes = experiment["force_controller"], experiment.axes
    rng = np.random.default_rng(4)
    noise = np.array([5e-6, 1e-3, 0.05, 3.0, 1.0])[:, np.newaxis] * [1.0, 2.0]
    states = noise * rng.normal(size=(50, 5, 2))
    points, steps = 1e-5 * rng.normal(size=(50, 3, 2)), np.arange(50)
    found, expected = [], []
    for own in ([0], [1]):
        p, state = detectors_of(section, axes, experiment.timebase.dt, own)
        begin_detectors(p, state)
        series = (np.ascontiguousarray(each[..., own]) for each in (points, states))
        detect_all(p, state, steps, *series, np.empty((4, 1)))
        expected.append(state.shares[:, 0])
    found = detector_shares(experiment, steps, points, states)
    assert list(found) == [one.name for one in DETECTORS]
    np.testing.assert_array_equal(list(found.values()), np.max(expected, axis=0))
    assert not np.array_equal(expected[0], expected[1])
