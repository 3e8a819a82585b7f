"""The verdict on mass and channels by a test's own samples, on the simulated rig."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from experiments_at_hand import CONFIG, load, simulated
from recordings_at_hand import as_measured, shown, without
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.whole_structure import reference_response
from seft_ros.analysis import calibration_check as checks
from seft_ros.analysis import equivalent_motion
from seft_ros.analysis.assessment import IN_LABORATORY, calibration_findings
from seft_ros.analysis.calibration_check import calibration_check
from seft_ros.analysis.channel_estimates import Relation, expected_relations
from seft_ros.analysis.equivalent_motion import motion_difference
from seft_ros.analysis.metrics import nrmse
from seft_ros.analysis.report_numbers import report_numbers
from seft_ros.analysis.result_text import summary_texts
from seft_ros.analysis.summary import summarise
from seft_ros.bags.recording import Series
from seft_ros.drawing.style import Mark

PLAN = (
    *("reference_force:compensation.method:=target_motion", "reference_force:mass_ratio:=1.3"),
    *("force_controller:method:=velocity_feedforward", "ground_motion:peak_force:=450.0"),
    *("ground_motion:synthetic.seed:=11", "ground_motion:synthetic.duration:=12.0"),
)
FRICTION = ("rig:simulated.specimen.kind:=friction", "rig:simulated.specimen.friction.force:=35.0")
WRONG_MASS = ("specimen.mass:=57.0", "rig:simulated.specimen.mass:=52.7")


@cache
def recording_of(*words):
    """Give the recording of a test that ran to its end."""
    recording = simulated(load(*PLAN, *words))
    assert recording.trip is None
    return recording


def as_of_hardware(recording):
    """Give the recording of a real rig, of whose specimen no more is known than the model."""
    sections = {node: own for node, own in recording.experiment.sections.items() if node != "rig"}
    return replace(recording, experiment=Experiment(sections))


def doubted(recording):
    """Findings on mass and channels that put a test in doubt."""
    findings = calibration_findings(summarise(recording))
    return {finding.name for finding in findings if finding.verdict is Mark.DOUBT}


@pytest.mark.parametrize("words", [(), FRICTION, ("rate:=250.0",), ("rate:=1000.0",)])
def test_a_fault_free_test_is_not_doubted(words):
    recording = as_of_hardware(recording_of(*words))
    check = calibration_check(recording)
    assert doubted(recording) == set()
    assert check["mass"]["estimate"] == pytest.approx(52.7, abs=4 * check["mass"]["error"])
    assert None not in (check["scale"], check["lag"])
    error = check["axes"]["x"]["force"]["lag"]["error"]  # 0.4 ms mean 3 to 14 %
    assert 0.0 < check["unsure"] < 0.1
    assert 50 * error < check["unsure_lag"] < 1500 * error


@pytest.mark.parametrize(
    ("words", "kinds"),
    [
        (WRONG_MASS, {"mass"}),
        ((*FRICTION, "rig:simulated.sensors.force_scale:=1.08"), {"mass"}),
        (("rig:simulated.sensors.acceleration_lag:=0.0002",), {"lag"}),
        (("rig:simulated.sensors.displacement_lag:=0.0008",), {"lag"}),
        (("rig:simulated.sensors.displacement_scale:=1.03",), {"scale"}),
        (("rig:faults:=force scale 1.08 at 3.0",), {"mass"}),
        (("rig:faults:=force drift -12.0 at 2.0",), {"drift"}),
        ((*FRICTION, "rig:faults:=force drift 12.0 at 2.0"), {"drift"}),
    ],
)
def test_a_wrong_mass_scale_lag_or_zero_puts_a_test_in_doubt(words, kinds):
    assert kinds <= doubted(as_of_hardware(recording_of(*words)))


def test_channels_that_wait_for_the_latest_are_read_when_they_are_read():
    """At 250 Hz what is folded down is 0.8 % of the acceleration, and a plant's delay turns it."""
    fault_free, aligned = (
        expected_relations(load(*PLAN, "rate:=250.0", *words), 5.0)[0]
        for words in ((), ("calibration.force_lag:=0.0004",))
    )
    assert abs(fault_free[1] - 1.0) > 5e-3
    assert aligned == pytest.approx(fault_free, abs=1e-9)


@pytest.mark.parametrize("words", [(*PLAN, *WRONG_MASS), PLAN[-2:]])
def test_a_laboratory_would_see_a_simulated_test_as_it_sees_that_of_a_real_rig(words):
    recording = simulated(load(*words))
    found, real = (report_numbers(one) for one in (recording, as_of_hardware(recording)))
    assert found.laboratory.text == real.assessment.text.replace("This", IN_LABORATORY, 1)
    used = (
        [f for f in of.findings if f.verdict is not Mark.NONE]
        for of in (found.laboratory, real.assessment)
    )
    assert next(used) == next(used)
    assert real.summary["laboratory_verdict"] is None


def test_a_reference_of_the_simulated_specimen_is_not_called_the_models():
    for recording, is_noted in ((recording_of(), False), (as_of_hardware(recording_of()), True)):
        assert ("model's" in shown(summary_texts(report_numbers(recording)))) is is_noted


def test_what_a_separate_test_found_is_combined_by_the_errors():
    recording = recording_of(*FRICTION)
    own = calibration_check(recording)["mass"]
    mass, lag_error = own["estimate"] + own["error"], {"calibration.force_lag_error": 1e-6}
    known = {"specimen.mass": mass, "specimen.mass_error": 0.1, **lag_error}
    known = replace(recording, experiment=recording.experiment.changed({"/**": known}))
    both = calibration_check(known)["mass"]
    weights = np.array([own["error"], 0.1]) ** -2.0
    estimates = own["estimate"], mass
    assert both["estimate"] == pytest.approx(np.average(estimates, weights=weights), rel=1e-4)
    assert both["error"] == pytest.approx(weights.sum() ** -0.5, rel=1e-3)

    def short(of):
        return replace(of, series={name: s.until(60) for name, s in of.series.items()})

    assert calibration_check(short(recording))["mass"] is None
    alone = calibration_check(short(known))["mass"]
    assert alone["estimate"] == pytest.approx(mass)
    assert alone["error"] == pytest.approx(0.1)


def test_the_verdict_counts_what_is_told_of_the_forces_scale_or_names_it():
    """A load cell that told the mass, too, is wrong by 1 %: nothing but a truth shows it."""
    identified = "specimen.mass:=53.227", "rig:simulated.specimen.mass:=52.7"
    wrong = simulated(load(*PLAN, *identified, "rig:simulated.sensors.force_scale:=1.01"))
    exact = reference_response(wrong.experiment, wrong.series["ground_motion"].values[:, 0])
    error = nrmse(wrong.measured.values[:, 0], exact.displacement)

    def check(**facts):
        known = {f"{group}_error": value for group, value in facts.items()}
        named = {name.replace("__", "."): value for name, value in known.items()}
        changed = wrong.experiment.changed({"/**": named})
        return calibration_check(replace(as_of_hardware(wrong), experiment=changed))

    weighed, untold = check(), check(specimen__mass=0.05)
    told = check(specimen__mass=0.05, calibration__force_scale=0.01)
    assert (weighed["force_scale"], told["force_scale"]) == (None, None)
    assert untold["force_scale"] == pytest.approx(error, rel=0.25)
    assert told["at_most"] > max(untold["at_most"], 1.5 * untold["force_scale"])


def test_what_has_changed_after_a_separate_test_is_seen():
    errors = "specimen.mass_error:=0.05", "calibration.force_lag_error:=1e-6"
    changes = "force_scale:=1.08", "force_lag:=0.0004"
    words = [*errors, *(f"rig:simulated.sensors.{change}" for change in changes)]
    check = calibration_check(recording_of(*words))
    assert check["mass"]["estimate"] == pytest.approx(1.08 * 52.7, rel=0.01)
    lag = check["axes"]["x"]["force"]["lag"]
    assert lag["estimate"] == pytest.approx(0.0004, abs=4 * lag["error"])
    assert abs(lag["estimate"]) > 4 * lag["error"]
    assert check["lag"]["effect"] > 0.02


@pytest.mark.parametrize("kind", ["ideal", "delay"])
def test_of_an_idealised_actuator_the_mass_is_known_and_no_relation(kind):
    words = "ground_motion:peak_force:=450.0", "rate:=1000.0", f"actuator.kind:={kind}"
    recording = simulated(load(*words))
    check = calibration_check(recording)
    assert check["scale"] is None
    assert check["mass"]["estimate"] == pytest.approx(52.7, abs=4 * check["mass"]["error"])


@pytest.mark.parametrize(
    ("config", "word"),
    [
        ("computed_damper", "ground_motion:synthetic.duration:=12.0"),
        ("jhu", "reference_force:method:=eft"),
    ],
)
def test_a_computed_model_and_an_eft_test_are_checked_too(config, word, monkeypatch):
    monkeypatch.chdir(CONFIG.parent)  # its script is given from there
    if config == "computed_damper":
        pytest.importorskip("openseespy", reason="OpenSeesPy is not installed")
    check = calibration_check(simulated(load(word, config=config)))
    assert check["mass"]["effect"] < 0.02
    assert check["mass"]["error"] < 0.05 * check["mass"]["told"]


def test_too_many_lost_samples_or_one_that_is_no_number_make_nothing_known():
    recording = recording_of()
    assert calibration_check(without(recording, "rig/state", range(100, 110)))["mass"] is not None
    assert calibration_check(without(recording, "rig/state", range(100, 400))) is None
    states = recording.series["rig/state"]
    values = states.values.copy()
    values[50, 2] = np.nan
    broken = replace(recording, series=as_measured(recording, Series(states.steps, values)))
    assert calibration_check(broken) is None


def test_of_a_long_test_the_part_that_moves_most_counts(monkeypatch):
    monkeypatch.setattr(checks, "MAX_SAMPLES", 100)
    samples = np.zeros((1000, 4, 1))
    samples[400:500, 2] = 1.0
    assert checks.strongest(samples)[:, 2].min() == 1.0


def test_what_is_folded_down_is_no_error_of_the_ground_motion(monkeypatch):
    recording = recording_of("rate:=250.0")

    def beyond_noise():
        found = motion_difference(recording)
        return np.sqrt(found.specimen_nrmse**2 - found.noise_nrmse**2)

    true = summarise(recording)["displacement"]["nrmse"]
    assert beyond_noise() == pytest.approx(true, rel=0.2)
    monkeypatch.setattr(equivalent_motion, "without_folding", lambda samples, *_: samples)
    assert beyond_noise() > 1.4 * true


def agreed(*masses):
    """Give the errors of the masses of a test and of its halves, each (estimate, error) or None."""
    none = np.zeros(1)
    relations = [one and Relation(*np.array([one]).T, none, none) for one in masses]
    found = checks.agreeing(relations[0], relations[1:])
    return [one and float(one.scale_error[0]) for one in found]


def test_a_mass_that_its_halves_contradict_is_less_sure():
    whole, first, second = agreed((0.993, 0.003), (0.997, 0.004), (1.001, 0.006))
    assert whole == pytest.approx(0.005)
    assert (first, second) == (whole, 0.006)


def test_a_mass_between_those_of_its_halves_keeps_its_error():
    assert agreed((0.998, 0.003), (0.997, 0.004), (1.001, 0.002)) == [0.003, 0.004, 0.003]


@pytest.mark.parametrize("masses", [(None, (1.0, 0.1), None), ((1.0, 0.1), None, None)])
def test_a_mass_that_nothing_is_compared_with_keeps_its_error(masses):
    assert agreed(*masses) == [one and one[1] for one in masses]
