"""The force loop: margins against closed forms, and proposals."""

import json
from dataclasses import replace
from pathlib import Path

import force_loop
import numpy as np
import pytest
from force_loop import (
    Margins,
    close_loop,
    coefficients,
    is_stable,
    loop_margins,
    plant_of,
    propose_controller,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_ros.test_run.parameter_tables import TABLES

JHU = str(Path(__file__).parents[2] / "config" / "jhu.yaml")
F = np.geomspace(0.05, 200.0, 600)
S = 2j * np.pi * F


def delayed_integrator(crossover_hz, delay):
    return 2 * np.pi * crossover_hz / S * np.exp(-S * delay)


@settings(max_examples=12, derandomize=True)
@given(st.floats(1.0, 20.0), st.floats(0.003, 0.02))
def test_margins_of_an_integrator_with_delay_are_the_textbook_ones(crossover, delay):
    found = loop_margins(F, delayed_integrator(crossover, delay))
    phase_crossover = 1 / (4 * delay)
    assert found.crossover_hz == pytest.approx(crossover, rel=1e-3)
    assert found.phase_margin_deg == pytest.approx(90 - 360 * crossover * delay, abs=0.1)
    assert found.phase_crossover_hz == pytest.approx(phase_crossover, rel=1e-3)
    assert found.gain_margin_db == pytest.approx(
        20 * np.log10(phase_crossover / crossover), abs=0.02
    )


def test_what_is_not_finite_is_left_out():
    loop = delayed_integrator(10.0, 0.01)
    whole = loop_margins(F, loop)
    loop[100], loop[200] = np.nan, np.inf
    holed = loop_margins(F, loop)
    assert holed.phase_margin_deg == pytest.approx(whole.phase_margin_deg, abs=1e-3)
    assert loop_margins(F, np.full(len(F), np.nan, dtype=complex)) == Margins()


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
    given = [("/**", name, value) for name, value in rig.items()]
    test = Experiment.load(TABLES, overrides=given)
    return plant_of(test)


def test_for_the_papers_rig_it_is_the_papers_controller():
    proposed = propose_controller(plant(), 12.0, DT)
    numerator, denominator = coefficients(proposed)
    assert numerator == pytest.approx([37.0], rel=0.02)
    assert denominator == pytest.approx([1.0, 17.14, 4002.0], rel=0.01)
    assert is_stable(plant(), proposed, DT)
    assert not is_stable(plant(), 2.6 * proposed, DT)


@pytest.mark.parametrize(
    ("crossover", "dt", "changed"),
    [
        (6.0, 0.002, {}),
        (12.0, 0.00025, {}),
        (5.0, 0.002, {"actuator__dead_time": 0.0107}),
    ],
)
def test_a_proposal_keeps_what_it_promises(crossover, dt, changed):
    found = plant(**changed)
    loop = close_loop(found, propose_controller(found, crossover, dt), dt)
    assert is_stable(found, loop.controller, dt)
    assert loop.margins.crossover_hz == pytest.approx(crossover, rel=1e-3)
    assert loop.margins.phase_margin_deg >= 45 - 0.1
    assert loop.margins.gain_margin_db >= 6 - 0.1


def test_a_valve_the_other_way_round_turns_the_gain():
    turned = plant()
    turned = replace(turned, b=-turned.b)
    gains = [coefficients(propose_controller(of, 12.0, DT))[0][0] for of in (turned, plant())]
    assert gains[0] == pytest.approx(-gains[1])


@pytest.mark.parametrize(
    ("crossover", "changed", "message"),
    [
        (0.0, {}, "between 0 and"),
        (250.0, {}, "250 Hz"),
        (12.0, {"specimen__damping": 9000.0}, "no lightly damped zeros"),
        (12.0, {"actuator__leakage": 1.0}, "choose a lower one"),  # the oil column crosses, too
        (3.0, {"actuator__dead_time": 0.1}, "choose a lower one"),
    ],
)
def test_what_makes_no_sense_is_reported(crossover, changed, message):
    with pytest.raises(InputError, match=message):
        propose_controller(plant(**changed), crossover, DT)


# The command


def shaped(capsys, *words):
    status = force_loop.main([str(word) for word in words])
    out, err = capsys.readouterr()
    return status, json.loads(out) if out else None, err


def test_the_papers_rig_does_what_the_paper_says(capsys):
    status, found, err = shaped(capsys, JHU)
    assert (status, err) == (0, "")
    assert (found["plant_source"], found["stable"]) == ("rig", True)
    assert found["plant_zero_hz"] == pytest.approx(10.07, abs=0.05)
    assert found["plant_pole_hz"] == pytest.approx(90.0, abs=2.0)
    assert found["crossover_hz"] == pytest.approx(12.0, abs=0.5)
    assert found["phase_margin_deg"] == pytest.approx(63.3, abs=0.1)
    assert found["gain_margin_db"] == pytest.approx(7.61, abs=0.01)
    assert found["closed_loop_flat_to_hz"] >= 25
    assert 0.013 < found["delay_s"] < 0.0155


def test_a_proposal_is_written_for_seft_to_read_back(capsys, tmp_path):
    file = tmp_path / "controller.yaml"
    _, found, _ = shaped(capsys, JHU, "--crossover", 12, "--out", file)
    assert found["controller"]["denominator"] == pytest.approx([1.0, 17.14, 4002.0], rel=0.15)
    merged = Experiment.load(TABLES, [JHU, file])
    for name in ("numerator", "denominator"):
        assert merged["force_controller"][name] == found["controller"][name]
    _, again, _ = shaped(capsys, JHU, "--params-file", file)
    assert again == found
    status, _, err = shaped(capsys, JHU, "--out", file)
    assert status == 2
    assert "controller.yaml: exists already" in err


def test_an_unstable_loop_is_status_1_and_is_not_written(capsys, tmp_path):
    words = ("-p", "force_controller:numerator:=150.0", "--out", tmp_path / "c.yaml")
    status, found, err = shaped(capsys, JHU, *words)
    assert (status, found["stable"]) == (1, False)
    assert err.startswith("force_loop: unstable")
    assert not (tmp_path / "c.yaml").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([JHU, "-p", "force_controller:numerator:=0.0"], "numerator is zero"),
        ([JHU, "-p", "force_controller:numerator:=[1.0, 0.0, 0.0, 0.0]"], "improper"),
        ([JHU, "-p", "force_controller:gain:=[1.0, 2.0]"], "one transfer_function for all axes"),
    ],
)
def test_wrong_input_is_reported_in_one_line(capsys, words, message):
    status, found, err = shaped(capsys, *words)
    assert (status, found) == (2, None)
    assert err.count("\n") == 1
    assert message in err
