import numpy as np
import pytest
from bare_rig import rig_section
from seft_msgs_py.config.parameter_table import group
from seft_plant_sim.actuator import Hydraulics
from seft_plant_sim.continuous_model import servo_hydraulic
from seft_plant_sim.specimen import Specimen

M, C, K = 52.7, 903.5, 2.11e5
OIL, LEAKAGE, FLOW, VALVE_HZ, VALVE_DAMPING = 1.664e7, 20.0, 0.038527, 60.0, 0.7
SPECIMEN = Specimen(np.array([[M]]), np.array([[C]]), np.array([[K]]))


def hydraulics(specimen=SPECIMEN, axes=("x",), **changes):
    """Actuators of the table's defaults, the paper's rig, with changes."""
    section = rig_section("actuator.", **changes)
    return Hydraulics.from_parameters(group(section, "actuator"), specimen, axes)


MODEL = servo_hydraulic(
    SPECIMEN,
    hydraulics(
        oil_stiffness=OIL,
        leakage=LEAKAGE,
        flow_gain=FLOW,
        valve_frequency=VALVE_HZ,
        valve_damping=VALVE_DAMPING,
        dead_time=0.001,
    ),
    linear=True,
)


def valve_to_force(s):
    """By hand: f = k_oil (q w - v) / (s + lambda), with v = s f / (m s^2 + c s + k)."""
    wv = 2 * np.pi * VALVE_HZ
    valve = wv**2 / (s**2 + 2 * VALVE_DAMPING * wv * s + wv**2)
    specimen = M * s**2 + C * s + K
    return valve * OIL * FLOW * specimen / ((s + LEAKAGE) * specimen + OIL * s)


def response(row, hz, model=MODEL):
    s = 2j * np.pi * hz
    inverse = np.linalg.solve(s * np.eye(len(model.a)) - model.a, model.b)
    return (model.c[row] @ inverse + model.d[row]).item()


@pytest.mark.parametrize("hz", [0.01, 1.0, 9.0, 10.07, 12.0, 30.0, 89.0, 90.0, 200.0])
def test_the_response_is_that_of_the_equations_by_hand(hz):
    s = 2j * np.pi * hz
    force = valve_to_force(s)
    specimen = M * s**2 + C * s + K
    for row, factor in enumerate([1 / specimen, s / specimen, s**2 / specimen, 1.0]):
        assert response(row, hz) == pytest.approx(force * factor, rel=1e-9)
