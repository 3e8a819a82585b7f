"""Maps of thousands of loops at once are those of one loop after the other."""

from pathlib import Path

import numpy as np
import pytest
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.parameter_file import parse_override
from seft_ros.experiment.tables import TABLES
from seft_ros.preflight.filter_grid import filters_over
from seft_ros.preflight.growth_rates import growth_rates
from seft_ros.preflight.plan import Plan
from seft_ros.preflight.stability_map import over_dead_time, over_stiffness

CONFIG = Path(__file__).parents[3] / "config"
DELAY = "reference_force:compensation.delay:=0.013"
METHOD = "reference_force:compensation.method:={}".format
TWO = ("/**:axes:=[x, y]", "rig:specimen.stiffness:=[2.11e5, -3.0e4, -3.0e4, 1.8e5]")
CASES = {
    "none": ("jhu.yaml", ()),
    "smith": ("jhu.yaml", (METHOD("smith"), DELAY)),
    "linear_acceleration": ("jhu.yaml", (METHOD("linear_acceleration"), DELAY)),
    "preview_inverse": ("jhu.yaml", (METHOD("preview_inverse"), "reference_force:mass_ratio:=1.5")),
    "two axes": ("jhu.yaml", (METHOD("linear_acceleration"), DELAY, *TWO)),
    "ideal": ("jhu.yaml", ("rig:actuator.kind:=delay", "rig:actuator.delay:=0.01")),
    "derived": ("jhu.yaml", ("rig:sensors.velocity:=derived",)),
}


def plan_of(config, words):
    overrides = [parse_override(word) for word in words]
    return Plan(Experiment.load(TABLES, [CONFIG / config], overrides))


@pytest.mark.parametrize("name", CASES)
def test_a_map_is_what_single_loops_give(name):
    plan = plan_of(*CASES[name])
    ratios, dead_times = np.linspace(0.0, 3.0, 40), np.linspace(0.0, 0.01, 7)
    factors = np.geomspace(0.5, 2.0, 40)
    by_dead_time = over_dead_time(plan, ratios, dead_times)
    by_stiffness = over_stiffness(plan, ratios, factors)
    assert by_dead_time.shape == (7, 40) and by_stiffness.shape == (40, 40)
    places = np.random.default_rng(1).integers(40, size=(12, 2))
    for place in [*places, (0, 0), (39, 0), (0, 39), (39, 39)]:
        row, column = int(place[0]), int(place[1])
        ratio = float(ratios[column])
        exact = plan.loop(mass_ratio=ratio, dead_time=float(dead_times[row % 7])).growth_rate()
        assert by_dead_time[row % 7, column] == pytest.approx(exact, rel=1e-7, abs=1e-6)
        exact = plan.loop(mass_ratio=ratio, stiffness=float(factors[row])).growth_rate()
        assert by_stiffness[row, column] == pytest.approx(exact, rel=1e-7, abs=1e-6)


@pytest.mark.parametrize("name", ["smith", "preview_inverse"])
def test_smooth_filters_are_made_at_some_nodes_alone(name, monkeypatch):
    plan = plan_of(*CASES[name])
    made = []
    own = plan.compensation
    monkeypatch.setattr(plan, "compensation", lambda *a, **k: made.append(1) or own(*a, **k))
    ratios, factors = np.linspace(0.0, 5.0, 50), np.geomspace(0.5, 2.0, 50)
    found = filters_over(plan, ratios, factors)
    assert len(made) < 900  # of 2500
    for row, column in ((0, 0), (49, 49), (17, 31)):
        one = own(mass_ratio=float(ratios[column]), stiffness=float(factors[row]))
        for part, exact in zip(found, (one.a, one.b, one.c, one.d), strict=True):
            error = np.abs(part[row, column] - exact)
            assert error.max(initial=0.0) <= 1e-9 * np.abs(part).max(initial=1e-300)


def test_filters_that_are_not_smooth_are_made_one_by_one():
    plan = plan_of("jhu.yaml", (METHOD("model"), "reference_force:compensation.delay:=0.02"))
    ratios, factors = np.linspace(0.0, 2.0, 12), np.geomspace(0.5, 8.0, 12)
    _, _, _, found = filters_over(plan, ratios, factors)
    for row in range(12):
        for column in range(12):
            one = plan.compensation(
                mass_ratio=float(np.expm1(np.log1p(ratios[column]))),
                stiffness=float(np.exp(np.log(factors[row]))),
            )
            np.testing.assert_allclose(found[row, column], one.d, rtol=1e-9)


def test_growth_rates_of_any_stack():
    random = np.random.default_rng(2)
    matrices = random.normal(size=(3, 4, 6, 6))
    matrices[..., :2, 2:] = 0.0  # a triangle of blocks
    exact = np.log(np.abs(np.linalg.eigvals(matrices)).max(axis=-1)) / 0.002
    np.testing.assert_allclose(growth_rates(matrices, 0.002), exact, rtol=1e-9)
