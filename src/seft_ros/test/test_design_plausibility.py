"""Plans that can't be right: a specimen in other units, a mass that was not found."""

import numpy as np
import pytest
from experiments_at_hand import load
from seft_ros.design.capacity import range_refusal
from seft_ros.design.plausibility import mass_refusal, peaks_by_axis, unit_refusal
from seft_ros.design.preflight_tables import expected_peaks, planned_motion, proposed_limits

CONFIGS = (
    *("demo", "jhu", "three_storey_frame", "six_storey_frame", "two_pier_bridge", "water_tower"),
)
AS_RECORDED = "ground_motion:peak_force:=0.0"


def specimen(**values):
    """Overrides of a specimen, and of its model."""
    nodes = "rig:specimen", "reference_force:model"
    return [f"{node}.{name}:={value}" for node in nodes for name, value in values.items()]


def refused(experiment):
    """Refusals for units, and for ranges."""
    motion = planned_motion(experiment)
    peaks = peaks_by_axis(experiment, motion)
    return unit_refusal(experiment, motion, peaks), range_refusal(experiment, peaks)


@pytest.mark.parametrize("config", CONFIGS)
def test_the_configurations_pass(config):
    assert refused(load(config=config)) == ("", "")


@pytest.mark.parametrize("config", ["demo", "jhu"])
@pytest.mark.parametrize("more", [(), (AS_RECORDED,)])
@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"stiffness": 177.653}, "a stiffness of 177653 N/m (kN/m?) would give 9.24 Hz"),
        ({"stiffness": 177653.0, "mass": 0.5}, "a mass of 500 kg (t?) would give 3 Hz"),
        ({"stiffness": 177.653, "mass": 500.0}, "a stiffness of 177653 N/m (kN/m?) would give 3 "),
    ],
)
def test_kilonewtons_and_tonnes_are_told(config, more, values, told):
    assert told in refused(load(*specimen(**values), *more, config=config))[0]


def test_both_in_other_units_are_told():
    values = specimen(stiffness=177.653, mass=0.5, damping=0.8)
    text = refused(load(*values, config="demo"))[0]
    assert "a stiffness of 177653 N/m (kN/m?) and a mass of 500 kg (t?)" in text


def test_a_damping_in_kilonewtons_goes_with_the_stiffness():
    text = refused(load(*specimen(stiffness=177.653, damping=0.8)))[0]
    assert "peak displacement of 0.42 m (limit: 0.076)" in text
    assert "177653 N/m (kN/m?) would give 9.24 Hz" in text


def test_a_model_in_other_units_than_its_rig_is_told():
    assert refused(load("reference_force:model.mass:=0.5"))[0].startswith("reference_force: model:")


def test_plausible_specimens_pass():
    rng, heard = np.random.default_rng(3), []
    for seed in range(60):
        hz, mass = np.exp(rng.uniform(np.log([0.3, 5.0]), np.log([40.0, 2e4])))
        ratio, omega = rng.uniform(0.003, 0.15), 2 * np.pi * hz
        test = load(
            *specimen(mass=mass, stiffness=mass * omega**2, damping=2 * ratio * mass * omega),
            f"ground_motion:peak_force:={rng.choice([0.0, rng.uniform(0.5, 10.0) * mass])}",
            f"reference_force:mass_ratio:={rng.choice([0.0, 1.5, 5.0])}",
            f"ground_motion:synthetic.seed:={seed}",
            f"rate:={rng.choice([250.0, 500.0, 1000.0])}",
        )
        motion = planned_motion(test)
        peaks = peaks_by_axis(test, motion)
        wider = 10.0 ** rng.uniform()
        limits = proposed_limits(expected_peaks(peaks)).items()
        test = test.changed({"supervisor": {f"limits.{n}": wider * top for n, top in limits}})
        heard.append(unit_refusal(test, motion, peaks))
    assert heard == [""] * 60


@pytest.mark.parametrize(
    ("mass", "found", "error", "refuses"),
    [
        (52.7, [52.0], [0.02], False),  # 1.3 %
        (52.7, [51.0], [0.02], True),  # 3.3 %
        (52.7, [51.0], [0.6], False),  # three standard errors
        (52.7, [0.0], [0.0], False),  # not identified
        ([52.7, 60.0], [52.7, 0.0, 0.0, 62.0], [0.02, 0.02], True),
    ],
)
def test_a_mass_that_is_not_the_identified_one_is_told(mass, found, error, refuses):
    axes = ["x", "y"][: len(error)]
    identified = {"identified.mass": found, "identified.mass_error": error}
    test = load(("/**", "axes", axes), ("reference_force", "model.mass", mass))
    told = mass_refusal(test.changed({"reference_force": identified}))
    assert bool(told) == refuses
    if refuses:
        assert f"on axis {axes[-1]}, but seft identify has found {found[-1]:g} +- 0.02 kg" in told
