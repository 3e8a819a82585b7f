"""Compensation methods by name, and motions and states for them."""

import json

import numpy as np
from bare_rig import section_of
from seft_msgs_py.wire.topics import Timebase
from seft_ros.reference_force.compensation_methods import COMPENSATION_METHODS
from seft_ros.reference_force.reference_force_block import method_inputs
from seft_ros.reference_force.reference_force_parameters import REFERENCE_FORCE_TABLE

M, C, K, DT, DELAY = 52.7, 800.3, 2.11e5, 0.002, 0.0133


def force_section(**values):
    """Section of the table's defaults with changes; a double underscore stands for a dot."""
    given = {"specimen.mass": M, "specimen.stiffness": K} | values
    return section_of(REFERENCE_FORCE_TABLE, **given)


def compensator(method, axes=("x",), rate=500, settings=(), delay=DELAY, **values):
    """Compensator of these parameters, of its settings, and for a delay, with the loop's."""
    own = " ".join(f"'{name}={json.dumps(v)}'" for name, v in dict(settings).items())
    paper = {"axes": list(axes), "specimen__damping": C, "mass_ratio": 1.0}
    paper["actuator__delay"] = delay - 1.5 / rate
    method_words = {"compensation__method": method, "compensation__settings": own}
    section = force_section(**paper | method_words | values)
    return COMPENSATION_METHODS[method](method_inputs(section, axes, Timebase.from_rate(rate)))


def run(one, motion, states):
    """Forces of a test, shape (N, n)."""
    one.reset()
    window = 1 + one.preview
    return np.array([one.step(motion[k : k + window], y) for k, y in enumerate(states)])


def noise(axes, steps=300, seed=1):
    """Ground motion and states."""
    rng = np.random.default_rng(seed)
    scale = np.array([[1e-3], [0.1], [5.0], [300.0]])
    return rng.normal(0, 3, (steps + 50, axes)), rng.normal(0, 1, (steps, 4, axes)) * scale


def assert_axes_are_apart(method, **common):
    """Axes that are not coupled are tests of their own."""
    masses, stiffness = [52.7, 20.0, 300.0], [2.11e5, 9e4, 3e6]
    motion, states = noise(3, 900)
    states[:, 3] = np.roll(-motion[:900] * masses, 5, axis=0)
    both = {"specimen__mass": masses, "specimen__stiffness": stiffness}
    values = {**both, "mass_ratio": 0.4, **common}
    together = run(compensator(method, ("x", "y", "z"), **values), motion, states)
    for axis in range(3):
        own = values | {name: value[axis] for name, value in both.items()}
        one = slice(axis, axis + 1)
        alone = run(compensator(method, **own), motion[:, one], states[:, :, one])
        scale = np.abs(alone).max()
        np.testing.assert_allclose(together[:, one] / scale, alone / scale, atol=1e-9)


def assert_known_motion_is_all(method, delay, step):
    """Without a computed mass the force is that of the ground motion at the end of the delay."""
    motion, states = noise(1, 10)
    force = run(compensator(method, delay=delay, mass_ratio=0.0), motion, states)
    ahead = np.interp(step * DT + delay, DT * np.arange(len(motion)), motion[:, 0])
    assert np.isclose(force[step, 0], -M * ahead, rtol=1e-9, atol=1e-12)
