"""Plans that can't be right: a specimen in other units."""

import numpy as np
import pytest
from experiments_at_hand import load
from seft_ros.design.plausibility import peaks_by_axis, range_refusal, unit_refusal
from seft_ros.design.preflight_tables import expected_peaks, planned_motion, proposed_limits

AS_RECORDED = "ground_motion:peak_force:=0.0"


def specimen(**values):
    """Overrides of a specimen."""
    return [f"specimen.{name}:={value}" for name, value in values.items()]


def refused(experiment):
    """Refusals for units, and for ranges."""
    motion = planned_motion(experiment)
    peaks = peaks_by_axis(experiment, motion)
    return unit_refusal(experiment, motion, peaks), range_refusal(experiment, peaks)


@pytest.mark.parametrize("config", ["demo", "jhu"])
@pytest.mark.parametrize("more", [(), (AS_RECORDED,)])
@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"stiffness": 177.653}, "a stiffness of 177653 N/m (kN/m?) would give 9.24 Hz"),
        ({"stiffness": 177653.0, "mass": 0.5}, "a mass of 500 kg (t?) would give 3 Hz"),
        ({"stiffness": 177.653, "mass": 500.0}, "a stiffness of 177653 N/m (kN/m?) would give 3 "),
    ],
)
def test_kilonewtons_and_tonnes_are_reported(config, more, values, message):
    assert message in refused(load(*specimen(**values), *more, config=config))[0]


def test_both_in_other_units_are_reported():
    values = specimen(stiffness=177.653, mass=0.5, damping=0.8)
    text = refused(load(*values, config="demo"))[0]
    assert "a stiffness of 177653 N/m (kN/m?) and a mass of 500 kg (t?)" in text


def test_a_damping_in_kilonewtons_goes_with_the_stiffness():
    text = refused(load(*specimen(stiffness=177.653, damping=0.8)))[0]
    assert "peak displacement of 0.42 m (limit: 0.076)" in text
    assert "177653 N/m (kN/m?) would give 9.24 Hz" in text


def test_a_specimen_in_other_units_than_it_truly_has_is_reported_and_a_truth_in_others():
    known = load("specimen.mass:=0.5", "rig:simulated.specimen.mass:=52.7")
    assert refused(known)[0].startswith("/**: specimen:")
    true = load("rig:simulated.specimen.mass:=0.5")
    assert refused(true)[0].startswith("rig: simulated.specimen:")


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
        test = test.changed({"/**": {f"limits.{n}": wider * top for n, top in limits}})
        heard.append(unit_refusal(test, motion, peaks))
    assert heard == [""] * 60
