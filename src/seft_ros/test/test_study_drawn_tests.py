import numpy as np
import pytest
from experiments_at_hand import load
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.errors import InputError
from seft_plant_sim.rig_parameters import RIG_TABLE
from seft_ros.study import drawn_tests
from seft_ros.test_run.parameter_tables import TABLES

TWO = ("/**:axes:=[x, y]", "/**:specimen.stiffness:=[2.11e5, -3.0e4, -3.0e4, 1.8e5]")
EXPERIMENT = load()


def rig_of(number, seed=1, spread=0.2, experiment=EXPERIMENT):
    return drawn_tests.drawn_rig(experiment["rig"], experiment.axes, seed, number, spread)


def test_every_drawn_quantity_is_a_parameter():
    known = {f"{table.node}:{row}" for table in TABLES for row in table.rows}
    assert {*drawn_tests.DRAWN_QUANTITIES, *drawn_tests.DRAWN_OFFSETS} <= known


def test_test_0_is_the_configured_one_and_the_others_are_drawn():
    drawn = drawn_tests.draw_tests(EXPERIMENT, 3, seed=5, spread=0.2)
    assert drawn.sections[0] == {node: EXPERIMENT[node] for node in ("rig", "ground_motion")}
    for number, sections in enumerate(drawn.sections[1:], 1):
        assert sections["rig"] == rig_of(number, seed=5)
        assert sections["ground_motion"] == drawn_tests.drawn_motion(
            EXPERIMENT["ground_motion"], 5, number, 0.2, ()
        )


def test_a_test_does_not_depend_on_how_many_there_are():
    few, many = (drawn_tests.draw_tests(EXPERIMENT, number) for number in (2, 6))
    assert many.sections[:3] == few.sections
    assert many.factors.keys() == few.factors.keys()
    for name, values in few.factors.items():
        assert np.array_equal(values, many.factors[name][:2])


@given(st.integers(1, 10_000), st.integers(0, 2**32), st.just(0.0) | st.floats(1e-6, 1.0))
def test_parameters_stay_within_their_spread_and_the_others_as_they_are(number, seed, spread):
    own, nominal = rig_of(number, seed, spread), EXPERIMENT["rig"]
    assert own.keys() == nominal.keys()
    for name, value in nominal.items():
        if name == "seed":
            continue
        if name.startswith("simulated.sensors.") and name.endswith("_lag"):
            assert 0.0 <= own[name] <= drawn_tests.DRAWN_OFFSETS[f"rig:{name}"] * spread
            continue
        uncertainty = drawn_tests.DRAWN_QUANTITIES.get(f"rig:{name}")
        if uncertainty is None or value == 0:
            assert own[name] == value
            continue
        most = 1.0 + uncertainty * spread
        assert 1 / most - 1e-12 <= own[name] / value <= most + 1e-12
    assert RIG_TABLE.check(own) == own


def test_without_spread_only_the_seeds_differ():
    assert rig_of(3, spread=0.0) | {"seed": 1} == EXPERIMENT["rig"]
    drawn = drawn_tests.draw_tests(EXPERIMENT, 2, spread=0.0)
    assert drawn.factors == drawn.offsets == {}
    assert drawn.sections[1]["ground_motion"] | {"synthetic.seed": 1} == EXPERIMENT["ground_motion"]


def test_actuators_differ_from_axis_to_axis_and_the_specimen_stays_symmetric():
    experiment = load(*TWO)
    drawn = drawn_tests.draw_tests(experiment, 4)
    two = drawn.factors
    x, y = (two[f"rig:simulated.actuator.flow_gain, axis {axis}"] for axis in "xy")
    assert not np.array_equal(x, y)
    assert drawn.offsets.keys() == {
        *(f"rig:simulated.sensors.{name}_lag, axis {axis}" for name in CHANNELS for axis in "xy"),
        "rig:simulated.sensors.tilt, axis x by y",
        "rig:simulated.sensors.tilt, axis y by x",
    }
    for number, sections in enumerate(drawn.sections[1:]):
        x, x_by_y, y_by_x, y = sections["rig"]["simulated.sensors.tilt"]
        assert x == y == 1.0
        assert x_by_y == drawn.offsets["rig:simulated.sensors.tilt, axis x by y"][number]
        assert 0.0 < abs(y_by_x) <= 0.01
        name = "simulated.specimen.stiffness"
        stiffness = np.divide(sections["rig"][name], experiment["rig"][name])
        assert stiffness == pytest.approx(np.full(4, two[f"rig:{name}"][number]))


def test_quantities_are_those_on_which_the_test_depends():
    factors = drawn_tests.draw_tests(EXPERIMENT, 4).factors
    rig = {"rig:simulated.specimen.mass", "rig:simulated.actuator.flow_gain"}
    assert rig | {"ground_motion:peak_force"} <= factors.keys()
    assert "rig:simulated.specimen.gap.width" not in factors  # zero
    assert "ground_motion:influence" not in factors
    for name, values in factors.items():
        assert values.shape == (4,) and np.all(values > 0), name


@given(st.integers(1, 1000), st.just(0.0) | st.floats(1e-6, 1.0), st.sampled_from([0.0, 400.0]))
def test_a_motion_is_drawn_within_the_spread(number, spread, peak):
    section = EXPERIMENT["ground_motion"] | {"peak_force": peak}
    drawn = drawn_tests.drawn_motion(section, 1, number, spread, ())
    changed = "peak_force" if peak else "influence"
    kept = "influence" if peak else "peak_force"
    ratio = float(np.divide(drawn[changed], section[changed]).item())
    assert 1 / (1 + spread) - 1e-12 <= ratio <= 1 + spread + 1e-12
    assert drawn[kept] == section[kept]
    assert drawn["synthetic.seed"] != section["synthetic.seed"]
    assert drawn["synthetic.duration"] == section["synthetic.duration"]
    assert drawn == drawn_tests.drawn_motion(section, 1, number, spread, ())


def test_each_file_is_drawn_and_the_ground_layer_of_files_is_not():
    section = EXPERIMENT["ground_motion"]
    files, draw = ["a", "b", "c"], drawn_tests.drawn_motion
    drawn = [draw(section, 1, number, 0.1, files) for number in range(1, 300)]
    counts = [sum(one["file"] == name for one in drawn) for name in "abc"]
    assert min(counts) > 70 and sum(counts) == 299
    ground = "synthetic.ground_frequency"
    assert {one[ground] for one in drawn} == {section[ground]}


def test_a_motion_that_is_not_there_is_reported_before_anything_is_run():
    with pytest.raises(InputError, match=r"none\.AT2"):
        drawn_tests.draw_tests(EXPERIMENT, 2, motions=["none.AT2"])


def test_a_rig_that_can_not_be_is_refused_by_its_number():
    section = EXPERIMENT["rig"] | {"simulated.actuator.dead_time": 1.1}
    with pytest.raises(InputError, match=r"^drawn test 5: .*dead_time.*smaller spread"):
        drawn_tests.check_rig(section, EXPERIMENT.axes, EXPERIMENT.timebase, 5)
    with pytest.raises(InputError, match=r"^rig: simulated.actuator"):
        drawn_tests.check_rig(section, EXPERIMENT.axes, EXPERIMENT.timebase, 0)
