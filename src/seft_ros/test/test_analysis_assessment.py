"""The verdict of a report: its worst finding, and each threshold from both sides."""

import copy

import pytest
from seft_ros.analysis.assessment import IN_LABORATORY, assess_test
from seft_ros.drawing.style import Mark


def deviation(kind, channel, estimate, known, error, effect=0.0, part_of="x"):
    """Give the numbers of a `seft_ros.analysis.calibration_check.Deviation`."""
    of = {"kind": kind, "channel": channel, "axis": "x", "part_of": part_of, "part": ""}
    return of | {"effect": effect, "estimate": estimate, "told": known, "error": error}


MOVED = {"response_nrmse": 0.01, "specimen_response_nrmse": 0.02, "noise_nrmse": 0.01}
GOOD = {
    "steps": 1000,
    "judged_steps": 1000,
    "first_step": 0,
    "rate_hz": 500.0,
    "duration_s": 2.0,
    "trip": None,
    "stopped": False,
    "stable": True,
    "complete": True,
    "damage": [],
    "checked": True,
    "missed": 0,
    "overruns": 0,
    "link": None,
    "lost": {"rig/state": 0, "valve_command": 0},
    "saturated": {},
    "displacement": {"nrmse": 0.01, "peak": 1.0, "reference_peak": 1.01},
    "reference_specimen": "simulated",
    "equivalent_motion": MOVED,
    "tracking_error": None,
    "vibration": {"ratio": 0.01, "axes": {"x": 0.01}},
    "instability_band_hz": [20.0, 60.0],
    "uncompensated_delay_s": None,
    "energy": {"closure": 0.001},
    "axes": {"x": {}},
    "calibration": {
        "mass": deviation("mass", "force", 52.8, 52.7, 0.1),
        "scale": deviation("scale", "acceleration", 1.001, 1.0, 0.001),
        "lag": deviation("lag", "force", -1e-5, 0.0, 1e-5),
        "drift": deviation("drift", "force", 1.2, 0.0, 0.9),
        "at_most": 0.03,
        "force_scale": None,
        "unsure": 0.02,
        "unsure_lag": 0.07,
    },
}
REAL = {"reference_specimen": "model"}


def changed(**changes):
    summary = copy.deepcopy(GOOD)
    for name, value in changes.items():
        *places, key = name.split("__")
        part = summary[places[0]] if places else summary
        part[key] = value
    return summary


def test_a_test_without_fault_can_be_trusted():
    for summary, without in ((GOOD, 6), (changed(**REAL), 1)):
        assessment = assess_test(summary)
        assert assessment.verdict is Mark.GOOD
        assert assessment.text == "This test can be trusted."
        marks = [finding.verdict for finding in assessment.findings]
        assert (set(marks), marks.count(Mark.NONE)) == ({Mark.GOOD, Mark.NONE}, without)


def test_the_line_says_by_what_a_simulated_test_is_assessed():
    text = assess_test(changed(**REAL), IN_LABORATORY).text
    assert text == "As a laboratory would see it, this test can be trusted."


SHORT = {"samples": 3, "first_step": 5}


@pytest.mark.parametrize(
    ("changes", "mark", "name"),
    [
        ({"trip": {"reason": "force", "step": 7, "time_s": 0.014}}, Mark.BAD, "ending"),
        ({"damage": ["the end is missing"]}, Mark.DOUBT, "damage"),
        ({"stable": False}, Mark.BAD, "ending"),
        ({"complete": False}, Mark.BAD, "ending"),
        ({"complete": False, "first_step": None}, Mark.BAD, "ending"),
        ({"first_step": 120, "displacement__nrmse": 9.0}, Mark.BAD, "beginning"),
        ({"displacement__nrmse": 0.06}, Mark.DOUBT, "displacement_error"),
        ({"displacement__nrmse": 0.16}, Mark.BAD, "displacement_error"),
        ({"displacement__nrmse": None}, Mark.DOUBT, "displacement_error"),
        ({"displacement__peak": 1.1}, Mark.DOUBT, "displacement_peak"),
        ({"displacement__peak": 0.8}, Mark.BAD, "displacement_peak"),
        ({"vibration__ratio": 0.2}, Mark.DOUBT, "vibration"),
        ({"vibration__ratio": 0.4}, Mark.BAD, "vibration"),
        ({"uncompensated_delay_s": 0.014}, Mark.DOUBT, "delay"),
        ({"missed": 1}, Mark.DOUBT, "missed"),
        ({"missed": 51}, Mark.BAD, "missed"),
        ({"missed": None}, Mark.DOUBT, "missed"),
        ({"overruns": 1}, Mark.DOUBT, "overruns"),
        ({"link": {"loop_delay": 7, "late": 3, "held": 0, "forces": 99}}, Mark.DOUBT, "link"),
        ({"link": {"loop_delay": 7, "late": 30, "held": 9, "forces": 99}}, Mark.BAD, "link"),
        ({"lost__valve_command": 2}, Mark.DOUBT, "lost"),
        ({"saturated": {"force_range": SHORT}}, Mark.DOUBT, "saturated"),
        ({"energy__closure": 0.2}, Mark.DOUBT, "energy_balance"),
    ],
)
def test_each_fault_is_found_and_decides(changes, mark, name):
    assessment = assess_test(changed(**changes))
    worst = assessment.findings[0]
    assert (assessment.verdict, worst.verdict, worst.name) == (mark, mark, name)
    assert "trusted" in assessment.text
    assert worst.text in assessment.text


def test_the_headline_has_the_whole_reason_of_a_trip_and_its_finding_what_the_numbers_leave_out():
    trip = {"reason": "force (load cell) 900 N (limit 800 N)", "step": 599, "time_s": 1.198}
    found = assess_test(changed(trip=trip, judged_steps=600))
    assert "tripped at 1.198 s (step 599): force (load cell) 900 N (limit 800 N)." in found.text
    assert "first 600 steps and leave out the ramp-down" in found.findings[0].whole


@pytest.mark.parametrize("known", [{}, REAL])
def test_a_saturated_valve_is_no_reason_to_doubt_a_specimen_that_moved_as_it_should(known):
    summary = changed(saturated={"valve": SHORT}, tracking_error=OFF | {"nrmse": 0.04}, **known)
    assert assess_test(summary).verdict is Mark.GOOD
    summary["tracking_error"]["nrmse"] = summary["displacement"]["nrmse"] = 0.06
    doubted = {f.name for f in assess_test(summary).findings if f.verdict is Mark.DOUBT}
    assert "saturated" in doubted


OFF = {"rms": 1e-5, "peak": 1e-4, "nrmse": 0.2}


@pytest.mark.parametrize(
    ("changes", "mark", "name"),
    [
        ({"equivalent_motion__specimen_response_nrmse": 0.06}, Mark.DOUBT, "equivalent_motion"),
        ({"equivalent_motion__specimen_response_nrmse": 0.16}, Mark.BAD, "equivalent_motion"),
        ({"equivalent_motion__specimen_response_nrmse": None}, Mark.DOUBT, "equivalent_motion"),
        ({"equivalent_motion": None}, Mark.DOUBT, "equivalent_motion"),
        ({"tracking_error": OFF}, Mark.BAD, "tracking_error"),
        ({"tracking_error": OFF | {"nrmse": 0.06}}, Mark.DOUBT, "tracking_error"),
        ({"tracking_error": OFF | {"nrmse": None}}, Mark.DOUBT, "tracking_error"),
    ],
)
@pytest.mark.parametrize("specimen", ["model", None])
def test_a_rig_that_is_not_simulated_is_assessed_without_a_model(changes, mark, name, specimen):
    found = assess_test(changed(reference_specimen=specimen, displacement__nrmse=9.0, **changes))
    worst = found.findings[0]
    assert (found.verdict, worst.verdict, worst.name) == (mark, mark, name)
    assert not {f.name for f in found.findings} & {"displacement_error", "displacement_peak"}


def test_a_simulated_rig_is_assessed_by_its_exact_response():
    summary = changed(equivalent_motion__specimen_response_nrmse=0.9, tracking_error=OFF)
    assessment = assess_test(summary)
    assert assessment.verdict is Mark.GOOD
    unused = {f.name for f in assessment.findings if f.verdict is Mark.NONE}
    assert unused >= {"equivalent_motion", "tracking_error", "mass", "together"}


def test_what_is_not_known_is_left_out():
    summary = changed(energy=None, vibration__ratio=None)
    names = {finding.name for finding in assess_test(summary).findings}
    assert not names & {"energy_balance", "vibration", "delay"}
    findings = {f.name: f.text for f in assess_test(changed(first_step=None)).findings}
    assert "no rig/state" in findings["ending"]
    assert "lost" not in findings


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        (
            deviation("mass", "force", 55.2, 52.7, 0.3, 0.0412),
            "mass 55.2 ± 0.3 kg, known 52.7 kg, or 105 % of the true force, an error of 4.1 %",
        ),
        (
            deviation("scale", "acceleration", 0.98, 1.0, 0.001, 0.03),
            "acceleration is 2 ± 0.1 % smaller than the displacement says, an error of 3 %",
        ),
        (
            deviation("scale", "acceleration", 0.05, 0.0, 0.001, 0.03, part_of="y"),
            "acceleration shows 5 ± 0.1 % of that of y, an error of 3 %",
        ),
        (
            deviation("lag", "force", -4e-4, 0.0, 1e-5, 0.12),
            "force is 0.4 ± 0.01 ms ahead of the acceleration, an error of 12 %",
        ),
        (
            deviation("drift", "force", -43.0, 0.0, 4.0, 0.3),
            "the zero of force moved by 43 ± 4 N, an error of 30 %",
        ),
        (
            deviation("drift", "acceleration", 0.06, 0.0, 0.001, 0.06) | {"part": "second half"},
            "the zero of acceleration in the second half is 0.06 ± 0.001 m/s² off, an error of 6 %",
        ),
    ],
)
def test_a_wrong_mass_scale_or_lag_is_said_in_one_line(numbers, text):
    assessment = assess_test(changed(**{f"calibration__{numbers['kind']}": numbers}, **REAL))
    wanted = f"This test can be trusted with reservations: {text} in displacement."
    assert assessment.text == wanted
    assert (assessment.verdict, assessment.findings[0].name) == (Mark.DOUBT, numbers["kind"])


@pytest.mark.parametrize(
    ("what", "mark"),
    [
        ({"calibration": None}, Mark.DOUBT),
        ({"calibration__mass": None}, Mark.DOUBT),
        ({"calibration__lag": None}, Mark.GOOD),
    ],
)
def test_a_mass_that_is_not_known_is_a_reason_to_doubt(what, mark):
    assessment = assess_test(changed(**what, **REAL))
    assert assessment.verdict is mark
    assert any("is not known from the test" in finding.text for finding in assessment.findings)


def test_a_scale_of_the_force_that_nobody_told_is_named_and_does_not_doubt():
    untold = {"calibration__force_scale": 0.023}
    assert assess_test(changed(**untold)).text == "This test can be trusted."  # by its truth
    assessment = assess_test(changed(**untold, **REAL))
    assert assessment.verdict is Mark.GOOD
    said = "scale, of which 1 % would mean an error of 2.3 % in displacement."
    assert assessment.text.endswith(said)
    assert "load cell" not in assess_test(changed(damage=["cut"], **untold, **REAL)).text


def test_it_says_how_well_mass_and_lag_are_known():
    found = {finding.name: finding for finding in assess_test(GOOD).findings}
    assert found["mass"].text.startswith("mass 52.8 ± 0.1 kg, known 52.7 kg, an error of ")
    assert found["mass"].detail == found["lag"].detail == "good: up to 2 %"


ON_TARGET = {"tracking_error": OFF | {"nrmse": 0.01}}


def shaken(error, noise=0.0, at_most=0.0):
    """Changes of a real rig whose ground motion is off, and of what is not known of its mass."""
    motion = {"response_nrmse": 0.0, "specimen_response_nrmse": error, "noise_nrmse": noise}
    return {"equivalent_motion": motion, "calibration__at_most": at_most, **REAL}


@pytest.mark.parametrize(
    ("changes", "mark"),
    [
        ({"displacement__nrmse": 0.049}, Mark.GOOD),
        ({"displacement__peak": 1.05}, Mark.GOOD),
        ({"vibration__ratio": 0.09}, Mark.GOOD),
        ({"uncompensated_delay_s": 0.0039}, Mark.GOOD),
        ({"energy__closure": 0.04}, Mark.GOOD),
        # beyond what an assumed specimen says
        ({"vibration__ratio": 0.4, **REAL}, Mark.BAD),
        ({"vibration__ratio": 0.4, **REAL, **ON_TARGET}, Mark.GOOD),
        ({"energy__closure": 0.4, **REAL}, Mark.GOOD),
        # what is not known counts, and effects add up
        (shaken(0.0, at_most=0.06), Mark.DOUBT),
        (shaken(0.02, at_most=0.035), Mark.GOOD),
        (shaken(0.04, at_most=0.035), Mark.DOUBT),
        # the ground motion counts beyond its noise, and beside a target too
        (shaken(0.05, 0.04) | ON_TARGET, Mark.GOOD),
        (shaken(0.06) | ON_TARGET, Mark.DOUBT),
        (shaken(0.3) | ON_TARGET, Mark.DOUBT),
    ],
)
def test_thresholds_and_what_counts_together(changes, mark):
    found = assess_test(changed(**changes))
    assert found.verdict is mark
    if changes.get("calibration__at_most") and mark is Mark.DOUBT:
        assert found.findings[0].name == "together"
