import numpy as np
import pytest
from compensators import force_section
from seft_msgs_py.wire.topics import Timebase
from seft_ros.reference_force.reference_force_block import ReferenceForce


def block(axes=("x",), **values):
    """Block of these parameters; a double underscore stands for a dot."""
    return ReferenceForce.from_parameters(force_section(**values), axes, Timebase.from_rate(500))


def step(reference_force, ground_motion, acceleration):
    state = np.full((4, len(acceleration)), 1e9)  # only the acceleration may matter
    state[2] = acceleration
    return reference_force.step(np.array([ground_motion]), state)[0, 0]


@pytest.mark.parametrize(
    ("alpha", "ground", "measured", "eft", "seft"),
    [
        (0.0, 2.0, 7.0, -105.4, -105.4),
        (0.5, 2.0, 0.0, -158.1, -158.1),
        (0.5, 2.0, 4.0, -158.1, -158.1 - 105.4),
        (1.0, -1.0, 3.0, 105.4, 105.4 - 158.1),
    ],
)
def test_one_axis_by_hand(alpha, ground, measured, eft, seft):
    """Eq. 2.3: -(1 + alpha) m a_g; Eq. 2.5: the same less alpha m a."""
    for method, expected in (("eft", eft), ("seft", seft)):
        force = step(block(method=method, mass_ratio=alpha), [ground], [measured])
        np.testing.assert_allclose(force, [expected], rtol=1e-12)


def test_coupled_axes_by_hand():
    """M = [[4, 1], [1, 3]], alpha = 0.5: f = -1.5 M a_g - 0.5 M a."""
    mass = [4.0, 1.0, 1.0, 3.0]
    values = {"model__mass": mass, "model__stiffness": [1.0, 2.0], "mass_ratio": 0.5}
    eft = step(block(("x", "y"), method="eft", **values), [2.0, -2.0], [10.0, 20.0])
    seft = step(block(("x", "y"), **values), [2.0, -2.0], [10.0, 20.0])
    np.testing.assert_allclose(eft, [-9.0, 6.0])
    np.testing.assert_allclose(seft, [-9.0 - 30.0, 6.0 - 35.0])
