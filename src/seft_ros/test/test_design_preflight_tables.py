"""Limits that fit a test: expected peaks, what is proposed, and what is far beyond."""

from functools import partial

import experiments_at_hand
import pytest
from experiments_at_hand import simulated
from seft_msgs_py.config.experiment import read_parameter_file
from seft_msgs_py.errors import InputError
from seft_ros.design.plausibility import peaks_by_axis
from seft_ros.design.preflight_tables import (
    expected_peaks,
    far_limits,
    planned_motion,
    proposed_limits,
    write_limits,
)
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test

load = partial(experiments_at_hand.load, config="demo")


def peaks_of(experiment):
    return expected_peaks(peaks_by_axis(experiment, planned_motion(experiment)))


def test_a_test_stays_within_limits_that_fit_it(tmp_path):
    limits = proposed_limits(peaks_of(load()))
    write_limits(tmp_path / "limits.yaml", limits)
    written = read_parameter_file(tmp_path / "limits.yaml")["/**"]
    assert written == {f"limits.{name}": limit for name, limit in limits.items()}
    experiment = load(files=[tmp_path / "limits.yaml"])
    blocks = build_blocks(experiment)
    assert simulate_test(experiment, blocks).trip is None
    largest = blocks.rig.guard.limits.largest
    assert all(0.2 < largest[i] / limits[n] < 1 for i, n in enumerate(limits))
    halved = {name: limit / 2 for name, limit in limits.items()}
    write_limits(tmp_path / "limits.yaml", halved)
    experiment = load(files=[tmp_path / "limits.yaml"])
    assert "beyond the limit" in simulated(experiment).trip.reason


def test_peaks_grow_with_the_motion():
    once, twice = (
        peaks_of(load(f"ground_motion:peak_force:={newtons}")) for newtons in (200.0, 400.0)
    )
    assert twice == pytest.approx({name: 2.0 * peak for name, peak in once.items()}, rel=1e-6)


def test_limits_far_beyond_are_reported():
    experiment = load("limits.force:=22200.0")
    peaks = peaks_of(experiment)
    assert peaks["force"] == pytest.approx(1533.0, rel=0.01)
    message = far_limits(experiment, peaks)
    assert "force 22200 N (expected: 1.53e+03)" in message
    assert "displacement" not in message
    assert far_limits(load(), peaks) == ""


def test_a_motion_that_runs_elsewhere_has_no_peaks(tmp_path):
    elsewhere = load(nodes=["reference_force", "force_controller", "rig", "supervisor"])
    assert peaks_of(elsewhere) == {}
    with pytest.raises(InputError, match="no limits to write"):
        write_limits(tmp_path / "limits.yaml", {})
