"""From data sheets to what the actuator is, by hand after Merritt (1967)."""

import numpy as np
import pytest
from bare_rig import rig_section
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_plant_sim.actuator import Hydraulics
from seft_plant_sim.continuous_model import servo_hydraulic
from seft_plant_sim.specimen import Specimen

SHEET = {
    "piston_area": 1e-3,  # m^2
    "supply_pressure": 21e6,  # Pa
    "rated_flow": 3e-4,  # m^3/s at
    "rated_pressure_drop": 7e6,  # Pa
    "rated_voltage": 5.0,  # V
    "bulk_modulus": 1e9,  # Pa
    "oil_volume": 2e-4,  # m^3
    "leakage_coefficient": 3e-12,  # m^3/s/Pa
}


def hydraulics(axes=("x",), **values):
    section = rig_section("actuator.", **SHEET | values)
    return Hydraulics.from_parameters(group(section, "simulated.actuator"), axes)


def test_data_sheets_give_the_identified_values():
    """4 beta A^2/V; 4 beta C/V; Q sqrt(p_s/dp)/(A u); p_s A."""
    made = hydraulics()
    assert made.oil_stiffness.item() == pytest.approx(4 * 1e9 * 1e-6 / 2e-4)  # 2e7 N/m
    assert made.leakage.item() == pytest.approx(60.0)
    assert made.flow_gain.item() == pytest.approx(3e-4 * np.sqrt(3.0) / (1e-3 * 5.0))
    assert made.force_capacity.item() == pytest.approx(21e3)
    assert made.opening_limit.item() == 5.0


@pytest.mark.parametrize("name", ["oil_stiffness", "flow_gain", "leakage", "force_capacity"])
def test_an_identified_value_counts_before_the_data_sheet_and_changes_no_other(name):
    sheet, given = hydraulics(), hydraulics(**{name: 123.0})
    assert getattr(given, name).item() == 123.0
    others = {"oil_stiffness", "flow_gain", "leakage", "force_capacity"} - {name}
    for other in others:
        assert getattr(given, other) == getattr(sheet, other)


def test_the_oil_column_resonates_with_actuator_and_specimen():
    """Mass on oil and specimen's spring together: the paper's 90 Hz, exactly if undamped."""
    undamped = Specimen(np.array([[52.7]]), np.zeros((1, 1)), np.array([[2.11e5]]))
    oil = 52.7 * (2 * np.pi * 90) ** 2 - 2.11e5
    closed = hydraulics(oil_stiffness=oil, leakage_coefficient=0.0)
    poles = np.linalg.eigvals(servo_hydraulic(undamped, closed, linear=True).a)
    (hz,) = {round(p.imag / (2 * np.pi), 6) for p in poles if p.imag > 2 * np.pi * 80}
    assert hz == pytest.approx(90.0, abs=1e-5)


def test_each_axis_may_have_its_own_actuator():
    made = hydraulics(
        ("x", "y"),
        piston_area=[1e-3, 2e-3],
        leakage=[0.0, 25.0],
        friction=[10.0, 20.0],
        stroke=0.1,
        dead_time=[0.001, 0.003],
    )
    np.testing.assert_allclose(made.oil_stiffness, [2e7, 8e7])
    np.testing.assert_allclose(made.force_capacity, [21e3, 42e3])
    np.testing.assert_allclose(made.leakage, [60.0, 25.0])  # 0: that axis by its data sheet
    np.testing.assert_allclose(made.friction, [10.0, 20.0])
    np.testing.assert_allclose(made.stroke, [0.1, 0.1])
    assert made.part([1]).dead_time.tolist() == [0.003]


def test_a_number_of_values_that_does_not_fit_the_axes_is_refused():
    message = r"rig: simulated\.actuator\.piston_area: 2 values for 1 axes"
    with pytest.raises(InputError, match=message):
        hydraulics(piston_area=[1.0, 2.0])
