"""A multisine test: what it will reach, and what it says of mass and channels of the simulated
rig."""

import math
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from seft_msgs_py.config.experiment import value_text
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError
from seft_plant_sim.channels import ACCELERATION, DISPLACEMENT, FORCE, VELOCITY
from seft_plant_sim.rig_parameters import truth
from seft_ros.identification import calibrated, multisine
from seft_ros.identification.actuator_fit import ActuatorFit
from seft_ros.identification.identified import Identified, ValveResponse, fitted_plant
from seft_ros.identification.multisine import Multisine, Sine, plan_multisine
from seft_ros.identification.multisine_estimates import harmonics
from seft_ros.identification.response_fits import SpecimenFit
from seft_ros.identification.rig_tests import multisine_test, write_forces
from seft_ros.reference_force.reference_force_block import method_inputs

SPECIMEN = "rig:simulated.specimen."
FLAG = (  # another mass, stiffness, oil column and law than any configuration has
    *(f"{SPECIMEN}mass:=73.0", f"{SPECIMEN}stiffness:=1.4e5", f"{SPECIMEN}damping:=300.0"),
    *(f"{SPECIMEN}kind:=flag", f"{SPECIMEN}yield_displacement:=0.0001"),
    "rig:simulated.actuator.oil_stiffness:=2.32e7",
    *("/**:specimen.mass:=60.0", "/**:specimen.stiffness:=2.0e5"),
)
FRICTION = (f"{SPECIMEN}kind:=friction", f"{SPECIMEN}friction.force:=60.0")
SENSORS = "rig:simulated.sensors."
NOISELESS = ("/**:sensors.displacement_noise:=0.0", "/**:sensors.adc_bits:=0")


def true(config="jhu"):
    """Words that say what the rig of a configuration truly is, whatever is known of it."""
    values = truth(load(config=config)["rig"])
    return [f"rig:{name}:={value_text(value)}" for name, value in values.items()]


def identified(experiment):
    """The rig with the actuators that its force controller knows, and the known specimen."""
    names = ("flow_gain", "oil_stiffness", "leakage", "force_capacity")
    names += ("valve_frequency", "valve_damping", "dead_time")
    known_values = {name: experiment["force_controller"][f"actuator.{name}"] for name in names}
    none = np.zeros(0)
    more = {"friction": 0.0, "friction_velocity": 0.005, "drag": 0.0, "largest_force": 0.0}
    more |= {"explained": 1.0, "unsure": (), "dt": 0.002}
    fit = ActuatorFit(**known_values, **more, measured=none, modelled=none)
    assumed = method_inputs(experiment["reference_force"], experiment.axes, experiment.timebase)
    model = SpecimenFit(assumed.mass, assumed.damping, assumed.stiffness, 0.0)
    count = len(experiment.axes)
    whole = fitted_plant(model, [fit] * count)
    valves = [ValveResponse(fit, None, 0.0, whole.axis(axis)) for axis in range(count)]
    return Identified(experiment.axes, (0.3, 200.0), model, valves, [], [], [])


@cache
def multisine_of(*words, config="jhu", elsewhere=None):
    """Run the multisine test of a configuration once, with known actuators."""
    experiment = load(*words, config=config)
    found = identified(experiment)
    plan = multisine.with_actuators(plan_multisine(experiment), found, experiment)
    commands, sines = multisine.multisine_drive(plan, found, experiment.timebase.dt)
    with TemporaryDirectory() as folder:
        path = write_forces(Path(folder) / "multisine.csv", experiment, commands)
        recording = simulated(multisine_test(experiment, path))
    assert recording.trip is None
    known = calibrated.all_known(load(config=config))
    test = plan, recording, sines, found, calibrated.Calibrated(known, known, 0.0, False)
    tilt = elsewhere and tuple(np.array(each) for each in elsewhere)
    return calibrated.MultisineResult.of_recording(*test, tilt_elsewhere=tilt)


def assert_known(value, error, true, most):
    """Within four standard errors, which are small."""
    assert value == pytest.approx(true, abs=4 * error)
    assert error < most


def test_mass_scale_lag_and_bias_are_recovered():
    words = (
        *(f"{SENSORS}acceleration_lag:=0.0013", f"{SENSORS}velocity_lag:=0.0004"),
        *(f"{SENSORS}acceleration_scale:=0.98", f"{SENSORS}velocity_scale:=1.02"),
        *(f"{SENSORS}force_bias:=4.0", f"{SENSORS}acceleration_bias:=0.08"),
    )
    found = multisine_of(*FLAG, *words)
    fit = found.fit
    assert_known(fit.mass[0, 0], fit.mass_error[0, 0], 73.0, 0.1)
    for row, scale, lag in ((VELOCITY, 1.02, 0.0004), (ACCELERATION, 0.98, 0.0013)):
        assert_known(fit.scale[row, 0], fit.scale_error[row, 0], scale, 2e-3)
        assert_known(fit.lag[row, 0], fit.lag_error[row, 0], lag, 1e-5)
    assert_known(fit.lag[FORCE, 0], fit.lag_error[FORCE, 0], 0.0, 1e-5)
    assert_known(fit.bias[ACCELERATION, 0], fit.bias_error[ACCELERATION, 0], 0.08, 2e-3)
    assert_known(fit.bias[FORCE, 0], fit.bias_error[FORCE, 0], 4.0, 0.5)
    assert found.facts()["specimen.mass"] == [fit.mass[0, 0]]
    assert found.facts()["specimen.mass_error"] == [fit.mass_error[0, 0]]
    section = found.calibrated.parameters()
    assert section["calibration.acceleration_lag"] == [pytest.approx(0.0013, abs=4e-5)]
    assert section["calibration.displacement_scale"] == [1.0]
    assert section["calibration.force_scale"] == [1.0]

    known_values = [f"/**:{name}:={value}" for name, value in section.items()]
    again = multisine_of(*true(), *FLAG, *words, *known_values)
    assert not again.calibrated.changes  # and what it knows is kept
    assert again.calibrated.parameters() == section


def test_a_weighed_mass_tells_the_scale_of_the_force():
    fit = multisine_of(f"{SENSORS}force_scale:=1.03").fit
    assert fit.mass[0, 0] == pytest.approx(1.03 * 52.7, rel=4e-3)
    found = fit.weighed(np.array([52.7]))
    assert found.mass[0, 0] == pytest.approx(52.7, rel=1e-12)
    assert_known(found.scale[FORCE, 0], found.scale_error[FORCE, 0], 1.03, 2e-3)


def test_what_is_not_known_of_filters_is_not_known_of_mass_and_scales():
    fit, unsure = multisine_of().fit, np.zeros((4, 1))
    unsure[ACCELERATION], unsure[FORCE] = 0.004, 0.003
    behind = fit.behind_filters(unsure)
    assert behind.mass_error == pytest.approx(np.hypot(fit.mass_error, 0.005 * fit.mass))
    wanted = fit.scale_error.copy()
    wanted[ACCELERATION] = np.hypot(wanted[ACCELERATION], 0.004 * fit.scale[ACCELERATION])
    assert behind.scale_error == pytest.approx(wanted)


def test_friction_spoils_neither_mass_nor_bias():
    biases = f"{SENSORS}force_bias:=5.0", f"{SENSORS}displacement_bias:=2e-4"
    fit = multisine_of(*FRICTION, *biases).fit
    assert_known(fit.mass[0, 0], fit.mass_error[0, 0], 52.7, 0.12)
    assert fit.mass[0, 0] == pytest.approx(52.7, rel=4e-3)
    assert fit.bias[DISPLACEMENT, 0] == pytest.approx(2e-4, abs=1e-5)
    assert fit.bias[FORCE, 0] == pytest.approx(5.0, abs=1.0)


def test_of_a_specimen_that_rubs_the_damping_is_found_beside_its_friction():
    found = multisine_of(*FRICTION)
    assert_known(found.fit.damping[0, 0], found.fit.damping_error[0, 0], 800.3, 80.0)
    assert found.facts()["specimen.damping"] == [pytest.approx(800.3, rel=0.3)]
    assert "specimen rubs" in "".join(calibrated.multisine_notes(found, ("x",)))
    linear = multisine_of()
    assert "specimen.damping" not in linear.facts()  # the open loop says it better
    assert "specimen rubs" not in "".join(calibrated.multisine_notes(linear, ("x",)))


def test_overtones_that_a_filter_buries_in_noise_do_not_spoil_the_mass():
    known = "/**:calibration.displacement_filter:=60.0"
    fit = multisine_of(*FRICTION, known, "rate:=2000.0").fit
    assert_known(fit.mass[0, 0], fit.mass_error[0, 0], 52.7, 0.12)


def test_a_multisine_test_under_which_friction_holds_the_specimen_says_so():
    storeys = SPECIMEN + "springs:=[1.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, -1.0, 1.0]"
    held = (storeys, SPECIMEN + "kind:=friction", SPECIMEN + "friction.force:=300.0")
    with pytest.raises(InputError, match=r"sticks under sines of .* mm: .* larger --travel"):
        multisine_of(*held, config="three_storey_frame")


def test_what_is_late_is_reported_whatever_is_the_latest():
    fit = multisine_of(f"{SENSORS}displacement_lag:=0.002")
    lags = [fit.calibrated.parameters()[f"calibration.{channel}_lag"][0] for channel in CHANNELS]
    assert lags == pytest.approx([0.002, 0.0, 0.0, 0.0], abs=2e-5)


def test_a_derived_velocity_has_no_calibration():
    section = multisine_of("/**:sensors.velocity:=derived").calibrated.parameters()
    assert not any("velocity" in name for name in section)
    load("/**:sensors.velocity:=derived", *(("/**", *item) for item in section.items()))


def test_several_axes_give_the_matrix_and_a_tilt():
    tilt = SENSORS + "tilt:=[1.0, 0.0, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0, 1.0]"
    found = multisine_of(tilt, config="three_storey_frame")
    fit = found.fit
    np.testing.assert_allclose(fit.mass, 52.7 * np.eye(3), atol=0.3)
    assert_known(fit.tilt[1, 0], fit.tilt_error[1, 0], 0.03, 2e-3)
    notes = calibrated.multisine_notes(found, ("a", "b", "c"))
    assert [note for note in notes if "axis b" in note and "of a:" in note and "tilt corr" in note]
    assert sum("tilted" in note for note in notes) == 1

    section = found.calibrated.parameters()
    assert section["calibration.tilt"] == pytest.approx([1, 0, 0, 0.03, 1, 0, 0, 0, 1], abs=2e-3)
    known = [f"/**:{name}:={value}" for name, value in section.items()]
    again = multisine_of(*true("three_storey_frame"), tilt, *known, config="three_storey_frame")
    assert not again.calibrated.changes
    assert again.calibrated.parameters() == section


def test_a_tilt_is_that_of_all_motions_that_show_it():
    tilt = SENSORS + "tilt:=[1.0, 0.0, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0, 1.0]"
    found = multisine_of(tilt, config="three_storey_frame").fit
    derived = multisine_of(tilt, "/**:sensors.velocity:=derived", config="three_storey_frame").fit
    assert found.tilt_error[1, 0] < 0.8 * derived.tilt_error[1, 0]  # by the velocity
    assert_known(derived.tilt[1, 0], derived.tilt_error[1, 0], 0.03, 2e-3)

    seen = ((1.0, 0.0, 0.0), (0.0304, 1.0, 0.0), (0.0, 0.0, 1.0))
    error = tuple(tuple(1e-4 * (i != j) for j in range(3)) for i in range(3))
    both = multisine_of(tilt, config="three_storey_frame", elsewhere=(seen, error)).fit
    assert 0.0 < both.tilt_error[1, 0] < 1e-4
    assert both.tilt[1, 0] == pytest.approx(0.0304, abs=1e-4)


def test_velocity_and_acceleration_against_the_displacement_are_right():
    found = multisine_of(*FLAG, f"{SENSORS}displacement_scale:=0.96")
    fit = found.fit
    assert_known(fit.scale[DISPLACEMENT, 0], fit.scale_error[DISPLACEMENT, 0], 0.96, 2e-3)
    assert_known(fit.mass[0, 0], fit.mass_error[0, 0], 73.0, 0.1)
    section = found.calibrated.parameters()
    assert section["calibration.velocity_scale"] == section["calibration.acceleration_scale"] == [1]
    assert section["calibration.displacement_scale"] == [pytest.approx(0.96, abs=2e-3)]


def test_the_displacement_follows_from_the_noise_and_the_peaks_are_reported():
    plan = plan_multisine(load())
    noisy = plan_multisine(load("/**:sensors.displacement_noise:=2e-5"))
    assert noisy.travel == pytest.approx(4 * plan.travel, rel=0.05)
    chosen = plan_multisine(load(), travel=1e-4)
    assert (chosen.travel, chosen.peaks["displacement"]) == (1e-4, 1e-4)
    assert "sines of 0.1 mm on each axis, up to 48.5 Hz" in chosen.text()
    largest, peaks = multisine_of(*FLAG).largest, multisine_of(*FLAG).multisine.peaks
    for name, peak in peaks.items():
        assert largest[name] < 1.15 * peak, name  # with the noise


def test_limits_lower_the_highest_frequency():
    free, bound = plan_multisine(load()), plan_multisine(load("/**:limits.acceleration:=10.0"))
    assert bound.peaks["acceleration"] <= 5.0 < free.peaks["acceleration"]
    assert bound.top < free.top


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_range_of_0_is_no_limit(channel):
    bits, unlimited = "/**:sensors.adc_bits:=0", f"/**:sensors.{channel}_range:=0.0"
    assert plan_multisine(load(bits, unlimited)) == plan_multisine(load(bits))


def test_a_stiff_heavy_specimen_is_tested_at_the_same_frequencies_at_every_rate():
    """Whatever the limits leave of the rate: 20 Hz of a 4000 Hz loop, too."""
    heavy = ("/**:specimen.mass:=800.0", "/**:limits.force:=2000.0")
    plans = [plan_multisine(load(*heavy, f"rate:={rate}.0"), 1e-4) for rate in (500, 4000)]
    assert plans[0].top == pytest.approx(plans[1].top, rel=0.06)
    assert 10.0 < plans[1].top < 80.0


@pytest.mark.parametrize(
    ("words", "travel", "message"),
    [
        ((), 0.06, r"would reach 0.06 m with 60 mm.*half of /\*\*: limits.displacement, 0.076"),
        ((), -1e-4, "--travel is -0.0001 m"),
        (("/**:limits.force:=20.0",), None, r"half of /\*\*: limits.force.*--travel"),
        (NOISELESS, None, r"/\*\*: sensors.displacement_noise is 0"),
    ],
)
def test_a_multisine_test_beyond_limits_is_refused_before_anything_moves(words, travel, message):
    with pytest.raises(InputError, match=message):
        plan_multisine(load(*words), travel)


def test_a_multisine_test_beyond_the_valve_is_refused():
    experiment = load()
    with pytest.raises(InputError, match=r"limits.command, 10 V; give a smaller --travel"):
        plan = Multisine(0.01, 50.0, {})
        multisine.with_actuators(plan, identified(experiment), experiment)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_what_a_converter_makes_of_an_amplitude_is_in_its_error(noise):
    sine, dt, step = Sine(0, 12.34567, 0, 20_000), 1e-3, 3.7e-5
    wave = np.cos(2 * np.pi * sine.frequency * dt * np.arange(sine.end))
    rng, off, foreseen = np.random.default_rng(1), [], []
    for amplitude in np.linspace(9.5, 10.5, 21) * step:
        shown = amplitude * wave + noise * step * rng.standard_normal(len(wave))
        samples = np.repeat(step * np.round(shown / step), 4).reshape(-1, 4, 1)
        of = harmonics(samples, [sine], dt)
        off.append(abs(of.amplitude[0, 0, 0]) / amplitude - 1.0)
        foreseen.append(math.hypot(of.rounding[0, 0], of.noise[0, 0, 0] / amplitude))
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.mean(foreseen), rel=0.4)
