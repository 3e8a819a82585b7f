"""Claims of the paper: each kind of criterion agrees where it should, and fails where it should."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from seft_ros.paper import measures
from seft_ros.paper.claims import Statement, statements, verdict
from seft_ros.paper.measures import explained, magnitude_and_phase
from seft_ros.paper.paper_tests import Outcome, vibration, without_vibration

RATE = 500.0
TIME = np.arange(5000) / RATE
SLOW = np.sin(2 * np.pi * 7.0 * TIME) * np.exp(-((TIME - 5.0) ** 2) / 4.0)
FAST = 0.3 * np.sin(2 * np.pi * 35.0 * TIME)


def outcome(measured, exact=SLOW):
    signals = ("displacement", "force", "acceleration")
    return Outcome(
        1 / RATE, dict.fromkeys(signals, measured), dict.fromkeys(signals, exact[: len(measured)])
    )


def judged(ours, **row):
    return verdict(Statement(**row), {"value": ours}, {})


def near(paper, ours, within, unit=""):
    return judged(ours, paper=paper, within=within, unit=unit)


@pytest.mark.parametrize(
    ("ours", "agrees"),
    [(10.07, True), (10.21, False), (9.9, False), (None, False), (np.nan, False)],
)
def test_a_number_agrees_within_its_tolerance_alone(ours, agrees):
    claim = near(10.1, ours, 0.1, "Hz")
    assert claim.agrees is agrees
    assert claim.paper == "10.1 Hz"
    assert claim.criterion == "within 0.1 Hz"


def test_no_tolerance_is_equality():
    assert near(0.002, 0.002, 0.0).agrees
    assert not near(0.002, 0.0020001, 0.0).agrees


@pytest.mark.parametrize(("ours", "most", "least"), [(0.05, True, False), (0.2, False, True)])
def test_a_measure_is_held_against_its_limit(ours, most, least):
    assert judged(ours, at_most=0.1).agrees is most
    assert judged(ours, at_least=0.1).agrees is least


@pytest.mark.parametrize("ours", [None, np.nan, np.inf, -np.inf])
def test_what_is_not_finite_never_agrees(ours):
    for sign in ("at_most", "at_least"):
        claim = judged(ours, **{sign: 0.1})
        assert claim.agrees is False
        assert claim.ours == "not finite"


@pytest.mark.parametrize(
    ("values", "agrees"),
    [
        ([0.1, 0.2, 0.3], True),
        ([0.1, 0.3, 0.2], False),
        ([0.1, 0.1], False),
        ([0.1, np.nan], False),
    ],
)
def test_growth_is_from_each_to_the_next(values, agrees):
    rising = Statement(rises=range(len(values)))
    assert verdict(rising, dict(enumerate(values)), {}).agrees is agrees


def test_a_verdict_is_a_plain_bool():
    assert judged(np.float64(0.05), at_most=0.1).agrees is True
    assert judged(np.float64(0.2), at_most=0.1).agrees is False


def test_every_claim_can_be_measured_and_judged():
    rows = statements()
    assert len(rows) == 70
    for row in rows:
        assert callable(getattr(measures, row.measure))
        assert row.within is not None or row.rises or row.at_most or row.at_least or row.above


def test_vibration_is_what_lies_above_the_controlled_band():
    assert vibration(SLOW, RATE).share < 1e-4
    shaken = vibration(SLOW + FAST, RATE)
    assert shaken.rms == pytest.approx(0.3 / np.sqrt(2), rel=0.02)
    assert shaken.peak_hz == pytest.approx(35.0, abs=0.5)
    kept = without_vibration(SLOW + FAST, RATE)
    np.testing.assert_allclose(kept[100:-100], SLOW[100:-100], atol=0.03)


def test_short_signals_are_measured_too():
    few = SLOW[:3]
    assert np.isfinite(vibration(few, RATE).rms)
    assert len(without_vibration(few, RATE)) == 3
    assert np.isnan(magnitude_and_phase(few, few, RATE, 7.0, 0.0)).all()
    still = SimpleNamespace(tests={("rig", 0.5): outcome(SLOW, 0.0 * SLOW)})
    assert np.isnan(measures.vibration(still, "rig", 0.5, "force")["value"])


def test_magnitude_and_phase_are_told_apart_from_delay():
    delay = 0.012
    late = 0.6 * np.interp(TIME - delay, TIME, SLOW)
    magnitude, phase = magnitude_and_phase(late, SLOW, RATE, 7.0, delay)
    assert magnitude == pytest.approx(0.6, abs=0.02)
    assert phase < 3.0
    _, untreated = magnitude_and_phase(late, SLOW, RATE, 7.0, 0.0)
    assert untreated > 20.0


def test_vibration_does_not_count_where_it_is_told_apart():
    test, other = outcome(SLOW + FAST), outcome(SLOW)
    assert test.agreement("acceleration", other).nrmse > 0.3
    assert test.agreement("acceleration", other, controlled=True).nrmse < 0.05
    assert test.agreement("force", controlled=True).nrmse_aligned < 0.05


def test_a_simulation_explains_an_error_only_where_it_has_it():
    rig = outcome(0.6 * SLOW)
    assert explained(outcome(0.61 * SLOW), rig) > 0.99
    assert explained(outcome(SLOW), rig) == pytest.approx(0.0)
    assert explained(outcome(1.4 * SLOW), rig) < 0


def test_a_test_that_ended_early_is_not_stable():
    from seft_msgs_py.wire.outcome import Trip

    whole = outcome(SLOW)
    assert whole.stable
    assert not replace(whole, trip=Trip("acceleration", 10, 0.02)).stable
    assert not outcome(np.where(TIME > 5, np.nan, SLOW)).stable
