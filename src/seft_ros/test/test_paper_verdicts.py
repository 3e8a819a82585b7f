"""Verdicts on the tests of the paper turn where the results do."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from seft_msgs_py.wire.outcome import Trip
from seft_ros.design.controller import Root
from seft_ros.paper.claims import judge_claims, statements
from seft_ros.paper.findings import Findings
from seft_ros.paper.paper_tests import Outcome

DT = 0.002
TIME = np.arange(6000) * DT
NOISE = np.random.default_rng(1).standard_normal(len(TIME))
NAMES = ("displacement", "force", "acceleration")


def motion(hz):
    """What a structure of this frequency does: a band about it."""
    spectrum = np.fft.rfft(NOISE)
    f = np.fft.rfftfreq(len(TIME), DT)
    return np.fft.irfft(spectrum * np.exp(-(((f - hz) / (0.2 * hz)) ** 2)), len(TIME))


def a_test(hz, size=1.0, shaking=0.0, trip=None, lag=0):
    exact = motion(hz)
    exact = exact / np.std(exact) + 0.01 * np.sin(2 * np.pi * 30.0 * TIME)
    # false damping: smaller, and turned about the resonance
    measured = np.roll(size * exact, lag) + shaking * np.sin(2 * np.pi * 35.0 * TIME)
    return Outcome(DT, dict.fromkeys(NAMES, measured), dict.fromkeys(NAMES, exact), trip)


def a_loop(rate, hz):
    return SimpleNamespace(growth_rate=lambda: rate, hz=lambda: hz)


def made_up(**changes):
    """Findings as the paper has them, unless changed."""
    tripped = Trip("acceleration_range", 500, 1.0)
    half, one = a_test(8.2, 0.8, 0.05), a_test(7.1, 0.6, 0.12, lag=10)
    tests = {
        ("rig", 0.0): a_test(10.0, 1.0, 0.001),
        ("eft", 0.0): a_test(10.0, 1.0, 0.001),
        ("rig", 0.5): half,
        ("rig", 1.0): one,
        ("rig", 1.5): a_test(6.4, 1.0, 20.0, tripped),
    }
    for ratio, rig in ((0.5, half), (1.0, one)):
        quiet = a_test(8.2, 0.8, 0.03) if ratio == 0.5 else a_test(7.1, 0.6, 0.08, lag=10)
        for kind in ("delay", "banded", "own"):
            tests[kind, ratio] = quiet
        exact = replace(rig, measured=rig.exact)
        tests["model", ratio] = tests["model_tau", ratio] = exact
    tests |= changes.pop("tests", {})
    plans = {("rig", 1.5): a_loop(7.0, 35.9), ("rig", 1.0): a_loop(-9.0, 6.7)}
    plans |= {("delay", ratio): a_loop(5.0, 42.0) for ratio in (0.5, 1.0)}
    plans |= changes.pop("plans", {})
    specimen = SimpleNamespace(mass=np.array([[52.7]]), axis_root=lambda _: Root(10.07, 0.12))
    tracking = SimpleNamespace(delay_s=changes.pop("delay_s", 0.01), bandwidth_hz=34.5)
    identified = SimpleNamespace(
        specimen=specimen, closed_loops=(SimpleNamespace(tracking=tracking),)
    )
    sections = {
        "ground_motion": {"time_scale": 0.5},
        "reference_force": {"model.mass": [52.7]},
    }
    return Findings(_Sections(sections), "made up", 1000.0, identified, tests, plans)


class _Sections(dict):
    timebase = SimpleNamespace(dt=DT)


def verdicts(found):
    of_loop = ("Section 3.1", "Figure 3", "Figure 4")  # nothing is made up of those
    claims = judge_claims(found, [row for row in statements() if not row.where.startswith(of_loop)])
    return {claim.claim: claim.agrees for claim in claims}


def test_results_like_the_papers_agree_throughout():
    told = verdicts(made_up())
    assert [claim for claim, agrees in told.items() if not agrees] == []


@pytest.mark.parametrize(
    ("tests", "turned"),
    [
        ({("rig", 0.0): a_test(10.0, 0.7)}, "displacement agrees with the reference at alpha = 0"),
        (
            {("rig", 0.5): a_test(8.2)},
            "discrepancy of the displacement at alpha = 0.5",
        ),
        (
            {("rig", 0.5): a_test(8.2, 1.2)},
            "peak acceleration smaller than the reference at alpha = 0.5",
        ),
        (
            {("rig", 1.0): a_test(7.1, 0.9)},
            "discrepancy of the force grows: alpha = 0, 0.5, 1.0",
        ),
        (
            {("rig", 1.0): a_test(7.1, 0.6, 1e-3, lag=10)},
            "high-frequency acceleration appears at alpha = 1.0",
        ),
        (
            {("rig", 1.0): a_test(7.1, 0.6, 0.04, lag=10)},
            "high-frequency force grows with alpha: 0, 0.5, 1.0",
        ),
        ({("rig", 1.0): a_test(7.1, 1.0)}, "magnitude does not match at alpha = 1.0"),
        ({("rig", 1.5): a_test(6.4)}, "test at alpha = 1.5"),
        (
            {("banded", 1.0): a_test(7.1, 0.8)},
            "the delay is the major source of error at alpha = 1",
        ),
        (
            {("banded", 1.0): a_test(7.1, 0.6, 0.3, lag=10)},
            "less vibration in the simulation than in the experiment at alpha = 1",
        ),
        (
            {("delay", 1.0): a_test(7.1, 0.6, trip=Trip("force", 5, 0.01))},
            "displacement of Eq. 5.4 as printed matches the experiment at alpha = 1",
        ),
        (
            {("model", 0.5): a_test(8.2, 0.8)},
            "displacement with delay compensation agrees with the reference at alpha = 0.5",
        ),
        (
            {("model", 1.0): a_test(7.1, 1.0, 0.05)},
            "vibration does not appear with delay compensation at alpha = 1",
        ),
    ],
)
def test_a_verdict_turns_with_its_result(tests, turned):
    told = verdicts(made_up(tests=tests))
    assert told[turned] is False


def test_eigenvalues_that_turn_turn_the_verdict():
    told = verdicts(made_up(plans={("rig", 1.5): a_loop(-1.0, 35.9)}))
    assert told["eigenvalues of the loop at alpha = 1.5"] is False
    told = verdicts(made_up(plans={("rig", 1.5): a_loop(7.0, 90.0)}))
    assert told["the vibration is induced by acceleration feedback"] is False


def test_a_slower_actuator_is_told():
    assert verdicts(made_up(delay_s=0.0139))["delay of the actuator, identified"] is False
    assert verdicts(made_up(delay_s=None))["delay of the actuator, identified"] is False
