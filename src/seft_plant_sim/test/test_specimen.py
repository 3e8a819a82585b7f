import numpy as np
import pytest
from bare_rig import rig_section
from hypothesis import given
from hypothesis import strategies as st
from seft_msgs_py.config.parameter_table import group
from seft_msgs_py.errors import InputError
from seft_plant_sim.simulated.specimen import Specimen
from seft_plant_sim.simulated.springs import HYSTERETIC, SPRING_BESIDE, Z_Y

STOREYS = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])  # of a shear frame


def specimen(axes=("x",), **values):
    """Specimen of the table's defaults with changes; a double underscore stands for a dot."""
    section = rig_section("specimen.", **values)
    return Specimen.from_parameters(group(section, "simulated.specimen"), axes, "specimen")


def test_each_axis_has_a_spring_to_the_ground_unless_springs_are_given():
    values = {"stiffness": [100.0, 200.0], "yield_displacement": [0.01, 0.02]}
    pair = specimen(("x", "y"), kind="bilinear", **values)
    np.testing.assert_allclose([s.stiffness for s in pair.springs], [100.0, 200.0])
    np.testing.assert_allclose([s.law[Z_Y] for s in pair.springs], [0.01, 0.02])
    np.testing.assert_allclose([s.law[SPRING_BESIDE] for s in pair.springs], [5.0, 10.0])
    np.testing.assert_allclose([s.law[HYSTERETIC] for s in pair.springs], [95.0, 190.0])
    assert pair.deformation.tolist() == np.eye(2).tolist()


@given(st.lists(st.floats(1e2, 1e7), min_size=3, max_size=3))
def test_storeys_of_a_shear_frame_are_found_in_its_stiffness(storeys):
    stiffness = STOREYS.T @ np.diag(storeys) @ STOREYS
    values = {"stiffness": stiffness.ravel().tolist(), "springs": STOREYS.ravel().tolist()}
    frame = specimen(("1", "2", "3"), kind="bilinear", yield_displacement=0.01, **values)
    found = [spring.stiffness for spring in frame.springs]
    np.testing.assert_allclose(found, storeys, rtol=1e-6, atol=1e-9 * max(storeys))
    assert frame.deformation.tolist() == STOREYS.tolist()


def test_springs_may_be_more_than_axes():
    springs = [1.0, 0.0, 0.0, 1.0, 1.0, -1.0]  # two to the ground, one in between
    values = {"stiffness": [300.0, -200.0, -200.0, 700.0], "springs": springs}
    yields = [0.01, 0.02, 0.03]
    pair = specimen(("x", "y"), kind="bilinear", yield_displacement=yields, **values)
    np.testing.assert_allclose([s.stiffness for s in pair.springs], [100.0, 500.0, 200.0])
    assert [s.law[Z_Y] for s in pair.springs] == [0.01, 0.02, 0.03]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"yield_displacement": 0.0},
            r"specimen\.yield_displacement is 0.0, but a bilinear specimen yields: give the dis",
        ),
        ({"yield_displacement": [0.01, 0.0]}, r"yield_displacement is \[0.01, 0.0\], but"),
        ({"yield_displacement": [1.0, 2.0, 3.0]}, "t: 3 values for 2 springs; give 1 or 2"),
        (
            {"springs": [1.0, 0.0, 1.0]},
            r"specimen\.springs: 3 values for 2 axes \[x, y\]; give 2 for each spring",
        ),
        (
            {"stiffness": [3.0, -1.0, -1.0, 2.0]},
            r"specimen\.stiffness \[\[3.0, -1.0\], \[-1.0, 2.0\]\] is not what springs with the "
            r"deformations \[\[1.0, 0.0\], \[0.0, 1.0\]\] add up to; name the springs in",
        ),
        (
            # of a spring of -1 N/m in between
            {"stiffness": [-1.0, 1.0, 1.0, -1.0], "springs": [1.0, -1.0]},
            r"specimen\.stiffness gives springs of \[-1.0\] N/m, but they must be posit",
        ),
        (
            {"stiffness": [1.0, 1.0, 1.0, 1.0], "springs": [1.0, 0.0, 0.0, 1.0, 1.0, -1.0]},
            r"gives springs of \[2.0, 2.0, -1.0\] N/m, but they must be positive; correct",
        ),
    ],
)
def test_what_makes_no_hysteretic_specimen_is_refused_by_name(values, message):
    with pytest.raises(InputError, match=message):
        specimen(("x", "y"), kind="bilinear", **{"yield_displacement": 0.01} | values)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("friction", r"specimen\.friction\.force is 0.0, but a friction specimen has friction"),
        ("gap", r"specimen\.gap\.stiffness is 0.0, but a gap specimen has a second spring: give"),
        ("flag", r"specimen\.yield_displacement is 0.0, but a flag specimen yields: give the"),
    ],
)
def test_what_a_kind_needs_is_asked_for(kind, message):
    with pytest.raises(InputError, match=message):
        specimen(kind=kind)


def test_bouc_wen_springs_must_yield_at_some_force():
    values = {"kind": "bouc_wen", "yield_displacement": 0.01, "bouc_wen__beta": 0.2}
    with pytest.raises(InputError, match=r"bouc_wen: beta 0.2 and gamma -0.2 must add up to more"):
        specimen(**values, bouc_wen__gamma=-0.2)
