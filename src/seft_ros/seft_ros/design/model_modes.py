"""Modes of a whole structure with a computed model that has masses of its own.

Such a model is known by its steps alone, so that its modes are found in a free vibration: poles of
the realisation that the vibration has (Juang & Pappa 1985).
"""

from contextlib import closing

import numpy as np
from scipy.linalg import eigh
from seft_msgs_py.arrays import Complexes, Floats
from seft_plant_sim.computed.computed_model import SMALL_DISPLACEMENT
from seft_plant_sim.whole_structure import ModelledStructure, WholeStructure

SEEN_PERIODS = 6.0
"""Of the slowest mode with the model's tangents at rest, in which the vibration is seen: a model of
slower modes shows at least one period of those."""
SAMPLES_PER_PERIOD = 40
"""Of the fastest mode of the axes, in one of its periods: every so many steps one is used."""
PULSE_SAMPLES = 4
"""Samples of the ground motion that begins the vibration."""
ROWS, LONGEST = 30, 600
"""Samples in a column of the Hankel matrix, at least, and values, at most."""
PRESENT = 1e-4
"""Singular value over the largest one, from which on a state is there: what steps and small
nonlinearities make is below."""


def modes_with_model(whole: WholeStructure, dt: float) -> Complexes:
    """Poles of the oscillating modes that the axes show, lowest first, 1/s.

    Parameters
    ----------
    whole : WholeStructure
        With a computed model.
    dt : float
        Period of a step of the model, s.
    """
    model, structure = whole.computed.model, whole.structure
    assert model is not None
    squares = eigh(structure.stiffness, structure.mass, eigvals_only=True)
    slowest, fastest = np.sqrt(squares[squares > 0.0][[0, -1]])
    every = max(1, int(2.0 * np.pi / (fastest * SAMPLES_PER_PERIOD * dt)))
    seen = int(SEEN_PERIODS * 2.0 * np.pi / (slowest * every * dt))
    count = PULSE_SAMPLES + every * max(seen, 4 * ROWS)
    ground = np.zeros((count, structure.axes))
    # the axes differ, so that each mode moves
    ground[:PULSE_SAMPLES] = np.linspace(1.0, 1.7, structure.axes)
    impulse = slowest / (PULSE_SAMPLES * dt)  # of a displacement of 1
    ground *= SMALL_DISPLACEMENT * impulse
    with closing(ModelledStructure(structure, dt, 1, model)) as modelled:
        moved = modelled.advance(ground)[0]
    return _poles(moved[PULSE_SAMPLES::every], every * dt)


def _poles(free: Floats, dt: float) -> Complexes:
    """Poles of a free vibration, shape (N, m), whose modes all decay or oscillate."""
    axes = free.shape[1]
    rows = max(ROWS, min(len(free) // 3, LONGEST // axes))
    columns = len(free) - rows
    at = np.arange(rows)[:, np.newaxis] + np.arange(columns)
    blocks = np.moveaxis(free[at], 2, 1).reshape(-1, columns)  # rows x axes
    left, sizes, _ = np.linalg.svd(blocks, full_matrices=False)
    left = left[:, sizes > PRESENT * sizes[0]]
    shift = np.linalg.lstsq(left[:-axes], left[axes:], rcond=None)[0]
    z = np.linalg.eigvals(shift)
    s: Complexes = np.log(z[z.imag > 0.0]).astype(np.complex128) / dt
    oscillating: Complexes = s[(-s.real < np.abs(s)) & (s.imag * dt < np.pi / 2.0)]
    return oscillating[np.argsort(np.abs(oscillating))]
