"""Margins: planned tests are stable just inside and grow just outside of them."""

from functools import partial

import numpy as np
import pytest
from experiments_at_hand import load, of_parts
from seft_ros.design import stability_map
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.stability_map import StabilityMap, preflight_figure
from seft_ros.design.stability_margins import (
    HIGHEST_MASS_RATIO,
    critical_mass_ratio,
    end_texts,
    find_margins,
    meanings,
    stability_change,
)
from seft_ros.design.stability_verdict import check_stability
from seft_ros.reference_force.compensation_methods import COMPENSATION_METHODS, model
from seft_ros.reference_force.reference_force_parameters import OWN_METHODS

K = 2.11e5
# of target_motion, see test_design_frozen_methods.py
OF_FORCES = [name for name in OWN_METHODS if name != "target_motion"]
DELAY = {
    "/**": {
        "actuator.kind": "delay",
        "actuator.delay": 0.010,
        "actuator.response.numerator": [1.0],
        "actuator.response.dead_time": 0.012,
    },
}
SERVO = {
    "/**": {
        "actuator.kind": "servo_hydraulic_linear",
        "actuator.delay": 0.0109,
        "actuator.response.numerator": [1.0],
        "actuator.response.denominator": [0.003, 1.0],
        "actuator.response.dead_time": 0.010,
    },
}
RIGS = {"delay": DELAY, "servo": SERVO}


experiment = partial(of_parts, {}, config="jhu")


def reference(**values):
    named = {name.replace("__", "."): value for name, value in values.items()}
    return {"reference_force": named}


def true(name, value):
    """What the rig truly is, whatever is known."""
    return {"rig": {f"simulated.{name}": value}}


def grows(*parts):
    """Whether the free vibration of a planned test grows: as it does, see
    test_design_closed_loop.py."""
    return PlannedTest(experiment(*parts)).growth_rate() > 0.0


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("method", OF_FORCES)
def test_a_plan_grows_from_the_critical_mass_ratio_on(method, rig):
    chosen = RIGS[rig], reference(compensation__method=method)
    critical = critical_mass_ratio(PlannedTest(experiment(*chosen)))
    if critical is None:
        assert not grows(*chosen, reference(mass_ratio=HIGHEST_MASS_RATIO))
        return
    for factor, unstable in ((0.98, False), (1.02, True)):
        assert grows(*chosen, reference(mass_ratio=factor * critical.value)) is unstable


@pytest.mark.parametrize("method", ["none", "model"])
@pytest.mark.parametrize("rig", RIGS)
def test_a_planned_test_that_has_the_critical_delay_gain_stiffness_or_known_delay_is_neutral(
    method, rig
):
    chosen = RIGS[rig], reference(compensation__method=method, mass_ratio=0.6)
    test = PlannedTest(experiment(*chosen))
    margins = find_margins(test)
    kind = "actuator.delay" if rig == "delay" else "actuator.dead_time"
    parts = [true(kind, margins.dead_time.value)]
    if rig == "servo":
        parts.append(true("actuator.flow_gain", 0.0403 * margins.gain.highest.value))
    ends = filter(None, (margins.stiffness.lowest, margins.stiffness.highest))
    parts += [true("specimen.stiffness", end.value * K) for end in ends]
    assert margins.followed is None
    assert (margins.delay_error is None) is (method == "none")
    if method == "model":
        known = test.section["actuator.delay"] + margins.delay_error.highest.value
        parts.append({"/**": {"actuator.delay": known}} | true("actuator.delay", 0.010))
    assert test.growth_rate() < -4.0
    left = [PlannedTest(experiment(*chosen, part)).growth_rate() for part in parts]
    assert np.abs(left).max() < 0.04  # at whole samples it jumps


def test_an_unstable_test_tells_the_delay_at_which_it_would_be_stable():
    ideal_end = find_margins(PlannedTest(experiment(DELAY, reference(mass_ratio=0.96))))
    assert (ideal_end.gain, ideal_end.stiffness, ideal_end.delay_error) == (None, None, None)
    assert 0 < ideal_end.dead_time.value < 0.010
    for factor, unstable in ((0.9, False), (1.1, True)):
        delay = true("actuator.delay", factor * ideal_end.dead_time.value)
        assert grows(DELAY, delay, reference(mass_ratio=0.96)) is unstable
    never = find_margins(PlannedTest(experiment(DELAY, reference(mass_ratio=1.1))))
    assert never.dead_time.value == 0.0


def test_an_unstable_force_loop_has_a_critical_mass_ratio_of_zero():
    wild = {"force_controller": {"numerator": [200.0]}}
    found = check_stability(PlannedTest(experiment(SERVO, wild)))
    assert found.verdict == "unstable"
    assert found.margins.mass_ratio.value == 0.0


@pytest.mark.parametrize(
    ("ratio", "verdict"), [(0.0, "stable"), (0.7, "stable"), (0.85, "marginal"), (0.95, "unstable")]
)
def test_the_verdict_follows_the_reserve_of_the_mass_ratio(ratio, verdict):
    found = check_stability(PlannedTest(experiment(DELAY, reference(mass_ratio=ratio))))
    assert found.verdict == verdict
    assert bool(found.reasons) == (verdict != "stable")
    if verdict == "marginal":
        assert found.reasons[0].startswith("mass ratio: unstable at 0.933")


def test_thin_margins_of_delay_gain_and_stiffness_are_named():
    thin = check_stability(PlannedTest(experiment(SERVO, reference(mass_ratio=1.05))))
    assert thin.verdict == "marginal"
    text = " / ".join(thin.reasons)
    assert "actuator's dead time: " in text and "actuator's gain: " in text
    known = reference(compensation__method="model", mass_ratio=0.5)
    stiff = {"/**": {"specimen.stiffness": 2.7 * K}} | true("specimen.stiffness", K)
    wrong = check_stability(PlannedTest(experiment(DELAY, known, stiff)))
    own = wrong.margins.stiffness
    assert own.planned == pytest.approx(1 / 2.7)
    assert own.planned / 1.1 < own.lowest.value < own.planned
    assert any("local stiffness" in reason for reason in wrong.reasons)


def test_the_rows_that_decide_are_those_below_their_reserve():
    """Of a valve of nearly three times the gain that the controller assumes."""
    test = PlannedTest(of_parts({}, true("actuator.flow_gain", 0.11), config="demo"))
    found = check_stability(test)
    deciding = [end for end in found.ends if end.decides]
    assert [end.reason for end in deciding] == found.reasons
    assert [(end.name, end.more) for end in deciding] == [
        ("actuator's dead time", ""),
        ("actuator's dead time", "with any assumed valve"),
        ("actuator's gain", ""),
    ]
    margins = found.margins
    ends = [margins.dead_time, margins.sure_dead_time, margins.gain.highest]
    assert [end.critical for end in deciding] == ends
    marked = [row for row in end_texts(found.ends) if row[2].startswith("! ")]
    same = "the same, with any assumed valve"
    assert [row[0] for row in marked] == ["actuator's dead time", same, "actuator's gain"]
    said = " ".join(meanings(found.ends))
    assert "a gain up to 30 %" in said and "a delay up to 5 ms" in said and "!: " in said
    growth = np.array([[-1.0, -1.0], [1.0, 1.0]])
    area = StabilityMap(np.array([0.0, 3.0]), np.array([0.0, 0.02]), growth, (1.5, 0.001))
    drawn = preflight_figure(test, found, [area])
    shown = [text.get_text() for axes in drawn.axes for text in axes.texts]
    assert all(cell in shown for row in marked for cell in row)
    assert any(text.startswith("with any assumed valve: ") for text in shown)
    assert "! critical, with any assumed valve" in shown


def test_what_adapts_is_promised_as_it_starts_only(monkeypatch):
    known = experiment(DELAY, reference(compensation__method="model", mass_ratio=0.5))
    fixed = check_stability(PlannedTest(known))
    assert "adapts" not in fixed.promise

    def adaptive(known):
        made = model(known)
        made.estimates = lambda: {"delay": np.full(known.axes, known.delay)}
        return made

    monkeypatch.setitem(COMPENSATION_METHODS, "model", adaptive)
    moving = check_stability(PlannedTest(known))
    assert "adapts" in moving.promise and "does not promise" in moving.promise
    assert moving.margins == fixed.margins


def test_what_is_not_linear_is_reported():
    servo = experiment(SERVO, {"/**": {"actuator.kind": "servo_hydraulic"}})
    assert "small motions" in check_stability(PlannedTest(servo)).promise


@pytest.mark.parametrize("edge", [0.1234, 3.3, 7.7])
def test_a_change_of_stability_is_bracketed_and_narrowed(edge):
    points = np.linspace(0.0, 8.0, 9).tolist()
    for sign in (1.0, -1.0):
        assert stability_change(lambda x, s=sign: s * (x - edge), points) == (
            pytest.approx(edge, abs=1e-5)
        )
        assert stability_change(lambda x, s=sign: s * np.sign(x - edge), points[::-1]) == (
            pytest.approx(edge, abs=1e-5)
        )
    assert stability_change(lambda x: -1.0, points) is None


# ---- Maps hold what single loops give, at their places


RATIO = "reference_force:mass_ratio:=0.5"
MODEL = "reference_force:compensation.method:=model"
STIFFNESS = "rig:simulated.specimen.stiffness:=[2.11e5, -3.0e4, -3.0e4, 1.8e5]"
CASES = {
    "model": (MODEL, "actuator.kind:=delay", "actuator.delay:=0.01"),
    "servo": (),
    "two axes": ("axes:=[x, y]", STIFFNESS),
}


@pytest.mark.parametrize("name", CASES)
def test_a_map_holds_what_the_plan_says_at_its_places(monkeypatch, name):
    monkeypatch.setattr(stability_map, "_FINEST", 11)
    test, seen = PlannedTest(load(RATIO, *CASES[name])), []
    maps = stability_map.stability_maps(
        test, find_margins(test), lambda what, done, total: seen.append((done, total))
    )
    size = len(maps[0].others)
    assert seen[-1] == (2 * size, 2 * size)
    units = 1.0, maps[1].planned[1]
    for area, change, unit in zip(maps, ("dead_time", "stiffness"), units, strict=True):
        assert area.growth.shape == (len(area.others), len(area.mass_ratios)) == (size, size)
        for row, column in ((0, 0), (3, 9), (size - 1, size - 1)):
            changes = {change: area.others[row] / unit}
            exact = test.growth_rate(mass_ratio=area.mass_ratios[column], **changes)
            assert area.growth[row, column] == pytest.approx(exact, rel=1e-6)
        low, high = area.others[[0, -1]]
        assert low <= area.planned[1] <= high
    assert np.any(maps[0].growth > 0) and np.any(maps[0].growth < 0)


def test_without_stiffness_there_is_no_map_of_it(monkeypatch):
    monkeypatch.setattr(stability_map, "_FINEST", 3)
    test = PlannedTest(load(RATIO, "specimen.stiffness:=0.0", config="demo"))
    margins = find_margins(test)
    assert margins.stiffness is margins.followed is None
    assert margins.dead_time is not None
    assert len(stability_map.stability_maps(test, margins)) == 1
