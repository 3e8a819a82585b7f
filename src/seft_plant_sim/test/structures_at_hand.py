"""Structures that are drawn."""

import numpy as np

NOTHING_COMPUTED = {
    **dict.fromkeys((f"computed.{name}" for name in ("mass", "damping", "stiffness")), 0.0),
    "computed.internal": 0,
    "computed.influence": 0.0,
    "computed.model": "",
    "computed.settings": "",
    "computed.every": 1,
}
"""Parameters of reference_force without a computed substructure but the specimen's mass."""


def positive(rng, size, scale):
    """Symmetric positive definite matrix."""
    root = rng.normal(size=(size, size))
    return scale * (root @ root.T / size + 0.5 * np.eye(size))


def structure(rng, axes, internal):
    """Parameters of a specimen and of a computed substructure, coupled in everything."""
    size = axes + internal
    values = {
        "specimen.mass": positive(rng, axes, 50.0),
        "specimen.damping": positive(rng, axes, 400.0),
        "specimen.stiffness": positive(rng, axes, 2e5),
        "computed.mass": positive(rng, size, 40.0),
        "computed.damping": positive(rng, size, 200.0),
        "computed.stiffness": positive(rng, size, 1e5),
        "computed.internal": internal,
    }
    if internal:
        values["computed.influence"] = rng.normal(size=(internal, axes))
    return values


def as_lists(values):
    """Parameters as they are given, at a mass ratio of one."""
    lists = {name: np.ravel(value).tolist() for name, value in values.items()}
    return lists | {"computed.internal": values["computed.internal"], "mass_ratio": 1.0}
