"""Springs as the rig's parameters make them, and paths for them."""

import itertools

import numpy as np
from bare_rig import rig_section
from seft_msgs_py.config.parameter_table import group
from seft_plant_sim.simulated.springs import make_springs

K, Y, A = 2.11e5, 0.004, 0.1
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
"""Parameters of specimens that yield, or are not linear, after their laws."""


def spring(kind, **values):
    """Spring of the table's defaults with changes; a double underscore stands for a dot."""
    values = {"yield_displacement": Y, "hardening_ratio": A} | values
    section = rig_section("specimen.", **values)
    (made,) = make_springs(kind, group(section, "simulated.specimen"), [K], "specimen")
    return made


def through(*turns, points=4000):
    """Path of deformation from one turning point to the next, in yield displacements."""
    parts = [np.linspace(a, b, points)[1:] for a, b in itertools.pairwise(turns)]
    return Y * np.concatenate([[turns[0]], *parts])


def hysteretic(made, path):
    """z along a path, m: s = a k e + (1 - a) k z."""
    force = made.follow(path)[0]
    return (force / K - A * path) / (1 - A)


def work(force, path):
    """Work done so far, J, by the trapezoidal rule."""
    done = np.cumsum((force[1:] + force[:-1]) / 2 * np.diff(path))
    return np.concatenate([[0.0], done])
