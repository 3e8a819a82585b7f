"""Interlocks whose controllers are scripted, and samples that fit their targets."""

import math

import numpy as np
from seft_plant_sim.judge.detectors import SUSPECT, detector_arrays
from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.interlock_step import DETECTED

AXES = ("east", "north")
DT = 0.002
NO_LIMITS = (np.inf,) * 4


def stepped(guarded, index, points, raw, is_suspect=False):
    """Judge a sample, and step; the detectors find it suspect."""
    judged = guarded.judge(index, np.vstack([raw, np.zeros(raw.shape[1])]))
    if is_suspect and not guarded.reason:
        guarded.state.flags[DETECTED] = SUSPECT
    return guarded.step(index, points, judged)


class Scripted:
    """A controller that notes what it is to answer, and answers step, 2 step, ... on its axes."""

    def __init__(self, points=4, rows=3):
        self.shape, self.limited, self.seen, self.drive = (points, rows), False, [], None

    def reset(self):
        self.seen.clear()

    def step(self, plan, sample):
        self.seen.append((plan.copy(), sample.copy()))
        n = sample.shape[1]
        return len(self.seen) * np.arange(1.0, 1 + n) if self.drive is None else self.drive


def watched(controller, axes=AXES, warn_only=(), of_position=1e-6):
    """An interlock that closes the valve in five steps, with detectors that know the sensors."""
    n = len(axes)
    noise = np.repeat([[of_position], [1e-3], [1e-3], [1.0]], n, axis=1)
    nothing, none = np.zeros((n, n)), np.zeros((4, n))
    unknown = np.zeros((n, 4)), np.zeros((n, 2, 2)), True, nothing, nothing, nothing
    detectors = detector_arrays(noise, np.ones(4), none, False, *unknown, warn_only, 10.0, DT)
    return Interlock(controller, axes, 1000.0, 0.02, 5 * DT, NO_LIMITS, detectors)


def left(taken):
    return 0.5 * (1.0 + math.cos(math.pi * taken / 5)) if taken < 5 else 0.0


SPEED = np.array([0.05, -0.03])


def sample_of(step, off=0.0, axis=1):
    """A sample of motion at a constant speed, with its displacement off by something."""
    found = np.array([SPEED * DT * step, SPEED, [0.0, 0.0], [20.0, 30.0]])
    found[0, axis] += off
    return found


def target_of(step, count=4):
    """Points of a target that does this and then speeds up, and whose force grows."""
    ahead = np.arange(count)[:, np.newaxis]
    motion = SPEED * DT * (step + ahead), SPEED * (1.0 + ahead), 20.0 + 3.0 * ahead + [step, 0.0]
    return np.stack(motion, axis=1)
