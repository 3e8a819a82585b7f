"""What the actuator is, by hand after Merritt (1967)."""

import numpy as np
import pytest
from bare_rig import rig_section
from seft_msgs_py.config.parameter_table import group
from seft_plant_sim.simulated.actuator import Hydraulics
from seft_plant_sim.simulated.continuous_model import servo_hydraulic
from seft_plant_sim.simulated.specimen import Specimen


def hydraulics(axes=("x",), **values):
    section = rig_section("actuator.", **values)
    return Hydraulics.from_parameters(group(section, "simulated.actuator"), axes)


def test_the_oil_column_resonates_with_actuator_and_specimen():
    """Mass on oil and specimen's spring together: the paper's 90 Hz, exactly if undamped."""
    undamped = Specimen(np.array([[52.7]]), np.zeros((1, 1)), np.array([[2.11e5]]))
    oil = 52.7 * (2 * np.pi * 90) ** 2 - 2.11e5
    closed = hydraulics(oil_stiffness=oil, leakage=0.0)
    poles = np.linalg.eigvals(servo_hydraulic(undamped, closed, linear=True).a)
    (hz,) = {round(p.imag / (2 * np.pi), 6) for p in poles if p.imag > 2 * np.pi * 80}
    assert hz == pytest.approx(90.0, abs=1e-5)
