import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from seft_msgs_py.config.parameter_table import group, resolve
from seft_plant_sim.actuator import Hydraulics
from seft_plant_sim.continuous_model import delayed_force, servo_hydraulic
from seft_plant_sim.rig_parameters import RIG_TABLE
from seft_plant_sim.specimen import Specimen

M, C, K = 52.7, 903.5, 2.11e5
OIL, LEAKAGE, FLOW, VALVE_HZ, VALVE_DAMPING = 1.664e7, 20.0, 0.038527, 60.0, 0.7
SPECIMEN = Specimen(np.array([[M]]), np.array([[C]]), np.array([[K]]))


def hydraulics(specimen=SPECIMEN, axes=("x",), **changes):
    """Actuators of the table's defaults, the paper's rig, with changes."""
    given = {"specimen.mass": M, "specimen.stiffness": K}
    given |= {f"actuator.{name}": value for name, value in changes.items()}
    section = resolve({"rig": RIG_TABLE}, {"rig": RIG_TABLE.check(given)})["rig"]
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


def controller(s):
    """Eq. 3.1."""
    return 37 / (s**2 + 17.14 * s + 4002)


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


def test_zeros_of_valve_to_force_are_the_poles_of_the_specimen():
    size = len(MODEL.a)
    system = np.block([[MODEL.a, MODEL.b], [MODEL.c[3:4], MODEL.d[3:4]]])
    mask = scipy.linalg.block_diag(np.eye(size), np.zeros((1, 1)))
    with np.errstate(divide="ignore", invalid="ignore"):
        zeros = scipy.linalg.eigvals(system, mask)
    zeros = zeros[np.abs(zeros) < 1e5]  # the others are at infinity
    np.testing.assert_allclose(
        np.sort_complex(zeros), np.sort_complex(np.roots([M, C, K])), rtol=1e-6
    )
    assert np.abs(zeros) / (2 * np.pi) == pytest.approx(10.07, abs=0.005)


def test_the_oil_column_resonates_at_90_hz():
    poles = np.linalg.eigvals(MODEL.a)
    light = poles[np.abs(poles.real) < 0.1 * np.abs(poles)]
    np.testing.assert_allclose(np.abs(light) / (2 * np.pi), [90.0, 90.0], atol=0.5)
    assert len(poles) == 5
    assert (poles.real < 0).all()


def test_the_force_loop_crosses_over_at_12_hz():
    def gain(hz):
        return abs(controller(2j * np.pi * hz) * response(3, hz))

    assert scipy.optimize.brentq(lambda hz: gain(hz) - 1, 11.0, 13.0) == pytest.approx(12, abs=0.01)
    for hz in (0.1, 1.0, 5.0, 9.0, 11.9):
        assert gain(hz) > 1
    for hz in (12.1, 20.0, 60.0, 90.0, 200.0):
        assert gain(hz) < 1


def test_the_closed_force_loop_is_flat_to_25_hz_with_a_delay_near_14_ms():
    """With 4 ms around the loop at 500 Hz: 1 dead time, 2 latency, 1 zero-order hold."""
    hz = np.arange(0.1, 25.05, 0.1)
    s = 2j * np.pi * hz
    loop = controller(s) * valve_to_force(s) * np.exp(-0.004 * s)
    tracking = loop / (1 + loop)
    delay = -np.unwrap(np.angle(tracking)) / (2 * np.pi * hz)
    assert np.abs(20 * np.log10(np.abs(tracking))).max() < 0.7
    np.testing.assert_allclose(delay[hz < 10], 0.0138, atol=0.0004)


def test_the_default_actuator_crosses_over_where_12_hz_remain_as_it_runs():
    jhu = Specimen(np.array([[M]]), np.array([[800.3]]), np.array([[K]]))  # config/jhu.yaml
    model = servo_hydraulic(jhu, hydraulics(), linear=True)

    def gain(hz):
        return abs(controller(2j * np.pi * hz) * response(3, hz, model))

    assert scipy.optimize.brentq(lambda hz: gain(hz) - 1, 11.0, 13.0) == pytest.approx(
        12.18, abs=0.02
    )


def test_the_drives_are_the_reference_force_and_the_valve():
    assert MODEL.drive == "valve_command"
    ideal = delayed_force(SPECIMEN, 0.0)
    assert (ideal.drive, ideal.delay) == ("reference_force", 0.0)
    assert delayed_force(SPECIMEN, 0.01).delay == 0.01
    assert MODEL.delay == 0.001


def test_axes_are_coupled_by_the_specimen_alone():
    mass = np.array([[2.0, 0.5], [0.5, 1.0]])
    pair = Specimen(mass, np.zeros((2, 2)), np.diag([100.0, 200.0]))
    values = np.array([[1e5, 2e5], [3.0, 4.0], [0.1, 0.2], [50.0, 60.0], [0.7, 0.8]])
    names = ("oil_stiffness", "leakage", "flow_gain", "valve_frequency", "valve_damping")
    given = {name: row.tolist() for name, row in zip(names, values, strict=True)}
    model = servo_hydraulic(pair, hydraulics(pair, ("x", "y"), **given), linear=True)
    x, v, f, w = (np.eye(10)[2 * i] + 2 * np.eye(10)[2 * i + 1] for i in range(4))
    np.testing.assert_allclose((model.a @ f)[2:4], np.linalg.solve(mass, [1, 2]))
    np.testing.assert_allclose((model.a @ x)[2:4], np.linalg.solve(mass, [-100, -400]))
    np.testing.assert_allclose((model.a @ v)[4:6], [-1e5, -4e5])
    np.testing.assert_allclose((model.a @ f)[4:6], [-3, -8])
    np.testing.assert_allclose((model.a @ w)[4:6], [1e4, 8e4])
