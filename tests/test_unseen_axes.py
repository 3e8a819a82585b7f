"""preview_inverse on rigs of 2 to 10 coupled axes that nobody has tuned anything for.

Masses, modes and what is computed are drawn; each actuator is sized in proportion to the mass that
it moves, as a laboratory does, so that one identified response of the force loop holds for all.
Frames have modes far above what controllers of the axes bear: theirs inverts the frame.
"""

import numpy as np
import pytest
from graph_tools import ROOT, THOROUGH
from seft_msgs_py.experiment import Experiment
from seft_msgs_py.parameter_file import parse_override
from seft_ros.analysis.summary import summarise
from seft_ros.experiment.blocks import build_blocks
from seft_ros.experiment.offline import simulate
from seft_ros.experiment.tables import TABLES

FRAME = ROOT / "config" / "three_storey_frame.yaml"
SHORT = ("ground_motion:synthetic.duration:=16.0", "ground_motion:peak_force:=250.0")
KNOWN = Experiment.load(TABLES, [FRAME], [])


def axes_and_seeds(seeds, at_once):
    """2 to 10 axes, each with some seeds; those that are not tried at once are thorough."""
    every = [(n, seed) for n in range(2, 11) for seed in range(seeds)]
    return [pytest.param(*one, marks=() if one in at_once else THOROUGH) for one in every]


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
    specimen = {
        "mass": mass,
        "stiffness": modes @ np.diag(w**2) @ modes.T,
        "damping": modes @ np.diag(2 * damping * w) @ modes.T,
    }
    size = mass / KNOWN["reference_force"]["tracking.mass"]
    values = {
        "reference_force:computed.mass": others @ np.diag(rng.uniform(0.5, 1.5, n)) @ others.T,
        "rig:actuator.oil_stiffness": size * KNOWN["rig"]["actuator.oil_stiffness"],
        "force_controller:gain": 1.0 / size,
    }
    for name, value in specimen.items():
        values |= {f"{node}.{name}": value for node in ("rig:specimen", "reference_force:model")}
        values[f"reference_force:tracking.{name}"] = (
            size * KNOWN["reference_force"][f"tracking.{name}"]
        )
    lists = {
        name: ((v + v.T) / 2 if v.ndim > 1 else v).ravel().tolist() for name, v in values.items()
    }
    names = "[" + ", ".join(f"axis_{index}" for index in range(n)) + "]"
    return f"axes:={names}", *(f"{name}:={value}" for name, value in lists.items())


def yielding(record, springs):
    """Overrides of springs that yield at 0.6 of their largest deformation in a linear test."""
    deformation = record.series["rig/state"].values[:, 0] @ springs.T
    return (
        "rig:specimen.kind:=bouc_wen",
        f"rig:specimen.springs:={springs.ravel().tolist()}",
        f"rig:specimen.yield_displacement:={0.6 * np.abs(deformation).max():.5f}",
    )


def simulated(*words):
    experiment = Experiment.load(TABLES, [FRAME], [parse_override(word) for word in words])
    record = simulate(experiment, build_blocks(experiment))
    return record, summarise(record)


@pytest.mark.parametrize(("n", "seed"), axes_and_seeds(3, at_once=[(2, 0), (3, 0), (6, 0)]))
def test_a_linear_rig_is_within_2_percent_of_the_whole_structure(n, seed):
    _, summary = simulated(*SHORT, *drawn(n, seed))
    assert not summary["saturated"]
    assert summary["displacement"]["nrmse"] < 0.02


@pytest.mark.parametrize(("n", "seed"), axes_and_seeds(2, at_once=[(6, 0)]))
def test_a_rig_of_springs_that_yield_is_within_5_percent_of_the_whole_structure(n, seed):
    """Springs between the axes, each to those before it: K = D^T k D of its Cholesky factor.

    With force enough to stand out of the sensors' noise, which drifts of what yields add up.
    """
    words = *SHORT, *drawn(n, seed), "ground_motion:peak_force:=400.0"
    record, _ = simulated(*words)
    factor = np.linalg.cholesky(np.reshape(record.experiment["rig"]["specimen.stiffness"], (n, n)))
    yields = yielding(record, (factor / np.diag(factor)).T)
    _, summary = simulated(*words, *yields)
    assert summary["trip"] is None
    assert summary["displacement"]["nrmse"] < 0.05
