"""What a test needs of sensors, limits and actuators: messages where they do not allow it."""

from functools import partial

import experiments_at_hand
import numpy as np
import pytest
from experiments_at_hand import simulated
from seft_msgs_py.config.experiment import read_parameter_file
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_plant_sim.whole_structure import ReferenceResponse
from seft_ros.design.plausibility import (
    Actuators,
    excess_text,
    excesses,
    expected_response,
    highest_limits,
    peaks_by_axis,
    range_refusal,
    unit_refusal,
)
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
AS_RECORDED = "ground_motion:peak_force:=0.0"
CONFIGS = (
    *("demo", "jhu", "three_storey_frame", "six_storey_frame", "two_pier_bridge", "water_tower"),
)
STROKE = "rig:simulated.actuator.stroke:={}"
CAPACITY = "rig:simulated.actuator.force_capacity:={}"


def peaks_of(experiment):
    return peaks_by_axis(experiment, planned_motion(experiment))


def obstacles(*overrides, config="demo", nodes=None):
    """Say what of a test is beyond what is allowed."""
    experiment = load(*overrides, config=config, nodes=nodes)
    found = excesses(experiment, expected_response(experiment, planned_motion(experiment)))
    return [excess_text([excess]) for excess in found]


@pytest.mark.parametrize("config", CONFIGS)
def test_the_configurations_are_plausible_and_within_what_their_rigs_can_do(config):
    experiment = load(config=config)
    motion, peaks = planned_motion(experiment), peaks_of(experiment)
    assert unit_refusal(experiment, motion, peaks) == range_refusal(experiment, peaks) == ""
    assert excesses(experiment, expected_response(experiment, motion)) == []


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ("limits.displacement:=0.005", "0.0105 m, 210 % of /**: limits.displacement"),
        (STROKE.format(0.005), "0.0105 m, 210 % of the actuator's stroke (0.005 m)"),
        ("limits.force:=1000.0", "1533 N, 153.3 % of /**: limits.force (1000 N)"),
        (CAPACITY.format(1500.0), "102.2 % of the actuator's force capacity (1500 N"),
        ("rig:simulated.actuator.flow_gain:=0.03", "% of that of the fully open valve (0.3 m/s)"),
        ("limits.command:=8.0", "% of that of the fully open valve (0.3224 m/s)"),
    ],
)
def test_what_a_peak_is_beyond_is_reported(override, text):
    first, *others = obstacles(override)
    assert text in first and "lower ground_motion: peak_force" in first
    assert ("raise the limit" in first) == ("limits." in first)
    assert all("flow of the valve" in other for other in others)  # little pressure is left


def test_actuators_that_obey_forces_have_no_valve_and_no_stroke():
    kind = "actuator.kind:={}"
    beyond = "rig:simulated.actuator.flow_gain:=0.001", STROKE.format(0.001)
    assert len(obstacles(*beyond, config="jhu")) == 2
    assert obstacles(*beyond, kind.format("delay"), config="jhu") == []
    (flow,) = obstacles(*beyond, kind.format("servo_hydraulic_linear"), config="jhu")
    assert "flow of the valve" in flow


def test_a_rig_elsewhere_is_what_is_known_of_it():
    here = ["ground_motion", "reference_force", "force_controller", "supervisor"]
    assert obstacles(nodes=here) == []
    force, flow = obstacles("actuator.force_capacity:=1500.0", nodes=here)
    assert "force capacity (1500 N)" in force and "fully open valve (0.403 m/s)" in flow
    unknown = (f"actuator.{n}:=0.0" for n in ("force_capacity", "flow_gain"))
    assert obstacles(*unknown, nodes=here) == []


def test_the_flow_counts_oil_leakage_and_load():
    """A force in phase with the velocity, then half a period later against it (Merritt 1967)."""
    one = np.ones(1)
    valve = Actuators(one, 1e4 * one, one, one, 1e6 * one, 50.0 * one)
    dt, w = 1e-4, 2 * np.pi * 5.0
    time = dt * np.arange(4001)[:, np.newaxis]
    sine, cosine, none = np.sin(w * time), np.cos(w * time), np.zeros_like(time)

    def needed(velocity, force):
        return valve.flow(ReferenceResponse(none, velocity, none, force), dt)[0]

    assert needed(0.2 * sine, none) == pytest.approx(0.2, rel=1e-6)
    assert needed(none, 100.0 * cosine) == pytest.approx(1e-4 * np.hypot(w, 50.0), rel=0.02)
    flow = 0.2 * sine + 7500.0 / 1e6 * (w * cosine + 50.0 * sine)
    loaded = np.abs(flow) / np.sqrt(1.0 - np.sign(flow) * 0.75 * sine)
    assert needed(0.2 * sine, 7500.0 * sine) == pytest.approx(loaded.max(), rel=1e-4)
    assert loaded.max() > 1.5 * np.abs(flow).max()


def test_no_proposed_limit_is_beyond_stroke_or_force_capacity():
    for overrides in ((), (STROKE.format(0.014),), (CAPACITY.format(1700.0),)):
        test = load(*overrides)
        actuator = group(test["rig"], "simulated.actuator")
        peaks = peaks_by_axis(test, planned_motion(test))
        highest = highest_limits(test, peaks)
        limits = proposed_limits(expected_peaks(peaks), highest)
        stop = 0.5 * 0.02 * peaks["velocity"][0]
        assert highest["displacement"] == pytest.approx(actuator["stroke"] - stop)
        assert highest["force"] == actuator["force_capacity"]
        assert limits["displacement"] == (0.01 if "stroke" in str(overrides) else 0.016)
        assert limits["force"] == (1700.0 if "capacity" in str(overrides) else 2300.0)


def test_a_piston_that_trips_at_its_proposed_limit_stops_before_the_end_of_its_stroke():
    """The limit of a stroke of 8 mm, which the demo exceeds at almost its largest velocity."""
    test = load(STROKE.format(0.008))
    highest = highest_limits(test, peaks_by_axis(test, planned_motion(test)))
    limit = proposed_limits({"displacement": 0.0105}, highest)["displacement"]
    recording = simulated(load(f"limits.displacement:={limit}"))
    assert "displacement" in recording.trip.reason
    assert limit < recording.simulated.displacement_peak < 0.008


def test_a_limit_that_no_higher_one_can_replace_is_not_to_be_raised():
    """Between the highest limit and the stroke."""
    below = "limits.displacement:=0.01"
    assert "raise the limit" in obstacles(below)[0]
    (text,) = obstacles(below, STROKE.format(0.011))
    assert text.endswith("; lower ground_motion: peak_force")


def test_several_are_reported_in_one_line_with_one_remedy():
    test = load("limits.displacement:=0.005", "limits.force:=1000.0")
    found = excesses(test, expected_response(test, planned_motion(test)))
    text = excess_text(found)
    assert (text.count("expected"), text.count("lower"), text.count("raise")) == (2, 1, 1)
    assert excess_text([]) == ""


def test_the_axis_that_uses_most_of_a_range_counts():
    """An axis that the ground does not drive is none that uses too little."""
    idle = load("axes:=[x,y]", AS_RECORDED, config="jhu")
    ranges = {name: idle["rig"][f"sensors.{name}_range"] for name in CHANNELS}
    peaks = {name: np.array([0.1, 0.0]) * top for name, top in ranges.items()}
    assert range_refusal(idle, peaks) == ""
    peaks["force"][1] = 21000.0
    assert "force 2.1e+04 of 22200 N (94.6 %)" in range_refusal(idle, peaks)


def test_a_range_that_is_not_known_is_not_checked():
    unknown = load("sensors.force_range:=0.0")
    assert range_refusal(unknown, {**peaks_of(unknown), "force": np.array([1.0])}) == ""


# ---- Limits that fit a test: expected peaks, what is proposed, and what is far beyond


def largest_of(experiment):
    return expected_peaks(peaks_of(experiment))


def test_a_test_stays_within_limits_that_fit_it(tmp_path):
    limits = proposed_limits(largest_of(load()))
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
    once, twice = (largest_of(load(f"ground_motion:peak_force:={n}")) for n in (200.0, 400.0))
    assert twice == pytest.approx({name: 2.0 * peak for name, peak in once.items()}, rel=1e-6)


def test_limits_far_beyond_are_reported():
    experiment = load("limits.force:=22200.0")
    peaks = largest_of(experiment)
    assert peaks["force"] == pytest.approx(1533.0, rel=0.01)
    message = far_limits(experiment, peaks)
    assert "force 22200 N (expected: 1.53e+03)" in message
    assert "displacement" not in message
    assert far_limits(load(), peaks) == ""


def test_a_motion_that_runs_elsewhere_has_no_peaks(tmp_path):
    elsewhere = load(nodes=["reference_force", "force_controller", "rig", "supervisor"])
    assert largest_of(elsewhere) == {}
    with pytest.raises(InputError, match="no limits to write"):
        write_limits(tmp_path / "limits.yaml", {})
