"""A controller of another package: kept within the valve's range, and seen through."""

import numpy as np
import pytest
from seft_msgs_py.errors import InputError
from seft_ros.force_controller.force_control import ControlInputs, LinearControl
from seft_ros.force_controller.methods import RegisteredControl

KNOWN = ControlInputs(axes=2, dt=0.002, voltage_limit=10.0)
ZERO = np.zeros((4, 2))


class Gain:
    """Proportional to the force error."""

    def __init__(self):
        self.obeyed = []
        self.resets = 0

    def reset(self):
        self.resets += 1

    def step(self, reference_force, state):
        return 0.1 * (reference_force - state[3])


class Knowing(Gain):
    def limited(self, drive):
        self.obeyed.append(drive.tolist())

    def linear(self):
        return LinearControl.of_error(
            np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), 0.1 * np.eye(2)
        )


def test_its_drive_is_cut_off_at_the_limit_and_it_is_reported():
    own = Knowing()
    control = RegisteredControl(lambda: own, "theirs", KNOWN)
    assert control.step(np.array([[[50.0, -20.0]]]), ZERO).tolist() == [5.0, -2.0]
    assert not control.limited
    assert control.step(np.array([[[500.0, -20.0]]]), ZERO).tolist() == [10.0, -2.0]
    assert control.limited
    assert own.obeyed == [[10.0, -2.0]]
    control.reset()
    assert not control.limited
    assert own.resets == 2  # once after it was tried


def test_one_that_does_not_want_to_know_of_limits_is_limited_all_the_same():
    control = RegisteredControl(Gain, "theirs", KNOWN)
    assert control.step(np.full((1, 1, 2), -1e4), ZERO).tolist() == [-10.0, -10.0]


def test_a_drive_of_the_wrong_shape_is_refused_before_a_test():
    class Wrong(Gain):
        def step(self, reference_force, state):
            return np.zeros((2, 1))

    with pytest.raises(InputError, match=r"drive of theirs has the shape \(2, 1\).*\(2,\)"):
        RegisteredControl(Wrong, "theirs", KNOWN)


def test_linear_is_its_own_or_reported_to_be_missing():
    found = RegisteredControl(Knowing, "theirs", KNOWN).linear()
    signals = np.arange(10.0)  # reference force, x, v, a, force
    np.testing.assert_allclose(found.d @ signals, 0.1 * (signals[:2] - signals[8:]))
    with pytest.raises(InputError, match=r"theirs has no linear\(\)"):
        RegisteredControl(Gain, "theirs", KNOWN).linear()
