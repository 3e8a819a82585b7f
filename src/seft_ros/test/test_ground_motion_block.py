"""The ground motion of a test: resampled, scaled, and cut into chunks."""

import os
import subprocess
import sys

import numpy as np
import pytest
from bare_rig import section_of
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase
from seft_ros.ground_motion.ground_motion_block import GROUND_MOTION_TABLE, GroundMotion, chunks_of


def build(axes=("x",), rate=200.0, **values):
    """Ground motion of these parameters; a double underscore stands for a dot."""
    section = section_of(GROUND_MOTION_TABLE, **{"specimen__mass": 1.0, **values})
    return GroundMotion(section, axes, Timebase.from_rate(rate))


@pytest.fixture
def tent(tmp_path):
    """Parameters of a record 0, 2, 0, -4, 0 m/s^2 every 0.01 s, beside one of twice that."""
    path = tmp_path / "tent.txt"
    path.write_text("0 0\n2 4\n0 0\n-4 -8\n0 0\n")
    return {"file": str(path), "column": 0, "unit": "m/s2", "dt": 0.01, "tail": 0.0}


def test_the_tail_is_zeros_after_the_record(tent):
    motion = build(rate=100.0, **{**tent, "tail": 0.03})
    np.testing.assert_array_equal(motion.samples[:, 0], [0, 2, 0, -4, 0, 0, 0, 0])
    assert motion.facts["resampling"] == "each of its samples is a step"
    assert motion.steps == 8


def test_peak_force_scales_the_largest_mass_times_acceleration(tent):
    motion = build(rate=100.0, peak_force=1000.0, specimen__mass=50.0, **tent)
    np.testing.assert_allclose(motion.samples[:, 0], [0, 10, 0, -20, 0])


@pytest.mark.parametrize(
    ("mass", "largest"),
    [
        (10.0, 80.0),  # 10 * 8 on the second axis
        ([100.0, 1.0], 400.0),  # 100 * 4 on the first
        ([10.0, -4.0, -4.0, 10.0], 64.0),  # -4 * 4 + 10 * 8 on the second
        ([2.0, 1.0, 1.0, 1.0], 16.0),  # 2 * 4 + 1 * 8 on the first
    ],
)
def test_the_mass_is_a_number_or_a_list_or_a_matrix(tent, mass, largest):
    values = {**tent, "column": [0, 1], "peak_force": 2 * largest, "specimen__mass": mass}
    motion = build(("x", "y"), 100.0, **values)
    np.testing.assert_allclose(motion.samples, [[0, 0], [4, 8], [0, 0], [-8, -16], [0, 0]])


def test_the_influence_vector_is_a_factor_per_axis(tent):
    motion = build(("x", "y"), 100.0, influence=[0.5, -2.0], **tent)
    np.testing.assert_array_equal(motion.samples[1], [1.0, -4.0])
    np.testing.assert_array_equal(
        build(("x", "y"), 100.0, influence=3.0, **tent).samples[1], [6, 6]
    )


@pytest.fixture
def pair(tmp_path):
    """Records of two axes: 0, 2, 0 g every 0.01 s, and 1, 3, 5, 7 g."""
    for name, values in (("a", "0 2 0"), ("b", "1 3 5 7")):
        text = f"IN UNITS OF G\nNPTS= {len(values.split())}, DT= .01 SEC\n{values}\n"
        (tmp_path / f"{name}.AT2").write_text(text)
    return [str(tmp_path / "a.AT2"), str(tmp_path / "b.AT2")]


def test_each_axis_may_have_a_record_and_zeros_follow_the_shorter_one(pair):
    motion = build(("x", "y"), 100.0, file=pair, tail=0.01)
    expected = [[0, 1], [2, 3], [0, 5], [0, 7], [0, 0]]
    np.testing.assert_allclose(motion.samples, np.array(expected) * 9.80665)
    assert motion.facts["source"] == "a.AT2, b.AT2"
    named = build(("x", "y"), 100.0, file=[f"y={pair[1]}", f"x={pair[0]}"], tail=0.01)
    np.testing.assert_array_equal(named.samples, motion.samples)
    channels = named.facts["channels"]
    assert [(c["axis"], c["file"], c["samples"]) for c in channels] == [
        ("x", "a.AT2", 3),
        ("y", "b.AT2", 4),
    ]


def test_each_axis_takes_its_own_column_of_its_own_record(tmp_path, pair):
    (tmp_path / "c.csv").write_text("time,acc (g),other (g)\n0,1,2\n0.01,3,4\n0.02,5,6\n")
    motion = build(("x", "y"), 100.0, file=[str(tmp_path / "c.csv"), pair[1]], column=[2, 0])
    np.testing.assert_allclose(motion.samples[1] / 9.80665, [4, 3])


def test_records_of_the_axes_must_fit(tmp_path, pair):
    with pytest.raises(InputError, match=r"2 records for 3 axes \[x, y, z\]; give one, or one"):
        build(("x", "y", "z"), file=pair)
    with pytest.raises(InputError, match="a record for each axis must be named"):
        build(("x", "y"), file=[pair[0], ""])
    for axes in (("x", "z"), ("x", "x"), ("x",)):
        files = [f"{axis}={file}" for axis, file in zip(axes, pair, strict=False)]
        with pytest.raises(InputError, match=r"must be AXIS=FILE for each axis of \[x, y\], once"):
            build(("x", "y"), file=files)
    other = tmp_path / "b.AT2"
    other.write_text(other.read_text().replace(".01", ".02"))
    with pytest.raises(InputError, match=r"y: b.AT2 has .* 0.02 s, but x: a.AT2 of 0.01 s"):
        build(("x", "y"), file=pair)


@given(st.integers(1, 300), st.integers(1, 50))
def test_chunks_cover_every_step_once_and_in_order(steps, chunk_steps):
    values = np.arange(2.0 * steps).reshape(steps, 2)
    chunks = chunks_of(values, chunk_steps)
    assert [first for first, _ in chunks] == list(range(0, steps, chunk_steps))
    assert {len(part) for _, part in chunks[:-1]} <= {chunk_steps}
    np.testing.assert_array_equal(np.concatenate([part for _, part in chunks]), values)


@pytest.mark.parametrize(
    ("lead", "rate", "steps"), [(1.0, 500.0, 125), (0.001, 500.0, 1), (3600.0, 500.0, 11001)]
)
def test_a_chunk_is_a_quarter_of_the_lead(lead, rate, steps):
    assert len(build(rate=rate, lead=lead).chunks[0][1]) == steps


def test_a_correction_is_of_the_record_and_reported_before_and_after(tent):
    motion = build(rate=100.0, **tent, correct="offset")
    np.testing.assert_allclose(motion.samples[:, 0], [0.4, 2.4, 0.4, -3.6, 0.4])
    np.testing.assert_allclose(motion.uncorrected[:, 0], [0, 2, 0, -4, 0])
    facts = motion.facts["correction"]
    assert facts["method"] == "offset"
    assert facts["before"]["offset"] == [pytest.approx(-0.4)]
    assert facts["after"]["offset"] == [pytest.approx(0.0, abs=1e-15)]
    motion = build(rate=100.0, **tent, correct="baseline", filter__corner=2.0, filter__order=3)
    assert motion.facts["correction"]["method"] == (
        "baseline, high-pass 2 Hz of order 3, both ways"
    )
    with pytest.raises(InputError, match=r"filter.corner is 50 Hz, but must be below half the rec"):
        build(rate=100.0, **tent, correct="baseline", filter__corner=50.0)
    plain = build(rate=100.0, **tent)
    assert plain.facts["correction"] is None and plain.uncorrected is None


def test_without_a_file_the_motion_is_synthetic_and_the_same_on_every_axis():
    motion = build(("x", "y"), 200.0, synthetic__peak=2.0, synthetic__seed=7)
    assert motion.samples.shape == (4401, 2)  # 20 s, 2 s of tail, and the first sample
    np.testing.assert_array_equal(motion.samples[:, 0], motion.samples[:, 1])
    assert np.abs(motion.samples).max() == pytest.approx(2.0)
    assert not motion.samples[4001:].any()
    assert motion.facts["source"] == "synthetic, seed 7"


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ({"peak_force": 10.0, "specimen__mass": 0.0}, "specimen.mass is 0.0, but mass must be"),
        ({"peak_force": 10.0, "influence": 0.0}, "motion of zeros can't be scaled"),
        ({"column": [0, 1, 0]}, "column: 3 values for 2 axes"),
        ({"tail": 1e9}, "5e+07 steps"),
        (
            {"rate": 1e6, "lead": 3600.0},
            "3600 s at 1e+06 Hz are more than 5e+07 steps (lead 3600 s)",
        ),
        ({"time_scale": 1e-20}, "less than a step"),
        ({"file": "", "synthetic.duration": 1e20}, "5e+07 steps"),
        ({"file": "", "synthetic.rise": 9.0}, "synthetic.plateau_end is 8 s"),
        ({"file": "", "unit": "mm/s2"}, "must be g, m/s2, cm/s2 or gal; convert the record"),
    ],
)
def test_what_can_not_be_used_is_refused_in_one_line(tent, values, what):
    with pytest.raises(InputError) as caught:
        build(("x", "y"), **{**tent, **values})
    assert what in str(caught.value)


def test_the_node_loads_neither_scipy_nor_matplotlib():
    code = (
        "import sys, seft_ros.ground_motion.ground_motion_block;"
        "sys.exit(bool({'scipy', 'matplotlib'} & set(sys.modules)))"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    assert subprocess.run([sys.executable, "-c", code], env=environment).returncode == 0
