"""The exact response of the whole structure, in SEFT and in EFT."""

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.whole_structure import reference_response
from structures_at_hand import NOTHING_COMPUTED

MASS = np.array([[60.0, 5.0, 0.0], [5.0, 45.0, -3.0], [0.0, -3.0, 30.0]])
DAMPING = np.array([[900.0, -200.0, 0.0], [-200.0, 700.0, -100.0], [0.0, -100.0, 300.0]])
STIFFNESS = np.array([[3.0e5, -1.0e5, 0.0], [-1.0e5, 2.5e5, -0.8e5], [0.0, -0.8e5, 0.9e5]])


def experiment(ratio, method, mass):
    """Experiment of three axes; the known mass is the true one unless it is given."""
    common = {"rate": 500.0, "axes": ["x", "y", "z"]}
    specimen = {"mass": MASS, "damping": DAMPING, "stiffness": STIFFNESS}
    specimen = {name: value.ravel().tolist() for name, value in specimen.items()}
    known = specimen if mass is None else specimen | {"mass": mass}
    reference_force = NOTHING_COMPUTED | {"method": method, "mass_ratio": ratio}
    reference_force |= {f"specimen.{name}": value for name, value in known.items()}
    rig = common | {f"simulated.specimen.{name}": value for name, value in specimen.items()}
    return Experiment({"reference_force": common | reference_force, "rig": rig})


@pytest.mark.parametrize("alpha", [0.0, 0.7, 5.0])
@pytest.mark.parametrize("mass", [None, [50.0, 40.0, 30.0]])
def test_coupled_axes_move_by_their_equation_and_the_force_is_that_of_the_method(alpha, mass):
    """Eq. 2.1 of the whole; the force moves what stands on the rig, and in EFT that is all.

    How it is integrated, see test_computed_substructure.py.
    """
    motion = np.random.default_rng(3).normal(size=(300, 3))
    known = MASS if mass is None else np.diag(mass)
    for method, ratio, whole in (("eft", 0.0, MASS), ("seft", alpha, MASS + alpha * known)):
        r = reference_response(experiment(ratio, method, mass), motion)
        own = r.velocity @ DAMPING + r.displacement @ STIFFNESS
        force = -motion @ whole if method == "eft" else r.acceleration @ MASS + own
        scale = np.abs(own).max()
        np.testing.assert_allclose((r.acceleration + motion) @ whole, -own, atol=1e-9 * scale)
        np.testing.assert_allclose(r.force, force, atol=1e-9 * np.abs(force).max())
