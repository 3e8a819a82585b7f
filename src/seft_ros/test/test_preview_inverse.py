"""preview_inverse as a whole: what it remembers, what it forgets, and tests with it."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.parameter_file import parse_override
from seft_msgs_py.topics import RIG_STATE
from seft_ros.analysis.summary import summarise
from seft_ros.experiment.blocks import build_blocks
from seft_ros.experiment.offline import simulate
from seft_ros.experiment.tables import TABLES
from seft_ros.reference_force.block import knowledge
from seft_ros.reference_force.compensation.linear_filter import LinearCompensator
from seft_ros.reference_force.compensation.methods import METHODS

JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"
K = 2.11e5
SHORT = (
    "ground_motion:synthetic.duration:=12.0",
    "ground_motion:tail:=0.5",
    "ground_motion:peak_force:=300.0",
    "reference_force:mass_ratio:=1.0",
    "reference_force:compensation.method:=preview_inverse",
)
FIXED = "reference_force:compensation.adaptive:=false"
LINEAR = (
    "rig:actuator.kind:=servo_hydraulic_linear",
    *(f"rig:sensors.{name}_noise:=0.0" for name in ("position", "velocity", "acceleration")),
    "rig:sensors.force_noise:=0.0",
)
BOUC_WEN = ("rig:specimen.kind:=bouc_wen", "rig:specimen.yield_displacement:=0.0015")
COUPLED = (
    "axes:=[x, y]",
    "rig:specimen.stiffness:=[2.0e5, -3.0e4, -3.0e4, 2.2e5]",
    "rig:specimen.mass:=[52.7, 55.0]",
    "reference_force:model.stiffness:=[2.0e5, -3.0e4, -3.0e4, 2.2e5]",
    "reference_force:model.mass:=[52.7, 55.0]",
    "ground_motion:influence:=[1.0, 0.5]",
)
THREE = (
    "axes:=[x, y, z]",
    "rig:specimen.stiffness:=[2.0e5, -2.0e4, 0.0, -2.0e4, 2.2e5, -2.0e4, 0.0, -2.0e4, 2.1e5]",
    "rig:specimen.mass:=[52.7, 55.0, 50.0]",
    "reference_force:model.stiffness:="
    "[2.0e5, -2.0e4, 0.0, -2.0e4, 2.2e5, -2.0e4, 0.0, -2.0e4, 2.1e5]",
    "reference_force:model.mass:=[52.7, 55.0, 50.0]",
    "ground_motion:influence:=[1.0, 0.5, 0.3]",
)


def load(*words):
    return Experiment.load(TABLES, [JHU], [parse_override(word) for word in (*SHORT, *words)])


def compensator(*words):
    experiment = load(*words)
    known = knowledge(experiment["reference_force"], experiment.axes, experiment.timebase)
    return METHODS["preview_inverse"](known)


def run(*words):
    """Record and summary of a test."""
    experiment = load(*words)
    record = simulate(experiment, build_blocks(experiment))
    return record, summarise(record)


def error(*words):
    summary = run(*words)[1]
    return summary["displacement"]["nrmse"] if summary["stable"] else np.inf


def seen(*words):
    """Ground motion windows, measured states and forces of a test."""
    experiment = load(*words)
    blocks = build_blocks(experiment)
    record, window = simulate(experiment, blocks), 1 + blocks.reference_force.preview
    states = record.series[RIG_STATE.name].values
    known = blocks.ground_motion.known
    return [known[k : k + window] for k in range(len(states))], states


def forces(one, windows, states):
    return np.array([one.step(g, y) for g, y in zip(windows, states, strict=True)])


@pytest.mark.parametrize("words", [(), BOUC_WEN, COUPLED])
def test_a_reset_makes_the_next_test_the_same_bit_by_bit(words):
    windows, states = seen(*words)
    one, fresh = compensator(*words), compensator(*words)
    start = one.estimates()
    first, found = forces(one, windows, states), one.estimates()
    one.reset()
    for name, value in one.estimates().items():
        np.testing.assert_array_equal(value, start[name])
    assert not np.array_equal(found["stiffness"], start["stiffness"])
    np.testing.assert_array_equal(one.linear().matrix(), fresh.linear().matrix())
    np.testing.assert_array_equal(forces(one, windows, states), first)
    np.testing.assert_array_equal(forces(fresh, windows, states), first)


@pytest.mark.parametrize("words", [(), COUPLED])
def test_as_long_as_nothing_is_learnt_it_is_the_linear_filter_that_it_says(words):
    one = compensator(*words)
    rng, n = np.random.default_rng(1), len(one.estimates()["delay"])
    scale = np.array([[1e-6], [1e-4], [0.02], [1.0]])  # below the sensors' noise
    states = rng.normal(size=(300, 4, n)) * scale
    motion = rng.normal(0, 1e-3, (300 + one.preview, n))
    windows = [motion[k : k + 1 + one.preview] for k in range(300)]
    expected = forces(LinearCompensator(one.linear()), windows, states)
    found = forces(one, windows, states)
    learnt = one.estimates()
    np.testing.assert_allclose(learnt["stiffness"], compensator(*words).estimates()["stiffness"])
    np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_what_it_has_learnt_is_in_its_linear_filter():
    windows, states = seen("reference_force:model.stiffness:=1.7e5")
    one = compensator("reference_force:model.stiffness:=1.7e5")
    forces(one, windows, states)
    learnt = one.estimates()
    assert learnt["stiffness"][0] == pytest.approx(K, rel=0.01)
    same = compensator(
        f"reference_force:model.stiffness:={float(learnt['stiffness'][0])}",
        f"reference_force:model.damping:={float(learnt['damping'][0])}",
    )
    gain, advance = learnt["amplitude"] - 1, same.estimates()["delay"] - learnt["delay"]
    exact = same._filter.linear(1 - gain, advance).matrix()
    np.testing.assert_allclose(one.linear().matrix(), exact, atol=2e-3 * np.abs(exact).max())


@given(st.integers(0, 3), st.sampled_from([np.nan, np.inf, -np.inf, 1e300]))
@settings(max_examples=12, deadline=None)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_what_is_not_finite_neither_hangs_nor_outlives_a_reset(row, value):
    one, fresh = compensator(), compensator()
    rng = np.random.default_rng(row)
    scale = np.array([[1e-3], [0.1], [5.0], [300.0]])
    states = rng.normal(size=(100, 4, 1)) * scale
    broken = states.copy()
    broken[50, row] = value
    windows = [rng.normal(0, 3, (1 + one.preview, 1)) for _ in range(100)]
    forces(one, windows, broken)
    one.reset()
    np.testing.assert_array_equal(forces(one, windows, states), forces(fresh, windows, states))


@given(st.integers(0, 2**32), st.floats(0.0, 5.0))
@settings(max_examples=15, deadline=None)
def test_estimates_are_finite_and_bounded_whatever_is_measured(seed, scale):
    one, rng = compensator(), np.random.default_rng(seed)
    states = rng.normal(size=(150, 4, 1)) * np.array([[1e-3], [0.1], [5.0], [300.0]]) * scale
    windows = [rng.normal(0, 3 * scale, (1 + one.preview, 1)) for _ in range(150)]
    assert np.isfinite(forces(one, windows, states)).all()
    found = one.estimates()
    assert -0.21 * K < found["stiffness"][0] < 4.21 * K  # 0.05 beyond what is identified
    assert found["damping"][0] >= 0
    assert 0.9 <= found["amplitude"][0] <= 1.1
    assert 0.005 < found["delay"][0] < 0.02


@pytest.mark.parametrize("factor", [0.2, 0.5, 3.0])
def test_the_force_loop_may_have_been_identified_with_another_specimen(factor):
    """f = T (f_r + d) - d."""
    own = (
        f"rig:specimen.stiffness:={factor * K}",
        f"reference_force:model.stiffness:={factor * K}",
    )
    assert error(*LINEAR, *own) < 0.03
    assert error(*LINEAR, *own, "reference_force:tracking.stiffness:=0.0") > 0.2


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_so_it_may_for_the_fixed_method(factor):
    own = (
        f"rig:specimen.stiffness:={factor * K}",
        f"reference_force:model.stiffness:={factor * K}",
    )
    assert error(*LINEAR, FIXED, *own) < 0.06
    assert error(*LINEAR, FIXED, *own, "reference_force:tracking.stiffness:=0.0") > 0.2


@pytest.mark.parametrize(
    "words",
    [
        ("reference_force:model.stiffness:=1.7e5", "reference_force:model.damping:=400.0"),
        ("reference_force:model.stiffness:=1.2e5",),
        COUPLED,
        THREE,
    ],
)
def test_a_linear_specimen_is_not_taken_to_yield(words):
    """However the axes are coupled: the ground shakes them alike, their motions are similar."""
    experiment = load(*words, "reference_force:mass_ratio:=3.0", "ground_motion:peak_force:=150.0")
    blocks = build_blocks(experiment)
    summary = summarise(simulate(experiment, blocks))
    assert blocks.reference_force.reference_force.compensator._plastic is None
    assert summary["displacement"]["nrmse"] < 0.04


def test_yielding_is_seen_and_followed():
    """Tangent stiffness on its way, and less error than if the specimen were taken as linear."""
    record, summary = run(*BOUC_WEN)
    stiffness = summary["estimates"]["stiffness"]["x"]
    assert stiffness["least"] < 0.5 * K and stiffness["largest"] < 1.2 * K
    assert summary["displacement"]["nrmse"] < 0.5 * error(*BOUC_WEN, FIXED)
    assert np.isfinite(record.estimates.values).all()


def test_coupled_axes_are_one_test():
    summary = run(*COUPLED)[1]
    assert summary["stable"]
    assert summary["displacement"]["nrmse"] < 0.03


@pytest.mark.parametrize("method", ["eft", "seft"])
def test_without_computed_mass_the_known_ground_motion_is_met(method):
    words = ("reference_force:mass_ratio:=0.0", f"reference_force:method:={method}")
    assert error(*words) < 0.02
