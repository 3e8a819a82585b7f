"""Maps hold what single loops give, at their places."""

import numpy as np
import pytest
from experiments_at_hand import load
from seft_ros.design import stability_map
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.stability_margins import find_margins

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
