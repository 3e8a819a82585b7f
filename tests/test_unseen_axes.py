"""target_motion on rigs of 2 to 10 coupled axes that nobody has tuned anything for.

Masses, modes and what is computed are drawn; each actuator is sized in proportion to the mass that
it moves, as a laboratory does.
"""

import numpy as np
import pytest
from experiments_at_hand import error_of, load, simulated

pytestmark = pytest.mark.offline
FRAME = "three_storey_frame"
SHORT = ("ground_motion:synthetic.duration:=16.0", "ground_motion:peak_force:=250.0")
STRONG = "ground_motion:peak_force:=400.0"
KNOWN = load(config=FRAME)


def axes_and_seeds(seeds, at_once):
    """2 to 10 axes, each with some seeds; those that are not tried at once are thorough.

    Not each number between: the steps are compiled for each.
    """
    every = [(n, seed) for n in (2, 3, 6, 10) for seed in range(seeds)]
    rare = pytest.mark.thorough
    return [pytest.param(*one, marks=() if one in at_once else rare) for one in every]


def turned(rng, root):
    """Matrix whose columns are random directions in coordinates of unit mass."""
    return root @ np.linalg.qr(rng.normal(size=root.shape))[0]


def drawn(n, seed):
    """Overrides of a rig: 30 to 120 kg an axis, modes of 3 to 12 Hz with 2 to 6 % damping."""
    rng = np.random.default_rng([n, seed])
    mass = rng.uniform(30.0, 120.0, n)
    root = np.diag(np.sqrt(mass))
    w, damping = 2 * np.pi * rng.uniform(3.0, 12.0, n), rng.uniform(0.02, 0.06, n)
    modes = turned(rng, root)
    others = turned(rng, root)  # what is computed is coupled in another way
    stiffness, damping = ((modes * row) @ modes.T for row in (w**2, 2 * damping * w))
    computed = (others * rng.uniform(0.5, 1.5, n)) @ others.T
    stiffness, damping, computed = ((m + m.T) / 2 for m in (stiffness, damping, computed))
    specimen = {"mass": mass, "stiffness": stiffness, "damping": damping}
    return overrides(specimen, {"reference_force:computed.mass": computed})


def overrides(specimen, values):
    """Overrides of a specimen that is known, and of what else there is."""
    n = len(specimen["mass"])
    values |= {f"specimen.{name}": value for name, value in specimen.items()}
    oil = specimen["mass"] / 52.7 * KNOWN["force_controller"]["actuator.oil_stiffness"]
    values["actuator.oil_stiffness"] = oil
    lists = {name: np.ravel(value).tolist() for name, value in values.items()}
    names = "[" + ", ".join(f"axis_{index}" for index in range(n)) + "]"
    return f"axes:={names}", *(f"{name}:={value}" for name, value in lists.items())


def yielding(recording, springs):
    """Overrides of springs that yield at 0.6 of their largest deformation in a linear test."""
    deformation = recording.series["rig/state"].values[:, 0] @ springs.T
    return (
        "rig:simulated.specimen.kind:=bouc_wen",
        f"specimen.springs:={springs.ravel().tolist()}",
        f"rig:simulated.specimen.yield_displacement:={0.6 * np.abs(deformation).max():.5f}",
    )


@pytest.mark.parametrize(("n", "seed"), axes_and_seeds(3, at_once=[(3, 0)]))
def test_a_linear_rig_is_within_1_percent_of_the_whole_structure(n, seed):
    recording = simulated(load(*SHORT, *drawn(n, seed), config=FRAME))
    assert not recording.saturation
    assert error_of(recording) < 0.01


@pytest.mark.parametrize(("n", "seed"), axes_and_seeds(2, at_once=[(3, 0)]))
def test_a_rig_of_springs_that_yield_is_within_5_percent_of_the_whole_structure(n, seed):
    """Springs between the axes, each to those before it: K = D^T k D of its Cholesky factor.

    With force enough to stand out of the sensors' noise, which drifts of what yields add up.
    """
    words = *SHORT, *drawn(n, seed), STRONG
    recording = simulated(load(*words, config=FRAME))
    stiffness = recording.experiment["reference_force"]["specimen.stiffness"]
    factor = np.linalg.cholesky(np.reshape(stiffness, (n, n)))
    yields = yielding(recording, (factor / np.diag(factor)).T)
    recording = simulated(load(*words, *yields, config=FRAME))
    assert recording.trip is None
    assert error_of(recording) < 0.045
