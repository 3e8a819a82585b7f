"""Drawn tests: what is drawn, and what is made of the results."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_msgs_py.errors import InputError
from seft_ros.ensemble.entries import perturbed_rig
from seft_ros.ensemble.runs import Run
from seft_ros.ensemble.uncertainty import (
    Uncertainty,
    draw_tests,
    drawn_motion,
    of_files,
    quantiles,
    sensitivity,
    summarise_uncertainty,
)
from seft_ros.test_run.parameter_tables import TABLES

CONFIG = Path(__file__).parents[3] / "config"
TWO = ("/**:axes:=[x, y]", "rig:specimen.stiffness:=[2.11e5, -3.0e4, -3.0e4, 1.8e5]")


def load(*words, name="jhu"):
    overrides = [parse_override(word) for word in words]
    return Experiment.load(TABLES, [CONFIG / f"{name}.yaml"], overrides)


def made_up(errors, files=(), values=None):
    """A plan and its runs with these errors, the configured one first; inf: it tripped."""

    def part(error):
        known = None if error is None or math.isinf(error) else error
        return {"nrmse": known, "peak": 1.1, "reference_peak": 1.0}

    experiments = [{"ground_motion": {"file": file}} for file in files or [""] * len(errors)]
    runs = [
        Run(
            f"test {number}",
            {name: part(error) for name in ("displacement", "force", "acceleration")}
            | {"stable": error is None or math.isfinite(error), "trip": None},
        )
        for number, error in enumerate(errors)
    ]
    return Uncertainty(tuple(experiments), values or {}), runs


def test_test_0_is_the_configured_one_and_the_rigs_are_those_of_the_tournament():
    experiment = load()
    plan = draw_tests(experiment, 3, seed=5, spread=0.2)
    assert plan.experiments[0].sections == experiment.sections
    for number, drawn in enumerate(plan.experiments):
        assert drawn["rig"] == perturbed_rig(experiment["rig"], ("x",), 5, number, 0.2)
        for node in ("reference_force", "force_controller"):
            assert drawn[node] == experiment[node]


def test_a_test_does_not_depend_on_how_many_there_are():
    few, many = (draw_tests(load(), number) for number in (2, 6))
    for one, other in zip(few.experiments, many.experiments[:3], strict=True):
        assert one.sections == other.sections
    assert many.factors.keys() == few.factors.keys()
    for name, values in few.factors.items():
        assert np.array_equal(values, many.factors[name][:2])


def test_quantities_are_those_on_which_the_rig_depends():
    plan = draw_tests(load(), 4)
    assert "specimen.mass" in plan.factors and "actuator.flow_gain" in plan.factors
    for name in ("actuator.bulk_modulus", "actuator.rated_flow", "specimen.gap.width"):
        assert name not in plan.factors  # replaced by what is identified, or zero
    for name, values in plan.factors.items():
        assert values.shape == (4,) and np.all(values > 0), name
    plan = draw_tests(load(*TWO), 4)
    two = plan.factors
    assert not np.array_equal(two["actuator.flow_gain, axis x"], two["actuator.flow_gain, axis y"])
    stiffness = [
        one["rig"]["specimen.stiffness"][3] / 1.8e5 for one in draw_tests(load(*TWO), 4).experiments
    ]
    assert two["specimen.stiffness"] == pytest.approx(stiffness[1:])


@given(st.integers(1, 1000), st.floats(0.0, 1.0), st.sampled_from([0.0, 400.0]))
def test_a_motion_is_drawn_within_the_spread(number, spread, peak):
    section = load(f"ground_motion:peak_force:={peak}")["ground_motion"]
    drawn = drawn_motion(section, 1, number, spread, ())
    changed = "peak_force" if peak else "influence"
    kept = "influence" if peak else "peak_force"
    ratio = float(np.divide(drawn[changed], section[changed]).item())
    assert 1 / (1 + spread) - 1e-12 <= ratio <= 1 + spread + 1e-12
    assert drawn[kept] == section[kept]
    assert drawn["synthetic.seed"] != section["synthetic.seed"]
    assert drawn["synthetic.duration"] == section["synthetic.duration"]
    assert drawn == drawn_motion(section, 1, number, spread, ())


def test_each_file_is_drawn_and_the_ground_layer_of_files_is_not():
    section = load()["ground_motion"]
    drawn = [drawn_motion(section, 1, number, 0.1, ["a", "b", "c"]) for number in range(300)]
    counts = [sum(one["file"] == name for one in drawn) for name in "abc"]
    assert min(counts) > 70 and sum(counts) == 299
    assert {one["synthetic.ground_frequency"] for one in drawn} == {
        section["synthetic.ground_frequency"]
    }


def test_a_motion_that_is_not_there_is_told_before_anything_is_run():
    with pytest.raises(InputError, match=r"none\.AT2"):
        draw_tests(load(), 2, motions=["none.AT2"])


def test_an_unstable_test_is_the_most_wrong():
    errors = np.array([0.01, 0.03, math.inf, 0.02])
    assert quantiles(errors) == {
        "median": 0.02,
        "p90": math.inf,
        "p95": math.inf,
        "worst": math.inf,
    }
    rising = {"a": np.array([1.0, 1.2, 1.3, 1.1]), "b": np.array([0.9, 1.25, 0.7, 1.15])}
    first, second = sensitivity(made_up([0.0], values=rising)[0], errors)
    assert (first["quantity"], first["value"]) == ("a", pytest.approx(1.0))
    assert second["quantity"] == "b" and second["deviation"] == pytest.approx(1.0)


def test_shares_are_of_the_tests():
    errors = np.arange(1, 101) / 100.0
    assert quantiles(errors[::-1]) == {"median": 0.5, "p90": 0.9, "p95": 0.95, "worst": 1.0}
    assert math.isnan(quantiles(np.array([math.nan]))["p95"])


@given(st.lists(st.floats(0.5, 2.0), min_size=5, max_size=30, unique=True), st.integers(0, 99))
def test_the_correlation_is_that_of_ranks(values, seed):
    errors = np.random.default_rng(seed).permutation(len(values)).astype(float)
    (row,) = sensitivity(made_up([0.0], values={"a": np.array(values)})[0], errors)
    assert row["value"] == pytest.approx(spearmanr(values, errors).statistic)


def test_equal_errors_correlate_with_nothing():
    plan, runs = made_up([0.1] * 5, values={"a": np.array([0.9, 1.0, 1.1, 1.2])})
    (row,) = summarise_uncertainty(plan, runs)["sensitivity"]
    assert (row["value"], row["deviation"]) == (None, None)


def test_the_interval_of_a_share_is_wilsons():
    def interval(count, total):
        errors = [0.01] + [math.inf] * count + [0.01] * (total - count)
        return summarise_uncertainty(*made_up(errors))["unstable"]["interval_95"]

    # Newcombe 1998, table I
    assert interval(81, 263) == pytest.approx([0.2553, 0.3662], abs=5e-5)
    assert interval(15, 148) == pytest.approx([0.0624, 0.1605], abs=5e-5)
    assert interval(0, 20) == pytest.approx([0.0, 0.1611], abs=5e-5)


def test_a_summary_counts_what_tripped():
    plan, runs = made_up([0.01, 0.02, math.inf, None], values={"a": np.array([1.0, 1.1, 1.2])})
    found = summarise_uncertainty(plan, runs)
    assert found["tests"] == 3
    assert found["unstable"]["count"] == 1
    assert found["nrmse"]["displacement"] == {
        "median": 0.02,
        "p90": None,
        "p95": None,
        "worst": None,
    }
    assert found["peak_error"]["force"]["median"] == pytest.approx(0.1)
    assert [run["number"] for run in found["runs"]] == [1, 2, 3]
    assert found["runs"][2]["factors"] == {"a": 1.2}


def test_tests_are_grouped_by_their_ground_motion():
    plan, runs = made_up([0.01, 0.02, 0.03, 0.04], files=["", "a/one", "two", "a/one"])
    groups = {name: [run.entry for run in own] for name, own in of_files(runs, plan)}
    assert groups == {"one": ["test 1", "test 3"], "two": ["test 2"]}
    assert of_files(*reversed(made_up([0.01, 0.02]))) == []
