"""Response of a structure that is not linear, against its springs and the linear response."""

import numpy as np
import pytest
from bare_rig import FRAME, rig_section
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim import whole_structure
from seft_plant_sim.whole_structure import (
    RunningResponse,
    ShakenStructure,
    reference_response,
    response,
)
from springs_at_hand import LAWS
from structures_at_hand import NOTHING_COMPUTED

DT = 0.002
ONE = {"mass": 52.7, "damping": 500.0, "stiffness": 2.11e5}
laws = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
specimens = pytest.mark.parametrize("specimen", [ONE, FRAME], ids=["1 axis", "2 axes"])


def experiment(specimen):
    """Experiment of a simulated specimen whose mass is known."""
    count = len(np.atleast_1d(specimen["mass"]))
    common = {"rate": 500.0, "axes": ["x", "y"][:count]}
    rig = rig_section("specimen.", **specimen) | common
    known = {f"specimen.{name}": specimen[name] for name in ("mass", "damping", "stiffness")}
    reference_force = common | NOTHING_COMPUTED | {"method": "seft", "mass_ratio": 0.5} | known
    return Experiment({"reference_force": reference_force, "rig": rig})


def motion(count, axes, scale):
    """A few seconds of coloured noise, m/s^2."""
    time = DT * np.arange(count)[:, np.newaxis]
    rng = np.random.default_rng(5)
    swing = np.sin(2 * np.pi * 7.0 * time + np.arange(axes)) * np.exp(-((time - 0.4) ** 2) / 0.05)
    return scale * (swing + 0.1 * rng.normal(size=(count, axes)))


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


@laws
@specimens
def test_the_response_moves_by_the_forces_that_its_springs_have_along_its_path(specimen, law):
    """M (a + a_g) + C v + r = 0, and r is what `follow` gives along the displacement."""
    values = specimen | law | {"yield_displacement": 0.002, "hardening_ratio": 0.1}
    structure = whole_structure.tested_specimen(experiment(values))
    ground = motion(400, structure.axes, 15.0)
    x, v, a, force = response(structure, ground, DT)
    inertia = (a + ground) @ structure.mass
    np.testing.assert_allclose(inertia, -force - v @ structure.damping, atol=1e-7 * inertia.max())
    springs = zip(structure.springs, structure.deformation, strict=True)
    along = sum(np.outer(spring.follow(x @ row)[0], row) for spring, row in springs)
    # between samples the path turns a little later than its points say, and friction at once
    most = 0.06 if law["kind"] == "friction" else 0.01
    np.testing.assert_allclose(along, force, atol=most * np.abs(force).max())
    assert np.abs(x).max() > 0.0035  # it yields


@pytest.mark.parametrize("kind", ["bilinear", "bouc_wen"])
def test_piece_by_piece_the_response_of_what_yields_is_near(kind):
    yielding = experiment(ONE | {"kind": kind, "yield_displacement": 0.004})
    ground = 8.0 * np.sin(2.0 * np.pi * 5.0 * DT * np.arange(500))[:, np.newaxis]
    running = RunningResponse(yielding)
    assert not running.exact
    found = [running.advance(piece) for piece in np.split(ground, [70, 71, 300])]
    wanted, linear = (reference_response(each, ground) for each in (yielding, experiment(ONE)))
    assert np.abs(wanted.displacement - linear.displacement).max() > 0.004  # it does yield
    for index, quantity in enumerate((wanted.displacement, wanted.acceleration)):
        joined = np.concatenate([part[index] for part in found])
        np.testing.assert_allclose(joined, quantity, rtol=0.0, atol=0.02 * np.abs(quantity).max())
