"""Faults of supply and specimen, by what equilibrium and energy say of them."""

import math

import numpy as np
import pytest
from bare_rig import FRAME, driven, make_rig
from seft_msgs_py.wire.topics import RigAxes
from seft_plant_sim.simulated.faults import failing_specimen, read_faults
from seft_plant_sim.simulated.specimen import Specimen

MASS, K = 52.7, 2.11e5
IDEAL = {"actuator__kind": "ideal", "specimen__mass": MASS, "specimen__stiffness": K}
DAMPED = IDEAL | {"specimen__damping": 2.0 * math.sqrt(K * MASS)}
YIELDING = DAMPED | {"specimen__kind": "bilinear", "specimen__yield_displacement": 1.0}
LIMITS = {"limits__force": 1e9, "limits__displacement": 1.0, "limits__velocity": 1e9}


def rig(*faults, axes=("x",), **values):
    return make_rig(axes, **LIMITS, **values, faults=list(faults) or "")


@pytest.mark.parametrize("values", [DAMPED, YIELDING])
def test_a_specimen_breaks_to_the_stiffness_that_is_left(values):
    found = driven(rig("specimen break 0.25 at 1 for 500", **values), np.full(1600, 211.0))[:, 0, 0]
    assert found[499] == pytest.approx(1e-3, rel=1e-6)
    assert found[999] == pytest.approx(4e-3, rel=1e-3)
    assert found[-1] == pytest.approx(1e-3, rel=1e-6)


@pytest.mark.parametrize("values", [DAMPED, YIELDING])
def test_a_specimen_slips_to_another_zero(values):
    found = driven(rig("specimen slip 2e-3 at 0.5", **values), np.full(1000, 211.0))[:, 0, 0]
    assert found[250] == pytest.approx(1e-3, rel=1e-6)
    assert found[-1] == pytest.approx(3e-3, rel=1e-6)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_specimen_collides_where_it_is_in_the_direction_in_which_it_moves(side):
    force = side * np.concatenate([np.linspace(0.0, 422.0, 2000), np.full(500, 422.0)])
    found = driven(rig("specimen collide 2.11e5 at 2", **DAMPED), force)[:, 0, 0]
    begun = found[1000]
    assert abs(begun) == pytest.approx(1e-3, rel=0.03)
    assert found[-1] == pytest.approx((side * 422.0 + K * begun) / (2.0 * K), rel=1e-6)
    there_and_back = [*force, *np.full(900, -side * 422)]
    back = driven(rig("specimen collide 2.11e5 at 2", **DAMPED), there_and_back)
    assert back[-1, 0, 0] == pytest.approx(-side * 2e-3, rel=1e-6)  # it holds one side alone


def test_until_a_fault_the_motion_is_the_fault_free_one():
    force = 300.0 * np.sin(np.arange(300) / 7.0)
    fault_free = driven(rig(**DAMPED), force)
    for kind in ("break 0.1", "slip 1e-3", "collide 1e6"):
        found = driven(rig(f"specimen {kind} at 0.3", **DAMPED), force)
        np.testing.assert_allclose(found[:151], fault_free[:151], rtol=1e-9, atol=1e-9)
        assert np.abs(found - fault_free)[200:, 0].max() > 1e-4


def test_a_new_test_begins_with_a_fault_free_specimen():
    one = rig("specimen break 0.1 at 0.1", "specimen slip 1e-3 at 0.1", "supply scale 0.1 at 0.1")
    commands = np.sin(np.arange(200) / 7.0)
    np.testing.assert_array_equal(driven(one, commands), driven(one, commands))


def test_a_linear_frame_becomes_springs_that_add_up_to_it():
    axes = ("x", "y")
    specimen = Specimen.from_parameters(FRAME, axes, "")
    given = read_faults("y/specimen break 0.5 at 1", axes)
    found = failing_specimen(given, RigAxes.whole(axes), specimen)
    k = np.diag([spring.stiffness for spring in found.springs])
    np.testing.assert_allclose(found.deformation.T @ k @ found.deformation, specimen.stiffness)
    np.testing.assert_array_equal(found.stiffness, specimen.stiffness)
    given = read_faults("force flip at 1", axes)
    assert failing_specimen(given, RigAxes.whole(axes), specimen) is specimen


def test_a_storey_breaks():
    """All springs at an axis break: the force on the other then has its own spring alone."""
    frame = {f"specimen__{name}": value for name, value in FRAME.items()}
    values = {"actuator__kind": "ideal"} | frame
    one = rig("y/specimen break 0 at 0", axes=("x", "y"), **values)
    found = driven(one, np.tile([180.0, 0.0], (3000, 1)))
    assert found[-1, 0, 0] == pytest.approx(1e-3, rel=1e-3)  # 3.3e5 - 1.5e5 N/m to the ground
    assert abs(found[-1, 2, 1]) < 1e-3


STIFF = {"specimen__stiffness": 5e8, "specimen__damping": 1e5, "actuator__leakage": 1e-3}
FREE = {"specimen__stiffness": 1.0, "actuator__stroke": 9.0}


def test_a_lower_supply_takes_capacity_and_by_its_root_flow():
    fault_free, low = (), ("supply scale 0.49 at 0",)
    force = [driven(rig(*f, **STIFF), np.full(600, 1.0))[-1, 3, 0] for f in (fault_free, low)]
    assert force[0] == pytest.approx(20.7e6 * 1.1836e-3, rel=0.01)
    assert force[1] == pytest.approx(0.49 * force[0], rel=0.01)
    speed = [driven(rig(*f, **FREE), np.full(200, 1.0))[-1, 1, 0] for f in (fault_free, low)]
    assert speed[1] == pytest.approx(0.7 * speed[0], rel=1e-3)
