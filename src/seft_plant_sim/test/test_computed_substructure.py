"""What is computed beside the specimen: parameters, and the response of the whole of it."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.signal import lsim
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.computed.computed_substructure import ComputedSubstructure
from seft_plant_sim.whole_structure import RunningResponse, reference_response
from structures_at_hand import NOTHING_COMPUTED, as_lists, structure

NOTHING = NOTHING_COMPUTED | {"mass_ratio": 1.0, "specimen.mass": 50.0}


def computed_of(axes=("x",), **given_values):
    given_values = {name.replace("__", "."): value for name, value in given_values.items()}
    return ComputedSubstructure.from_parameters(NOTHING | given_values, axes)


def experiment_of(values, axes, rate=500.0):
    section = NOTHING_COMPUTED | {"method": "seft", "rate": rate}
    section |= {"axes": [f"axis {i}" for i in range(axes)], **as_lists(values)}
    return Experiment({"reference_force": section})


def test_the_mass_ratio_is_a_factor_on_all_of_it():
    found = computed_of(
        mass_ratio=0.5,
        computed__internal=1,
        computed__mass=[0.0, 8.0],
        computed__damping=[70.0, -70.0, -70.0, 70.0],
        computed__stiffness=[2e4, -2e4, -2e4, 2e4],
    )
    assert (found.axes, found.internal, found.is_lumped) == (1, 1, False)
    assert found.mass.tolist() == [[0.0, 0.0], [0.0, 4.0]]
    assert found.stiffness.tolist() == [[1e4, -1e4], [-1e4, 1e4]]
    assert found.influence.tolist() == [[1.0]]  # the ground motion of the first axis


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"computed__internal": 1}, "computed.internal is 1, but .*computed.mass is not given"),
        ({"computed__internal": 1, "computed__mass": [1.0, 0.0]}, "must be positive"),
        ({"computed__internal": 1, "computed__mass": [1.0, 1.0, 1.0]}, r"3 values.*internal 1"),
        ({"computed__mass": 1.0, "computed__stiffness": [1.0, 2.0]}, "stiffness: 2 values"),
        (
            {"computed__internal": 2, "computed__mass": 1.0, "computed__influence": [1.0]},
            "influence: 1 values for 2 internal degrees of freedom and 1 axes; give 2",
        ),
    ],
)
def test_what_makes_no_structure_is_refused(values, words):
    with pytest.raises(InputError, match=words):
        computed_of(**values)


@settings(max_examples=6)
@given(seed=st.integers(0, 2**31), axes=st.integers(1, 4), internal=st.integers(0, 4))
@example(seed=0, axes=3, internal=0)
@example(seed=2**31, axes=2, internal=0)
def test_the_response_is_that_of_the_assembled_structure(seed, axes, internal):
    rng = np.random.default_rng(seed)
    values, size = structure(rng, axes, internal), axes + internal
    test, steps = experiment_of(values, axes), 80
    ground = rng.normal(size=(steps, axes)) * np.exp(-np.arange(steps) / 30.0)[:, np.newaxis]
    found = reference_response(test, ground)

    mass, damping, stiffness = (values[f"computed.{n}"] for n in ("mass", "damping", "stiffness"))
    mass, damping, stiffness = (
        part + np.pad(values[f"specimen.{n}"], [(0, internal)] * 2)
        for n, part in (("mass", mass), ("damping", damping), ("stiffness", stiffness))
    )
    inside = values["computed.influence"] if internal else np.zeros((0, axes))
    influence = np.vstack([np.eye(axes), inside])
    free = np.zeros((size, size))
    back = (-np.linalg.solve(mass, part) for part in (stiffness, damping))
    states = np.block([[free, np.eye(size)], [*back]])
    moved = np.vstack([np.zeros((size, axes)), -influence])
    outputs = np.eye(axes, 2 * size)
    system = states, moved, outputs, np.zeros((axes, axes))
    _, solved, _ = lsim(system, ground, 0.002 * np.arange(steps))  # exact where lines join samples
    scale, solved = np.abs(solved).max(), solved.reshape(steps, axes)
    np.testing.assert_allclose(found.displacement, solved, rtol=0, atol=1e-9 * scale)

    m, c, k = (values[f"specimen.{name}"] for name in ("mass", "damping", "stiffness"))
    # what moves the specimen so
    expected = m @ found.acceleration.T + c @ found.velocity.T + k @ found.displacement.T
    np.testing.assert_allclose(found.force, expected.T, rtol=0, atol=1e-9 * np.abs(expected).max())
    running = RunningResponse(test)
    pieces = [running.advance(piece) for piece in np.array_split(ground, 3)]
    displacement, acceleration = (np.vstack(part) for part in zip(*pieces, strict=True))
    for piece, exact in ((displacement, found.displacement), (acceleration, found.acceleration)):
        np.testing.assert_allclose(piece, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


@settings(max_examples=30)
@given(seed=st.integers(0, 2**31), axes=st.integers(1, 4), internal=st.integers(1, 4))
def test_without_inertial_coupling_it_is_the_same_structure(seed, axes, internal):
    values = structure(np.random.default_rng(seed), axes, internal)
    whole = ComputedSubstructure(
        *(values[f"computed.{name}"] for name in ("mass", "damping", "stiffness", "influence"))
    )
    found = whole.without_inertial_coupling()
    assert not found.mass[axes:, :axes].any()
    for s in (0.0, 3j, 40j, -2 + 90j):  # force on the axes, by their motion and the ground's

        def force(part, s=s):
            dynamic = s * s * part.mass + s * part.damping + part.stiffness
            pushed = part.mass @ np.vstack([np.eye(axes), part.influence])
            inner = np.linalg.inv(dynamic[axes:, axes:])
            carried = dynamic[:axes, axes:] @ inner
            by_motion = dynamic[:axes, :axes] - carried @ dynamic[axes:, :axes]
            return np.hstack([by_motion, pushed[:axes] - carried @ pushed[axes:]])

        np.testing.assert_allclose(force(found), force(whole), rtol=1e-8)
