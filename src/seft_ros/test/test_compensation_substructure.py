"""Every method with a computed substructure that is more than lumped mass."""

import numpy as np
import pytest
from compensators import force_section
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.whole_structure import reference_response
from seft_ros.reference_force import compensation_methods as methods
from seft_ros.reference_force.reference_force_block import compensator, method_inputs
from seft_ros.reference_force.reference_force_parameters import OWN_METHODS, TARGET_MOTION
from structures_at_hand import as_lists, structure

RATE = 4000.0


def section_of(seed, axes, internal, rate=RATE, **values):
    """A specimen and a computed substructure, coupled in everything."""
    drawn = as_lists(structure(np.random.default_rng(seed), axes, internal))
    names = [f"axis {index}" for index in range(axes)]
    return force_section(**drawn, rate=rate, axes=names, **values)


def known_of(section):
    return method_inputs(section, tuple(section["axes"]), Timebase.from_rate(section["rate"]))


def exact_test(section, seed, steps=800):
    """Ground motion, and the state of a perfect test."""
    rng, axes = np.random.default_rng(seed), len(section["axes"])
    slow = np.cumsum(rng.normal(size=(steps + 400, axes)), axis=0) / 20.0
    ground = slow * np.hanning(len(slow))[:, np.newaxis]
    found = reference_response(Experiment({"reference_force": section}), ground)
    return ground, found.states[:steps]


@settings(max_examples=10)
@given(seed=st.integers(0, 2**31), axes=st.integers(1, 3), internal=st.integers(0, 3))
@pytest.mark.parametrize("method", ["none", "restoring"])
def test_in_a_perfect_test_the_reference_force_is_the_exact_one(method, seed, axes, internal):
    section = section_of(seed, axes, internal)
    one = compensator(method, known_of(section))
    ground, states = exact_test(section, seed)
    window = 1 + one.preview
    forces = np.array([one.step(ground[k : k + window], y) for k, y in enumerate(states)])
    error = np.abs(forces - states[:, 3]).max()
    assert error < 2e-4 * np.abs(states[:, 3]).max()


@settings(max_examples=10)
@given(seed=st.integers(0, 2**31), axes=st.integers(1, 3), internal=st.integers(0, 3))
def test_what_stands_for_the_ground_motion_is_known_ahead(seed, axes, internal):
    section, preview = section_of(seed, axes, internal), 60
    known = known_of(section)
    motion = methods.substructure_motion(known, preview)
    ground, states = exact_test(section, seed)
    matrix, work = motion.matrix(), np.zeros(motion.matrix().shape[1])
    outputs, inside = (1 + preview) * axes, len(motion.a)
    found = []
    for k, state in enumerate(states):
        work[inside:] = np.concatenate([state.ravel(), ground[k : k + 1 + preview].ravel()])
        result = matrix @ work
        work[:inside] = result[outputs:]
        found.append(result[:outputs].reshape(1 + preview, axes))
    now = np.array([each[0] for each in found])
    scale = np.abs(now).max()
    for ahead in (1, 20, preview):
        expected, foreseen = now[ahead:], np.array([each[ahead] for each in found[:-ahead]])
        assert np.abs(foreseen - expected).max() < 1e-3 * scale


@pytest.mark.parametrize("method", [name for name in OWN_METHODS if name != TARGET_MOTION])
@pytest.mark.parametrize("internal", [0, 2])
def test_a_method_is_the_linear_filter_that_it_says_it_is(method, internal):
    section = section_of(3, 2, internal, 500.0, actuator__delay=0.0103)
    known = known_of(section)
    one = compensator(method, known)
    motion = methods.substructure_motion(known, one.preview)
    again = methods._BehindMotion(methods.COMPENSATION_METHODS[method](known), motion)
    matrix, size = one.linear().matrix(), len(one.linear().a)
    rng, work = np.random.default_rng(1), np.zeros(one.linear().matrix().shape[1])
    for _ in range(20):
        ground, state = rng.normal(size=(1 + one.preview, 2)), rng.normal(size=(4, 2))
        work[size:] = np.concatenate([state.ravel(), ground.ravel()])
        result = matrix @ work
        work[:size] = result[2:]
        for each in (one, again):
            np.testing.assert_allclose(each.step(ground, state), result[:2], rtol=1e-7, atol=1e-9)
    again.reset()
    work[:] = 0.0
    np.testing.assert_allclose(again.linear().matrix(), matrix, rtol=1e-9, atol=1e-12)


def test_masses_on_the_axes_alone_have_the_bits_of_a_mass_ratio():
    plain = {"specimen.stiffness": 2e5, "mass_ratio": 1.0}
    forces = []
    for more in ({}, {"computed.mass": 52.7}, {"computed.mass": 52.7, "computed.damping": 0.0}):
        one = compensator("restoring", known_of(force_section(**plain, **more)))
        rng = np.random.default_rng(1)
        steps = [one.step(rng.normal(size=(1, 1)), rng.normal(size=(4, 1))) for _ in range(20)]
        forces.append(np.array(steps))
    assert forces[0].tobytes() == forces[1].tobytes() == forces[2].tobytes()


def test_a_mass_that_is_taken_away_must_leave_one():
    section = force_section(specimen__mass=50.0, mass_ratio=1.0, computed__mass=-60.0)
    with pytest.raises(InputError, match="add up to a mass on the axes that is not positive"):
        known_of(section)
