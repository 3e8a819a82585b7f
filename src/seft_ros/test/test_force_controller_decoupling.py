"""The controller that inverts a specimen of several axes."""

import numpy as np
import pytest
from seft_msgs_py.errors import InputError
from seft_msgs_py.parameters import resolve
from seft_msgs_py.rigs import rigs_of
from seft_msgs_py.timebase import Timebase
from seft_ros.force_controller.block import ForceController
from seft_ros.force_controller.methods import force_control
from seft_ros.force_controller.parameters import TABLE

DT = 0.002
MASS = np.array([[50.0, 5.0, 0.0], [5.0, 80.0, 0.0], [0.0, 0.0, 30.0]])
STIFFNESS = np.array([[4e5, -2e5, 0.0], [-2e5, 5e5, -3e5], [0.0, -3e5, 3e5]])
DAMPING = 2.0 * MASS + 1e-3 * STIFFNESS  # of which no mode is coupled
SPECIMEN = {"mass": MASS, "damping": DAMPING, "stiffness": STIFFNESS}


def control(axes=("a", "b", "c"), rig=None, **values):
    given = {"method": "decoupling"}
    for name, value in {**SPECIMEN, **values}.items():
        key = f"specimen.{name}" if name in SPECIMEN else name
        given[key] = np.ravel(value).tolist() if np.ndim(value) else value
    section = resolve({"force_controller": TABLE}, {"force_controller": TABLE.check(given)})
    return force_control(section["force_controller"], axes, Timebase.from_rate(1 / DT), rig)


def response(linear, z, axes):
    """From force error to drive."""
    n = len(linear.a)
    by_force = linear.c @ np.linalg.solve(z * np.eye(n) - linear.a, linear.b) + linear.d
    return by_force[:, :axes]


@pytest.mark.parametrize(("hz", "within"), [(1e-3, 1e-6), (0.5, 1e-4), (4.0, 2e-3), (11.0, 0.02)])
def test_it_is_the_displacement_of_the_specimen_under_the_force_error(hz, within):
    linear = control(gain=[1.0, 2.0, 0.5], **{"specimen.gain": 700.0}).linear()
    s = 2j * np.pi * hz
    wanted = np.linalg.inv(MASS * s * s + DAMPING * s + STIFFNESS)
    wanted = 700.0 * np.diag([1.0, 2.0, 0.5]) @ wanted
    off = response(linear, np.exp(s * DT), 3) - wanted
    assert np.abs(off).max() < within * np.abs(wanted).max()


def test_its_poles_are_those_of_the_specimen():
    system = np.zeros((6, 6))
    system[:3, 3:] = np.eye(3)
    system[3:] = -np.linalg.solve(MASS, np.hstack([STIFFNESS, DAMPING]))
    poles = np.exp(np.linalg.eigvals(system) * DT)
    found = np.linalg.eigvals(control().linear().a)
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(poles), rtol=1e-8)


def test_of_the_papers_specimen_it_is_the_papers_controller():
    specimen = {"mass": 52.7, "damping": 17.14 * 52.7, "stiffness": 4002.0 * 52.7}
    found = control(("x",), **specimen).linear()
    paper = ForceController([([37.0], [1.0, 17.14, 4002.0])], 10.0, DT).linear()
    for hz in (0.1, 1.0, 5.0, 20.0):
        z = np.exp(2j * np.pi * hz * DT)
        np.testing.assert_allclose(response(found, z, 1), response(paper, z, 1), rtol=5e-3)


def test_at_the_valves_limit_it_does_not_wind_up():
    found = control()
    rest = np.zeros((4, 3))
    for _ in range(500):
        drive = found.step(np.array([1e5, 0.0, 0.0]), rest)
        assert np.abs(drive).max() <= 10.0
    assert found.limited
    for _ in range(1000):
        drive = found.step(np.zeros(3), rest)
    assert np.abs(drive).max() < 1.0  # the error alone would have opened valves by 700 V


def test_each_rig_inverts_its_own_part():
    axes = ("west/a", "west/b", "east/c")
    apart = STIFFNESS.copy()
    apart[1, 2] = apart[2, 1] = 0.0
    both = {"stiffness": apart, "damping": 1e-3 * apart}
    west, _ = rigs_of(axes)
    part = control(axes, west, **both).linear()
    whole = control(("a", "b", "c"), **both).linear()
    z = np.exp(0.1j)
    np.testing.assert_allclose(response(part, z, 2), response(whole, z, 3)[:2, :2], rtol=1e-9)
    with pytest.raises(InputError, match=r"specimen\.damping .* couples axes of different rigs"):
        control(axes, west)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"mass": 0.0}, "specimen.mass is 0, but method decoupling inverts the specimen"),
        ({"mass": [50.0, -1.0, 30.0]}, "mass must be positive"),
        ({"stiffness": -STIFFNESS}, r"specimen\.stiffness .* is negative for some deformation"),
        ({"damping": -DAMPING}, r"specimen\.damping .* is negative for some"),
        ({"stiffness": STIFFNESS + np.eye(3, k=1)}, "is not symmetric"),
        ({"stiffness": [1.0, 2.0]}, "2 values for 3 axes"),
    ],
)
def test_what_can_not_be_inverted_is_refused(values, told):
    with pytest.raises(InputError, match=told):
        control(**values)
