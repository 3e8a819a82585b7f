"""What is made of the outcomes of tests, which are made up here."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings_at_hand import shown
from scipy.stats import spearmanr
from seft_ros.study.drawn_tests import DrawnTests, StudyDesign, StudyTest
from seft_ros.study.study_page import headline, study_notes, study_texts, write_study
from seft_ros.study.study_results import causes_of, quantiles, summarise_study
from seft_ros.study.study_runs import Run

LOST = math.inf
"""Error of a test that tripped."""


def made_up(errors, factors=None, offsets=None, files=(), not_possible=None, obstacles=None):
    """A study's design and its runs with these errors by method, the configured one first."""

    def part(error):
        known = 7.0 if error == LOST else error
        return {"nrmse": known, "peak": 1.1, "reference_peak": 1.0}

    def run(method, number, error):
        trip = {"reason": "too far"} if error == LOST else None
        parts = {name: part(error) for name in ("displacement", "force", "acceleration")}
        summary = parts | {"stable": error != LOST, "trip": trip}
        return Run(StudyTest(1.0, method, number), summary, (obstacles or {}).get(method, ""))

    count = len(next(iter(errors.values())))
    sections = [{"ground_motion": {"file": file}} for file in files or [""] * count]
    drawn = DrawnTests(tuple(sections), factors or {}, offsets or {}, 1, 0.1, ())
    lacking = {(1.0, name): reason for name, reason in (not_possible or {}).items()}
    methods = (*errors, *(not_possible or {}))
    design = StudyDesign(SimpleNamespace(), drawn, methods, (1.0,), lacking)
    of_all = errors.items()
    return design, [run(name, k, error) for name, own in of_all for k, error in enumerate(own)]


def summary_of(errors, **more):
    return summarise_study(*made_up(errors, **more))


def result_of(errors, **more):
    (result,) = summary_of({"a": errors}, **more)["results"]
    return result


def ranked(errors):
    return [result["method"] for result in summary_of(errors)["results"]]


def test_a_test_that_tripped_is_the_most_wrong():
    errors = np.array([0.01, 0.03, LOST, 0.02])
    assert quantiles(errors) == {"median": 0.02, "p90": LOST, "p95": LOST, "max": LOST}
    rising = {"a": np.array([1.0, 1.2, 1.3, 1.1]), "b": np.array([0.9, 1.25, 0.7, 1.15])}
    first, second = causes_of(DrawnTests((), rising, {}, 1, 0.1, ()), errors)
    assert (first["quantity"], first["value"]) == ("a", pytest.approx(1.0))
    assert second["quantity"] == "b" and second["deviation"] == pytest.approx(1.0)


@given(st.lists(st.floats(0.5, 2.0), min_size=5, max_size=30, unique=True), st.integers(0, 99))
def test_the_correlation_is_that_of_ranks(values, seed):
    errors = np.random.default_rng(seed).permutation(len(values)).astype(float)
    (cause,) = causes_of(DrawnTests((), {"a": np.array(values)}, {}, 1, 0.1, ()), errors)
    assert cause["value"] == pytest.approx(spearmanr(values, errors).statistic)


def test_the_interval_of_a_share_is_wilsons():
    def interval(count, total):
        errors = [0.01] + [LOST] * count + [0.01] * (total - count)
        return result_of(errors)["trips"]["interval_95"]

    # Newcombe 1998, table I
    assert interval(81, 263) == pytest.approx([0.2553, 0.3662], abs=5e-5)
    assert interval(15, 148) == pytest.approx([0.0624, 0.1605], abs=5e-5)
    assert interval(0, 20) == pytest.approx([0.0, 0.1611], abs=5e-5)


def test_a_summary_counts_what_tripped_and_lists_the_worst():
    factors = {"a": np.array([1.0, 1.1, 1.2]), "b": np.array([0.5, 0.9, 1.1])}
    late = {"late": np.array([0.0, 2e-4, 1e-4])}
    summary = summary_of({"a": [0.01, 0.02, LOST, 0.03]}, factors=factors, offsets=late)
    (result,) = summary["results"]
    assert summary["tests"] == 3
    assert (result["trips"]["count"], result["trips"]["share"]) == (1, pytest.approx(1 / 3))
    wanted = {"median": 0.03, "p90": None, "p95": None, "max": None}
    assert result["distribution"]["displacement"] == wanted
    assert result["configured"]["displacement"]["nrmse"] == 0.01
    assert [run["test"] for run in result["runs"]] == [1, 2, 3]
    drawn = {"factors": {"a": 1.2, "b": 1.1}, "offsets": {"late": 1e-4}}
    assert summary["drawn"][2] == {"test": 3, "motion": "", **drawn}
    worst = [(one["test"], one["stable"]) for one in result["worst"]]
    assert worst == [(2, False), (3, True), (1, True)]
    # for how far they are drawn at most
    assert list(result["worst"][1]["furthest"]) == ["a", "late", "b"]
    assert result["worst"][1]["furthest"]["late"] == 1e-4


def test_tests_are_grouped_by_their_ground_motion():
    motions = result_of([0.01, 0.02, 0.03, 0.05], files=["", "a/one", "two", "a/one"])["motions"]
    found = {name: (own["tests"], own["max"]) for name, own in motions.items()}
    assert found == {"one": (2, 0.05), "two": (1, 0.03)}


def test_methods_are_ranked_by_trips_and_then_by_their_errors():
    assert ranked(
        {
            "half": [0.0, 0.02, LOST],
            "steady": [0.0, 0.3, 0.31],
            "all": [0.0, LOST, LOST],
            "mostly": [0.0, 0.1, 0.5],
            "half, better": [LOST, LOST, 0.01],
        }
    ) == ["steady", "mostly", "half, better", "half", "all"]


@given(st.lists(st.floats(1e-6, 10.0), min_size=4, max_size=4), st.integers(1, 3))
def test_a_trip_never_betters_a_rank(errors, lost):
    spoilt = [LOST if index == lost else error for index, error in enumerate(errors)]
    assert ranked({"spoilt": spoilt, "whole": errors}) == ["whole", "spoilt"]


def test_the_terminal_shows_each_method_and_names_what_is_missing():
    errors = {"linear_acceleration": [0.3, 0.1234, 0.5], "none": [LOST, 0.2, LOST]}
    missing = {"not_possible": {"lacking": "no delay"}, "obstacles": {"none": "several rigs"}}
    summary = summary_of(errors, **missing)
    table = shown([study_texts(summary, "title")[1]], width=100)
    text = " ".join(table.replace("│", " ").split())
    assert "linear_acceleration 1 30.0 % 12.3 % 50.0 % 50.0 % 50.0 % 0 %" in text
    assert "none 1 unstable 20.0 % unstable unstable unstable 50.0 %" in text
    assert study_notes(summary) == [
        "lacking: not possible: no delay",
        "none: simulated uncompiled: several rigs",
    ]


def test_the_sentence_has_the_largest_error_that_most_tests_do_not_exceed():
    for lost, wanted in (0, "95 % of the tests are at most 1.00 %"), (1, "90 % of"), (4, "50 % of"):
        summary = summary_of({"a": [0.01] * (11 - lost) + [LOST] * lost})
        said = headline(summary["results"][0], summary)
        assert said.startswith(f"a at mass ratio 1: {wanted}")
    summary = summary_of({"a": [0.01] + [LOST] * 10})
    said = headline(summary["results"][0], summary)
    assert said.startswith("a at mass ratio 1: 10 of 10 tests tripped")


def test_the_sentence_says_what_the_error_depends_on_if_that_is_more_than_chance():
    for errors, is_reported in ((np.arange(21), True), (np.arange(21) % 2, False)):
        factors = {"rig:simulated.specimen.mass": np.linspace(0.9, 1.1, 21)}
        summary = summary_of({"a": [0.0, *(errors / 1000).tolist()]}, factors=factors)
        said = headline(summary["results"][0], summary)
        assert ("most on rig:simulated.specimen.mass, which explains 100 %" in said) is is_reported


FACTORS = {"b": np.array([0.9, 1.1])}
FEW = ([0.1, 0.1, 0.2], [LOST] * 3, [0.0] * 3, [None] * 3)


@pytest.mark.parametrize(
    ("errors", "factors"), [(FEW[0], {}), *((errors, FACTORS) for errors in FEW)]
)
def test_a_page_of_little_can_be_written(errors, factors, tmp_path):
    summary = summary_of({"a": errors}, factors=factors)
    for worst in summary["results"][0]["worst"]:
        worst["file"] = "some.yaml"
    write_study(summary, "title", "subtitle", tmp_path / "page.html")
    assert "some.yaml" in (tmp_path / "page.html").read_text()
