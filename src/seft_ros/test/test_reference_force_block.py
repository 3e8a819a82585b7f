import numpy as np
import pytest
from compensators import M, force_section
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.topics import Timebase, rigs_of
from seft_ros.reference_force.reference_force_block import ReferenceForce, StateGathering


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
    """Eq. 2.3: -(1 + alpha) m a_g, all of it on the rig; Eq. 2.5: the same less alpha m a."""
    whole = block(method="eft", specimen__mass=(1.0 + alpha) * M)
    for one, expected in ((whole, eft), (block(mass_ratio=alpha), seft)):
        np.testing.assert_allclose(step(one, [ground], [measured]), [expected], rtol=1e-12)


def test_coupled_axes_by_hand():
    """M = [[4, 1], [1, 3]], alpha = 0.5: f = -1.5 M a_g - 0.5 M a."""
    mass, values = np.array([4.0, 1.0, 1.0, 3.0]), {"specimen__stiffness": [1.0, 2.0]}
    whole = block(("x", "y"), method="eft", specimen__mass=(1.5 * mass).tolist(), **values)
    part = block(("x", "y"), specimen__mass=mass.tolist(), mass_ratio=0.5, **values)
    eft, seft = (step(one, [2.0, -2.0], [10.0, 20.0]) for one in (whole, part))
    np.testing.assert_allclose(eft, [-9.0, 6.0])
    np.testing.assert_allclose(seft, [-9.0 - 30.0, 6.0 - 35.0])


def test_in_conventional_eft_nothing_is_computed():
    with pytest.raises(InputError, match=r"mass_ratio is 0.5, but with method eft nothing is comp"):
        block(method="eft", mass_ratio=0.5)


RIGS = rigs_of(["west/x", "east/x", "west/y"])
WEST, EAST = np.arange(8.0).reshape(4, 2), -np.ones((4, 1))


def test_a_step_is_complete_when_all_have_sent_it():
    gathering = StateGathering(RIGS, 0.01)
    assert gathering.take(0, 0, WEST, 0.0) is None
    assert gathering.is_waiting
    whole = gathering.take(1, 0, EAST, 0.001)
    np.testing.assert_array_equal(whole, np.column_stack([WEST[:, 0], EAST, WEST[:, 1]]))
    assert not gathering.is_waiting


def test_a_complete_step_ends_the_waiting_for_those_before():
    gathering = StateGathering(RIGS, 0.01)
    assert gathering.take(0, 0, WEST, 0.0) is None
    assert gathering.take(0, 1, WEST, 0.002) is None
    assert gathering.take(1, 1, EAST, 0.003) is not None
    assert not gathering.is_waiting
    assert gathering.lost(100.0) == ""


def test_who_fails_to_send_is_named():
    gathering = StateGathering(RIGS, 0.01)
    gathering.take(0, 0, WEST, 5.0)
    assert gathering.lost(5.01) == ""
    expected = "no rig/state of east for 0.01 s (none has arrived; west is at step 0)"
    assert expected in gathering.lost(6)
    gathering.take(1, 0, EAST, 6.0)
    gathering.take(1, 1, EAST, 7.0)
    assert "of west for 0.01 s (the last is of step 0; east is at step 1)" in gathering.lost(8.0)
    gathering.reset()
    assert gathering.lost(9.0) == ""


def test_a_second_state_of_a_step_is_refused():
    gathering = StateGathering(RIGS, 0.01)
    gathering.take(0, 3, WEST, 0.0)
    with pytest.raises(WireError, match="state of step 3 of west a second time"):
        gathering.take(0, 3, WEST, 0.0)
