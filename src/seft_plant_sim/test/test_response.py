"""Response of a structure that is not linear, against an ODE solver and the linear response."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.parameter_table import resolve
from seft_plant_sim import whole_structure
from seft_plant_sim.rig_parameters import RIG_TABLE
from seft_plant_sim.whole_structure import ShakenStructure, reference_response, response

DT = 0.002
ONE = {"mass": 52.7, "damping": 500.0, "stiffness": 2.11e5}
FRAME = {
    "mass": [60.0, 45.0],
    "damping": [900.0, -200.0, -200.0, 400.0],
    "stiffness": [3.3e5, -1.5e5, -1.5e5, 1.5e5],
    "springs": [1.0, 0.0, -1.0, 1.0],
}
SMOOTH = {"bouc_wen.exponent": 1.7, "bouc_wen.beta": 0.7, "bouc_wen.gamma": 0.3}
LAWS = {
    "bilinear": {"kind": "bilinear"},
    "Bouc-Wen": {"kind": "bouc_wen"},
    "degrading": {"kind": "bouc_wen", "bouc_wen.strength_loss": 0.05} | SMOOTH,
    "pinching": {"kind": "pinching", "bouc_wen.strength_loss": 0.02} | SMOOTH,
    "flag": {"kind": "flag", "flag.dissipation": 0.7},
    "friction": {"kind": "friction", "friction.force": 150.0},
    "gap": {"kind": "gap", "gap.width": 0.002, "gap.stiffness": 8e5},
    "hardening": {"kind": "duffing", "duffing.cubic": 4e9},
    "softening": {"kind": "duffing", "duffing.cubic": -1.2e9},
}
laws = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def experiment(specimen, *, ratio=0.5, method="seft"):
    """Experiment of a simulated specimen; the model has its mass."""
    count = len(np.atleast_1d(specimen["mass"]))
    common = {"rate": 500.0, "axes": ["x", "y"][:count]}
    given = {f"specimen.{name}": value for name, value in specimen.items()}
    rig = common | resolve({"rig": RIG_TABLE}, {"rig": RIG_TABLE.check(given)})["rig"] | common
    model = {f"model.{name}": specimen[name] for name in ("mass", "damping", "stiffness")}
    reference_force = common | {"method": method, "mass_ratio": ratio} | model
    return Experiment({"reference_force": reference_force, "rig": rig})


def motion(count, axes, scale):
    """A few seconds of coloured noise, m/s^2."""
    time = DT * np.arange(count)[:, np.newaxis]
    rng = np.random.default_rng(5)
    swing = np.sin(2 * np.pi * 7.0 * time + np.arange(axes)) * np.exp(-((time - 0.4) ** 2) / 0.05)
    return scale * (swing + 0.1 * rng.normal(size=(count, axes)))


def restoring(law, k, e, z, yields, a):
    """Force of springs, by hand."""
    kind = law["kind"]
    if kind == "gap":
        beyond = np.maximum(np.abs(e) - law["gap.width"], 0.0)
        return k * e + law["gap.stiffness"] * np.sign(e) * beyond
    if kind == "duffing":
        k_3 = law["duffing.cubic"]
        held = e if k_3 > 0 else np.clip(e, -np.sqrt(-k / 3 / k_3), np.sqrt(-k / 3 / k_3))
        return k * held + k_3 * held**3
    if kind == "friction":
        return k * e + law["friction.force"] * z / 2e-5
    return k * (a * e + (1 - a) * z)


def z_rates(law, e, e_rate, z, energy, yields):
    """Rate of the hysteretic displacements, by hand."""
    kind = law["kind"]
    if kind in ("bouc_wen", "pinching"):
        exponent, beta, gamma = (
            law.get(f"bouc_wen.{name}", default)
            for name, default in (("exponent", 1.0), ("beta", 0.5), ("gamma", 0.5))
        )
        power = np.abs(z / yields) ** exponent
        shape = beta * np.sign(z * e_rate) + gamma
        phi = 1 - (1 + law.get("bouc_wen.strength_loss", 0.0) * energy) * shape * power
        slip = yields * (1 - np.exp(-0.1 * energy)) if kind == "pinching" else 0.0
        width = 0.15 * yields
        f = np.sqrt(2 / np.pi) * slip / width * np.exp(-0.5 * (z / width) ** 2)
        return e_rate * phi / (1 + f * phi)
    end = 2e-5 if kind == "friction" else yields
    high, low, follows = end, -end, np.zeros(len(z), bool)
    if kind == "flag":
        lower = (1 - law["flag.dissipation"]) * end
        high, low = np.clip(e, -lower, end), np.clip(e, -end, lower)
        follows = ((e_rate > 0) & (e > -lower) & (e < end)) | (
            (e_rate < 0) & (e < lower) & (e > -end)
        )
    held = (z >= high) & (e_rate > 0) | (z <= low) & (e_rate < 0)
    return np.where(held & ~follows, 0.0, e_rate)


def solved(specimen, law, ground, ratio, yields, hardening):
    """x and v by hand, in steps so short that the solver takes none for smooth that has a knee."""
    n = ground.shape[1]
    mass = (1 + ratio) * np.diag(np.atleast_1d(specimen["mass"]).astype(float))
    damping = np.reshape(specimen["damping"], (n, n))
    k, d = ([1.8e5, 1.5e5], [[1.0, 0.0], [-1.0, 1.0]]) if n == 2 else ([2.11e5], [[1.0]])
    k, d = np.array(k), np.array(d)
    p = len(k)

    def slope(t, state, start, change):
        x, v, z, energy = np.split(state, [n, 2 * n, 2 * n + p])
        e, e_rate = d @ x, d @ v
        force = d.T @ restoring(law, k, e, z, yields, hardening)
        acceleration = np.linalg.solve(mass, -damping @ v - force) - start - change * t / DT
        work = (1 - hardening) * z * e_rate / yields**2
        return np.concatenate([v, acceleration, z_rates(law, e, e_rate, z, energy, yields), work])

    state, result = np.zeros(2 * n + 2 * p), [np.zeros(2 * n)]
    for begin, end in itertools.pairwise(ground):
        state = solve_ivp(
            slope,
            (0, DT),
            state,
            "RK45",
            args=(begin, end - begin),
            rtol=1e-9,
            atol=1e-13,
            max_step=DT / 8,
        ).y[:, -1]
        result.append(state[: 2 * n])
    return np.array(result)


@laws
@pytest.mark.parametrize("specimen", [ONE, FRAME], ids=["1 axis", "2 axes"])
def test_the_response_is_that_of_the_equations_by_hand(specimen, law):
    values = specimen | law | {"yield_displacement": 0.002, "hardening_ratio": 0.1}
    ground = motion(350, len(np.atleast_1d(specimen["mass"])), 15.0)
    response = reference_response(experiment(values), ground)
    expected = solved(specimen, law, ground, 0.5, 0.002, 0.1)
    got = np.hstack([response.displacement, response.velocity])
    error = np.abs(got - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert error.max() < 1e-5
    assert np.abs(response.displacement).max() > 0.004  # it yields


@pytest.mark.parametrize("law", [law for name, law in LAWS.items() if name != "friction"])
@pytest.mark.parametrize("specimen", [ONE, FRAME], ids=["1 axis", "2 axes"])
def test_a_tiny_motion_has_the_linear_response(specimen, law):
    ground = motion(300, len(np.atleast_1d(specimen["mass"])), 1e-6)
    bent, linear = (
        reference_response(experiment(specimen | kind), ground)
        for kind in (law | {"yield_displacement": 0.01}, {})
    )
    for name in ("displacement", "velocity", "acceleration", "force"):
        exact = getattr(linear, name)
        np.testing.assert_allclose(getattr(bent, name), exact, atol=2e-5 * np.abs(exact).max())


def test_a_bilinear_structure_that_does_not_yield_is_linear_to_the_end():
    ground = np.random.default_rng(8).normal(size=(3000, 1))
    values = ONE | {"kind": "bilinear", "yield_displacement": 0.01}
    bent, linear = (reference_response(experiment(v), ground) for v in (values, ONE))
    peak = np.abs(linear.displacement).max()
    assert peak < 0.01
    np.testing.assert_allclose(bent.displacement, linear.displacement, atol=1e-6 * peak)


@pytest.mark.parametrize("law", LAWS)
def test_steps_half_as_long_leave_a_quarter_of_the_error(law):
    """Knees, gaps and turns between the steps cost no more than smooth parts do."""
    values = ONE | LAWS[law] | {"yield_displacement": 0.002}
    structure, ground = whole_structure.tested_specimen(experiment(values)), motion(350, 1, 15.0)
    exact = ShakenStructure(structure, DT, 2048).advance(ground)[:2]
    errors = [
        np.sqrt(np.mean((ShakenStructure(structure, DT, steps).advance(ground)[:2] - exact) ** 2))
        for steps in (8, 128)
    ]
    assert errors[1] < errors[0] / 100
    found = response(structure, ground, DT)[:2]
    peak = np.abs(exact).max(axis=(1, 2), keepdims=True)
    assert (np.abs(found - exact) / peak).max() < 1e-5


def test_the_spring_forces_are_those_along_the_path_of_the_response():
    """The force that is returned, and `follow` along the displacement, know of each other."""
    law = {"kind": "bilinear", "yield_displacement": 0.002}
    structure = whole_structure.tested_specimen(experiment(ONE | law))
    x, _, _, force = response(structure, motion(400, 1, 15.0), DT)
    (spring,) = structure.springs
    along = spring.follow(x[:, 0])[0]
    # between samples the path turns a little later than its points say
    np.testing.assert_allclose(along, force[:, 0], atol=0.01 * np.abs(force).max())


@pytest.mark.parametrize("method", ["eft", "seft"])
def test_the_force_moves_what_stands_on_the_rig_and_is_that_of_the_method(method):
    """f = m a + c v + r(x) on the rig, and f_r of Eq. 2.3 or 2.5, whatever r is."""
    law = {"kind": "bouc_wen", "yield_displacement": 0.001} | SMOOTH
    ground = motion(200, 1, 15.0)
    test = experiment(ONE | law, ratio=0.7, method=method)
    r = reference_response(test, ground)
    on_rig = 52.7 * (1.7 if method == "eft" else 1.0)
    whole = whole_structure.tested_specimen(test)
    (spring,) = whole.springs
    restoring = r.force - on_rig * r.acceleration - 500.0 * r.velocity
    limit = 2.11e5 * (0.05 * np.abs(r.displacement) + 0.95 * 0.001)
    assert (np.abs(restoring) <= limit * (1 + 1e-9)).all()
    assert np.abs(restoring).max() > 0.9 * spring.stiffness * 0.001
    fed_back = 0.7 * r.acceleration if method == "seft" else 0.0
    published = -52.7 * (1.7 * ground + fed_back)
    np.testing.assert_allclose(r.force, published, atol=1e-9 * np.abs(published).max())


def test_a_structure_at_rest_stays_at_rest():
    law = {"kind": "bilinear", "yield_displacement": 0.001}
    for count in (1, 2, 5):
        response = reference_response(experiment(ONE | law), np.zeros((count, 1)))
        np.testing.assert_array_equal(response.displacement, np.zeros((count, 1)))
        np.testing.assert_array_equal(response.force, np.zeros((count, 1)))
