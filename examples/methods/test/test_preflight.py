"""What preflight says of the methods is what simulated tests do."""

import numpy as np
import pytest
from experiments_at_hand import of_parts, simulated
from seft_plant_sim.rig_parameters import LIMIT_ROWS
from seft_ros.design.plan import Plan
from seft_ros.design.preflight_tables import summarise_preflight
from seft_ros.design.stability_margins import critical_mass_ratio
from seft_ros.design.stability_verdict import check_stability

FIXED = ("polynomial", "linear_acceleration", "smith", "inverse")
DELAY = {
    "rig": {
        **{f"limits.{name}": 1e12 for name in LIMIT_ROWS},
        **{"actuator.kind": "delay", "actuator.delay": 0.01},
        **{f"sensors.{name}_noise": 0.0 for name in ("position", "acceleration", "force")},
    },
    "reference_force": {
        **{"compensation.delay": 0.013, "instability.ratio": 0.0},
        **{"limits.force": 1e12, "limits.force_rate": 1e15},
    },
    "force_controller": {"detectors.warn_only": "all"},
    "ground_motion": {"synthetic.duration": 0.5, "synthetic.rise": 0.1, "tail": 7.5},
}


def experiment(**reference):
    named = {name.replace("__", "."): value for name, value in reference.items()}
    return of_parts(DELAY, {"reference_force": named}, config="jhu")


def grows(test):
    """Whether the free vibration after a short motion grows, by the offline loop."""
    record = simulated(test)
    if record.trip is not None:
        return True
    force = record.series["rig/state"].values[:, 3]
    middle, last = (np.abs(part).max() for part in np.array_split(force[500:], 2))
    return bool(last > middle)


@pytest.mark.parametrize(("method", "end"), [("polynomial", 0.295), ("linear_acceleration", 16.2)])
def test_the_critical_mass_ratio_is_that_of_simulation(method, end):
    critical = critical_mass_ratio(Plan(experiment(compensation__method=method)))
    assert critical.value == pytest.approx(end, rel=0.01)
    for factor, unstable in ((0.97, False), (1.03, True)):
        test = experiment(compensation__method=method, mass_ratio=factor * critical.value)
        assert grows(test) is unstable


@pytest.mark.parametrize("method", FIXED)
def test_a_method_is_exact_to_preflight_and_the_same_where_it_starts_to_estimate(method):
    plan = Plan(experiment(compensation__method=method, mass_ratio=0.2))
    fixed = summarise_preflight(plan, check_stability(plan))
    assert fixed["basis"] == "exact" and "adapts" not in fixed["promise"]
    told = {"compensation__method": method, "compensation__settings": "estimate_delay=true"}
    adaptive = Plan(experiment(**told, mass_ratio=0.2))
    assert adaptive.growth_rate() == pytest.approx(fixed["growth_rate"], rel=0.02)
