"""The exact response of the whole structure, against closed forms and an ODE solver."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.whole_structure import reference_response

M, C, K = 52.7, 903.5, 2.11e5
MASS = np.array([[60.0, 5.0, 0.0], [5.0, 45.0, -3.0], [0.0, -3.0, 30.0]])
DAMPING = np.array([[900.0, -200.0, 0.0], [-200.0, 700.0, -100.0], [0.0, -100.0, 300.0]])
STIFFNESS = np.array([[3.0e5, -1.0e5, 0.0], [-1.0e5, 2.5e5, -0.8e5], [0.0, -0.8e5, 0.9e5]])


def experiment(
    mass=M, damping=C, stiffness=K, *, ratio=0.0, method="seft", rate=500.0, model=None, rig=True
):
    """Experiment of a specimen; the model's mass is the specimen's unless it is given."""
    axes = [f"axis {index}" for index in range(np.atleast_2d(mass).shape[0])]
    common = {"rate": rate, "axes": axes}
    specimen = {"mass": mass, "damping": damping, "stiffness": stiffness}
    specimen = {name: np.ravel(value).tolist() for name, value in specimen.items()}
    reference_force = {"method": method, "mass_ratio": ratio}
    reference_force |= {f"model.{name}": value for name, value in specimen.items()}
    if model is not None:
        reference_force["model.mass"] = np.ravel(model).tolist()
    sections = {"reference_force": common | reference_force}
    if rig:
        sections["rig"] = common | {f"specimen.{name}": v for name, v in specimen.items()}
    return Experiment(sections)


def sdof(w, zeta, motion, dt):
    """Displacement of x'' + 2 zeta w x' + w^2 x = -a_g: superposed step and ramp responses."""
    wd = w * np.sqrt(1 - zeta**2)
    t = dt * np.arange(len(motion))
    after = np.maximum(t[:, np.newaxis] - t, 0.0)
    decay = np.exp(-zeta * w * after)
    cosine, sine = np.cos(wd * after), np.sin(wd * after)
    step = (1 - decay * (cosine + zeta * w / wd * sine)) / w**2
    swing = 2 * zeta / w * cosine + (2 * zeta**2 - 1) / wd * sine
    ramp = (after - 2 * zeta / w + decay * swing) / w**2
    slopes = np.diff(motion) / dt
    changes = np.diff(slopes, prepend=0.0)
    return -motion[0] * step[:, 0] - ramp[:, :-1] @ changes


@settings(max_examples=30)
@given(
    alpha=st.floats(0, 10),
    zeta=st.floats(0, 0.9),
    hz=st.floats(1, 100),
    rate=st.sampled_from([100.0, 500.0, 512.0]),
    motion=st.lists(st.floats(-20, 20), min_size=2, max_size=60),
    method=st.sampled_from(["eft", "seft"]),
)
def test_one_axis_is_the_superposition_of_ramp_responses(alpha, zeta, hz, rate, motion, method):
    w, whole = 2 * np.pi * hz, (1 + alpha) * M
    structure = experiment(
        damping=2 * zeta * w * whole, stiffness=w**2 * whole, ratio=alpha, method=method, rate=rate
    )
    motion = np.array(motion)
    expected = sdof(w, zeta, motion, 1 / rate)
    got = reference_response(structure, motion[:, np.newaxis]).displacement[:, 0]
    duration = len(motion) / rate
    scale = np.abs(motion).max() * min(1 / w**2, duration**2)
    np.testing.assert_allclose(got, expected, atol=1e-8 * scale + 1e-300)


def solved(mass, damping, stiffness, motion, dt):
    """(x, v) by `solve_ivp` from sample to sample, the motion linear in between."""
    n = len(mass)
    z, result = np.zeros(2 * n), [np.zeros(2 * n)]
    inverse = np.linalg.inv(mass)
    for start, end in itertools.pairwise(motion):

        def slope(t, z, start=start, end=end):
            ground = start + (end - start) * t / dt
            return np.concatenate(
                [z[n:], -ground - inverse @ (damping @ z[n:] + stiffness @ z[:n])]
            )

        z = solve_ivp(slope, (0.0, dt), z, "DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
        result.append(z)
    return np.array(result)


@pytest.mark.parametrize("method", ["eft", "seft"])
@pytest.mark.parametrize("model", [None, [50.0, 40.0, 30.0]])
def test_coupled_axes_agree_with_the_ode_solver(method, model):
    motion = np.random.default_rng(2).normal(size=(250, 3))
    structure = experiment(MASS, DAMPING, STIFFNESS, ratio=0.7, method=method, model=model)
    response = reference_response(structure, motion)
    known = MASS if model is None else np.diag(model)
    whole = 1.7 * known if method == "eft" else MASS + 0.7 * known
    expected = solved(whole, DAMPING, STIFFNESS, motion, 0.002)
    for got, reference in (
        (response.displacement, expected[:, :3]),
        (response.velocity, expected[:, 3:]),
    ):
        np.testing.assert_allclose(got, reference, atol=1e-9 * np.abs(reference).max())


@pytest.mark.parametrize("alpha", [0.0, 0.7, 5.0])
def test_the_force_moves_what_stands_on_the_rig_and_is_that_of_the_method(alpha):
    """f = m a + c v + k x on the rig: Eq. 2.4 with f of Eq. 2.5, or Eq. 2.2 with f of Eq. 2.3."""
    motion = np.random.default_rng(3).normal(size=(300, 3))
    for method, on_rig in (("seft", 1.0), ("eft", 1.0 + alpha)):
        r = reference_response(
            experiment(MASS, DAMPING, STIFFNESS, ratio=alpha, method=method), motion
        )
        force = r.acceleration @ (on_rig * MASS) + r.velocity @ DAMPING + r.displacement @ STIFFNESS
        fed_back = alpha * r.acceleration if method == "seft" else 0.0
        published = -((1 + alpha) * motion + fed_back) @ MASS
        scale = np.abs(force).max()
        np.testing.assert_allclose(r.force, force, atol=1e-9 * scale)
        np.testing.assert_allclose(r.force, published, atol=1e-9 * scale)


def test_without_a_simulated_rig_the_model_is_the_specimen():
    motion = np.random.default_rng(5).normal(size=(100, 3))
    parameters = {"ratio": 0.5, "mass": MASS, "damping": DAMPING, "stiffness": STIFFNESS}
    with_rig, without = (
        reference_response(experiment(**parameters, rig=rig), motion) for rig in (True, False)
    )
    np.testing.assert_array_equal(with_rig.displacement, without.displacement)
    np.testing.assert_array_equal(with_rig.force, without.force)


def test_every_sample_of_the_motion_has_a_response():
    for steps in (1, 2, 7):
        response = reference_response(experiment(), np.zeros((steps, 1)))
        for array in (response.displacement, response.velocity, response.acceleration):
            np.testing.assert_array_equal(array, np.zeros((steps, 1)))
