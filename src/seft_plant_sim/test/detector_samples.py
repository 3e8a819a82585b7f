"""Detectors of a rig of two axes, and samples for them."""

import numpy as np
from scipy.signal import lfilter
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.channels import Derivation
from seft_plant_sim.judge.detector_list import DETECTORS
from seft_plant_sim.judge.detector_step import begin_detectors, judge_sample
from seft_plant_sim.judge.detectors import VALID, KnownRig, detector_arrays

DT, N = 0.002, 2
NOISE = np.array([[1e-5, 2e-5], [2e-3, 1e-3], [0.1, 0.2], [5.0, 3.0]])
LIMITS = np.array([0.1, 1.0, 50.0, 2e4])
ACTUATOR = np.array([[0.02, 1e7, 2.0, 2e4], [0.03, 2e7, 3.0, 3e4]])
"""Flow gain, oil stiffness, leakage, capacity."""
PAST = np.array([[[0.7, 0.2, 0.1], [-90.0, 80.0, 10.0]], [[0.5, 0.4, 0.1], [-70.0, 50.0, 20.0]]])
MASS = np.array([[60.0, 5.0], [5.0, 40.0]])
STIFFNESS = np.array([[2e5, -3e4], [-3e4, 1e5]])


ZEROED = {"left": {name: [0.0] * N for name in CHANNELS}}


def detectors(warn_only=(), **changes):
    """Detectors that have begun, of two axes of which everything is known."""
    known = {
        **{"noise": NOISE, "limits": LIMITS, "ranges": np.zeros((4, N))},
        **{"steps": np.zeros((4, N)), "derivation": Derivation(0.0, 0.0)},
        **{"velocity_is_derived": changes.get("derivation", (0.0,))[0] > 0.0},
        **{"actuator": ACTUATOR, "past": PAST, "has_valve": True},
        **{"mass": MASS, "stiffness": STIFFNESS, "imposes": False},
        **{"largest_drive": 10.0, "waits": np.zeros(4, np.int64), "dt": DT, **changes},
    }
    p, state = detector_arrays(KnownRig(**known), warn_only, ZEROED)
    begin_detectors(p, state)
    return p, state


def numbers_of(state):
    """All that detectors and judge know, copied: bits of its records, but not the judge's room."""
    own = [*state[:-1], *(each for each in state.judge if each is not state.judge.room)]
    return [
        np.frombuffer(each.tobytes(), each.dtype.str[-2:] if not each.dtype.names else "i8")
        for each in own
    ]


def noise_of_a_rig(samples, seed=3, size=1.0):
    """Samples of sensors that see nothing but noise, and commands that are as small."""
    rng = np.random.default_rng(seed)
    return size * NOISE * rng.normal(size=(samples, 4, N)), 0.05 * rng.normal(size=(samples, N))


def detect(p, state, step, raw, drive=(0.0, 0.0)):
    """Judge a sample, and look for faults."""
    return judge_sample(p, state, step, raw, np.array(drive), np.empty((4, N)))


def shares_of(p, state, samples, commands, steps=None):
    """Part of its threshold that each detector sees at each sample, shape (N, D, n)."""
    found = []
    for place, step in enumerate(range(len(samples)) if steps is None else steps):
        state.shares[:] = 0.0
        drive = commands[place - 1] if place else np.zeros(N)
        assert detect(p, state, step, samples[place], drive) == VALID
        found.append(state.shares.copy())
    return np.array(found)


def faded(values, factor):
    return lfilter([1.0], [1.0, -factor], values, axis=0)


def largest_recent(values, factor):
    scale = factor ** np.arange(len(values))[:, np.newaxis]
    return np.maximum.accumulate(np.abs(values) / scale) * scale


def mean(values):
    return 0.5 * (values[1:] + values[:-1])


ALL = [one.name for one in DETECTORS]


def of_what(detector, axis):
    """Samples, and what is wrong in them from sample 60 on, that this detector alone should see.

    No single value is so wrong that it is replaced.
    """
    samples, commands = noise_of_a_rig(100, size=0.3)
    one, count = np.ones(40), np.arange(1.0, 41.0)
    what = {
        "displacement_velocity": {0: 5e-5 * count},
        "velocity_acceleration": {1: 5e-3 * count},
        "oil_balance": {4: 8.0 * one},  # of a valve that is stuck
        "force_jump": {  # a specimen breaks
            0: 15.0 * (DT * count) ** 2,
            1: 30.0 * DT * (count - 0.5),
            2: 30.0 * one,
        },
    }
    if detector == "force_jump":  # of a motion that does not stick
        samples[:, 0, axis] += 0.3 * DT * np.arange(100)
        samples[:, 1, axis] += 0.3
    for row, off in what[detector].items():
        if row < 4:
            samples[60:, row, axis] += off
        else:
            commands[60:, axis] += off
    return samples, commands
