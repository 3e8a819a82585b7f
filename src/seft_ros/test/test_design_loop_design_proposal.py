from dataclasses import replace

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_ros.design.loop_design import propose_controller, shape_loop
from seft_ros.design.plant import choose_plant
from seft_ros.test_run.parameter_tables import TABLES

DT = 0.002
RIG = {  # crossover of 12 Hz under the paper's Eq. 3.1
    "specimen.mass": 52.7,
    "specimen.damping": 903.5,
    "specimen.stiffness": 2.11e5,
    "actuator.kind": "servo_hydraulic",
    "actuator.oil_stiffness": 1.664e7,
    "actuator.leakage": 20.0,
    "actuator.flow_gain": 0.038527,
    "actuator.valve_frequency": 60.0,
    "actuator.valve_damping": 0.7,
    "actuator.dead_time": 0.001,
}


def plant(**changed):
    rig = RIG | {name.replace("__", "."): value for name, value in changed.items()}
    given = [("rig", name, value) for name, value in rig.items()]
    test = Experiment.load(TABLES, overrides=given)
    return choose_plant(test)


def highest_of(error):
    return float(str(error.value).split("highest that can is ")[1].removesuffix(" Hz"))


def test_for_the_papers_rig_it_is_the_papers_controller():
    proposed = propose_controller(plant(), 12.0, DT)
    assert proposed.numerator == pytest.approx([37.0], rel=0.02)
    assert proposed.denominator == pytest.approx([1.0, 17.14, 4002.0], rel=0.01)


@pytest.mark.parametrize(
    ("crossover", "dt", "changed"),
    [
        (6.0, 0.002, {}),
        (14.0, 0.002, {}),
        (12.0, 0.00025, {}),
        (1.5, 0.01, {}),  # the oil column lies above half the rate
        (12.0, 0.002, {"actuator__leakage": 1.0}),
        (12.0, 0.002, {"specimen__damping": 100.0, "actuator__leakage": 5.0}),
        (5.0, 0.002, {"specimen__damping": 5.0, "actuator__leakage": 0.0}),
        (5.0, 0.002, {"specimen__mass": 2000.0}),
        (12.0, 0.002, {"actuator__valve_frequency": 200.0}),
        (5.0, 0.002, {"actuator__dead_time": 0.0107}),
    ],
)
def test_a_proposal_keeps_what_it_promises(crossover, dt, changed):
    found = plant(**changed)
    design = shape_loop(found, propose_controller(found, crossover, dt), dt)
    assert design.stable
    assert design.sampled.margins.crossover_hz == pytest.approx(crossover, rel=1e-3)
    assert design.sampled.margins.phase_margin_deg >= 45 - 0.1
    assert design.sampled.margins.gain_margin_db >= 6 - 0.1


def test_a_roll_off_or_a_notch_comes_only_where_the_oil_column_needs_it():
    enough = propose_controller(plant(), 12.0, DT)
    rolled_off = propose_controller(plant(actuator__leakage=1.0), 12.0, DT)
    lively = plant(specimen__damping=100.0, actuator__leakage=5.0)
    notched = propose_controller(lively, 12.0, DT)
    assert [len(c.denominator) for c in (enough, rolled_off, notched)] == [3, 4, 5]
    assert (rolled_off.zeros, len(notched.zeros)) == ([], 1)
    # the notch lies where the bilinear transform brings it onto the resonance
    f = np.linspace(80, 100, 2001)
    deepest = f[np.abs(notched.sampled_response(f, DT)).argmin()]
    assert deepest == pytest.approx(lively.oil_column().hz, abs=0.1)


def test_a_greater_gain_margin_may_be_wished():
    design = shape_loop(plant(), propose_controller(plant(), 7.0, DT, 12.0), DT)
    assert design.sampled.margins.gain_margin_db >= 12 - 0.1
    assert design.sampled.margins.crossover_hz == pytest.approx(7.0, rel=1e-3)


def test_a_valve_the_other_way_round_turns_the_gain():
    turned = plant()
    turned = replace(turned, b=-turned.b)
    assert propose_controller(turned, 12.0, DT).gain == pytest.approx(
        -propose_controller(plant(), 12.0, DT).gain
    )


@pytest.mark.parametrize("wish", [20.0, 60.0])
def test_what_can_not_be_had_is_refused_and_the_highest_named(wish):
    with pytest.raises(InputError, match=f"crossover of {wish:g} Hz") as error:
        propose_controller(plant(), wish, DT)
    highest = highest_of(error)
    assert 12 < highest < 20
    reached = shape_loop(plant(), propose_controller(plant(), highest, DT), DT)
    assert reached.sampled.margins.gain_margin_db >= 6 - 0.1
    with pytest.raises(InputError, match="highest"):
        propose_controller(plant(), highest + 0.1, DT)


@pytest.mark.parametrize(
    ("crossover", "margin", "changed", "told"),
    [
        (0.0, 6.0, {}, "between 0 and"),
        (250.0, 6.0, {}, "250 Hz"),
        (float("nan"), 6.0, {}, "between 0 and"),
        (12.0, -1.0, {}, "--gain-margin -1"),
        (12.0, float("nan"), {}, "--gain-margin nan"),
        (12.0, 41.0, {}, "between 0 and 40 dB"),
        (12.0, 6.0, {"specimen__damping": 9000.0}, "no lightly damped zeros"),
        (3.0, 40.0, {"actuator__dead_time": 0.1}, "nor can a lower one"),
    ],
)
def test_what_makes_no_sense_is_told(crossover, margin, changed, told):
    with pytest.raises(InputError, match=told):
        propose_controller(plant(**changed), crossover, DT, margin)


def test_an_undamped_specimen_is_left_no_mode_that_rings_for_ever():
    undamped = plant(specimen__damping=0.0)
    design = shape_loop(undamped, propose_controller(undamped, 4.0, DT), DT)
    assert design.stable
