"""Interlocks whose controllers are scripted, and samples that fit their targets."""

import math

import numpy as np
from seft_ros.force_controller.interlock import Interlock
from seft_ros.force_controller.target_distance import tracking_arrays

AXES = ("east", "north")
DT = 0.002
LIMIT = 10.0  # of the valve, V
NO_LIMITS = np.inf, np.inf, np.inf, 1000.0  # but of the force, N


def of_rig(sample, is_suspect=False, drive=0.0):
    """A sample of rig/state, shape (6, n), of one of four rows."""
    found = np.zeros((6, sample.shape[1]))
    found[:4], found[4], found[5] = sample, is_suspect, drive
    return found


def stepped(guarded, index, points, sample, is_suspect=False, drive=0.0):
    """Look at a sample of four rows, and step."""
    measured = of_rig(sample, is_suspect, drive)
    guarded.look(index, measured)
    return guarded.step(index, points, measured)


def tracking(noise=0.0, acts=True, axes=2, has_valve=True):
    """The detector of the distance to the target, of sensors with this noise; shape (4,)."""
    each = np.broadcast_to(np.reshape(noise, (-1, 1)), (4, axes))
    return tracking_arrays(each, LIMIT if has_valve else math.inf, acts, DT)


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


def watched(controller, axes=AXES, limits=NO_LIMITS, **words):
    """An interlock that closes the valve in five steps, and knows the sensors."""
    watching = tracking((1e-6, 1e-3, 1e-3, 1.0), axes=len(axes), **words)
    return Interlock(controller, axes, 0.02, 5 * DT, limits, watching, DT)


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
