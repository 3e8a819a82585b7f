"""What the detectors of a rig know of it, and how near they came to their thresholds in a test."""

import math

import numpy as np
import pytest
from experiments_at_hand import load
from seft_msgs_py.errors import InputError
from seft_plant_sim.judge.detector_list import DETECTORS, TRACKING
from seft_plant_sim.judge.detector_step import begin_detectors, detect_all
from seft_plant_sim.judge.detectors import detectors_of
from seft_ros.analysis.summary import detector_shares
from seft_ros.bags.recording import Recording, Series
from seft_ros.force_controller import target_distance

DT = 0.002


def of_rigs(*words):
    return load(*words, config="two_pier_bridge")


def section_of(*words):
    """The rig's section of a test with two rigs, and its axes."""
    experiment = of_rigs(*words)
    return experiment["rig"], experiment.axes


def test_detectors_know_what_their_section_says_of_their_axes():
    section, axes = section_of(
        "/**:actuator.flow_gain:=[0.04, 0.05]",
        "/**:actuator.valve_frequency:=[70.0, 0.0]",
        "rig:simulated.actuator.valve_frequency:=70.0",
        "/**:sensors.force_noise:=[3.0, 4.0]",
        "/**:sensors.force_range:=[0.0, 9000.0]",
        "rig:detectors.warn_only:=oil_balance, tracking",
    )
    p, _ = detectors_of(section, axes, DT, (0, 1))
    expected = [[0.04, 1.685e7, 50.0, 24500.0], [0.0, 1.685e7, 50.0, 24500.0]]
    np.testing.assert_array_equal(p.rig.actuator[:, :1], np.array(expected)[:, :1])
    np.testing.assert_array_equal(p.rig.actuator[0], expected[0])
    assert np.isfinite(p.sums[2]).tolist() == [True, False]  # its valve is not known
    np.testing.assert_array_equal(p.noise, [[5e-6] * 2, [1e-3] * 2, [0.05] * 2, [3.0, 4.0]])
    np.testing.assert_array_equal(p.rig.ranges[3], [np.inf, 9000.0])
    np.testing.assert_array_equal(p.rig.ranges[:3, 0], [0.1, 1.0, 39.24])
    np.testing.assert_array_equal(p.rig.mass, np.diag([52.7, 45.0]))
    np.testing.assert_array_equal(p.rig.stiffness, np.diag([211e3, 160e3]))
    quiet = [one.name for one, acts in zip(DETECTORS, p.acts, strict=True) if not acts]
    assert quiet == ["oil_balance"]  # tracking is the force controller's
    assert p.persistence[2] == 3
    np.testing.assert_allclose(p.rig.past[:, 0].sum(axis=1), 1.0, atol=0.01)  # what is sent, flows
    alone, state = detectors_of(section, axes, DT, (1,))
    mass, stiffness = alone.rig.mass.item(), alone.rig.stiffness.item()
    assert (mass, stiffness, alone.noise[3, 0]) == (45.0, 160e3, 4.0)
    assert (alone.rig.ranges[3, 0], state.last.shape) == (9000.0, (4, 1))


def test_what_a_test_is_like_changes_what_its_detectors_know():
    def of(*words):
        section, axes = section_of(*words)
        return detectors_of(section, axes, DT, (0, 1))[0]

    unknown = of("/**:specimen.stiffness:=0.0")
    assert not unknown.rig.stiffness.any()
    assert np.isinf(unknown.rough).all()
    ideal = of("/**:actuator.kind:=ideal")
    assert np.isinf(ideal.sums[2]).all()
    np.testing.assert_allclose(ideal.by_force, np.linalg.inv(ideal.rig.mass))
    assert not of().by_force.any()
    assert np.isfinite(of("/**:actuator.valve_frequency:=0.5").sums[2]).all()
    assert not of("rig:detectors.warn_only:=all").acts.any()
    assert of().acts.all()
    derived = of("/**:sensors.velocity:=derived")
    np.testing.assert_allclose(derived.noise[1], math.sqrt(2.0) * 5e-6 / DT)
    with pytest.raises(InputError, match=r"detectors\.warn_only: no detector 'speed'; there are "):
        of("rig:detectors.warn_only:=speed")


def test_shares_of_a_test_are_the_largest_of_all_its_rigs():
    experiment = of_rigs()
    section, axes, dt = experiment["rig"], experiment.axes, experiment.timebase.dt
    rng = np.random.default_rng(4)
    noise = np.array([5e-6, 1e-3, 0.05, 3.0, 0.0, 1.0])[:, np.newaxis] * [1.0, 2.0]
    states = noise * rng.normal(size=(50, 6, 2))
    measured = noise[:4] * rng.normal(size=(50, 4, 2))  # which the rig's detectors see
    points, steps = 1e-5 * rng.normal(size=(50, 3, 2)), np.arange(50)
    of_loop = {"rig/state": states, "rig/measured": measured, "reference_force": points}
    of_loop |= dict.fromkeys(("valve_command", "ground_motion"), np.zeros((50, 1, 2)))
    series = {name: Series(steps, values) for name, values in of_loop.items()}
    expected = []
    for own in ([0], [1]):
        p, state = detectors_of(section, axes, dt, own)
        begin_detectors(p, state)
        shown, drive = (np.ascontiguousarray(v[..., own]) for v in (measured, states[:, 5]))
        detect_all(p, state, steps, shown, drive, np.empty((4, 1)))
        expected.append(state.shares[:, 0])
    watched = target_distance.tracking_detector(experiment["force_controller"], axes, (0, 1), dt)
    target_distance.begin_tracking(watched[1])
    target_distance.track_all(*watched, steps, np.ascontiguousarray(points[:, 0]), states)
    found = detector_shares(Recording(experiment, series))
    assert list(found) == [one.name for one in (*DETECTORS, TRACKING)]
    shares = list(found.values())
    np.testing.assert_array_equal(shares[:-1], np.max(expected, axis=0))
    assert shares[-1] == watched[1].shares.max() > 0.0
    assert not np.array_equal(expected[0], expected[1])
    lost = Recording(experiment, series | {"reference_force": Series(steps, points[:, 2:])})
    assert detector_shares(lost) == {name: found[name] for name in list(found)[:-1]}  # no target
    none = {name: Series(steps[:0], values[:0]) for name, values in of_loop.items()}
    assert detector_shares(Recording(experiment, none)) is None
