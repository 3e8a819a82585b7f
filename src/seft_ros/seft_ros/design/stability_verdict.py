"""Verdict on a planned test: its margins, and the modes of the structure in the test."""

from contextlib import closing
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import linear_sum_assignment
from seft_msgs_py.arrays import Complexes, Floats
from seft_plant_sim.computed.computed_model import SMALL_DISPLACEMENT
from seft_plant_sim.whole_structure import ModelledStructure, WholeStructure

from seft_ros.design import stability_margins as margin
from seft_ros.design.planned_tests import PlannedTest
from seft_ros.design.plant import lightly_damped, roots_of

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

    A computed model with masses of its own is known by its steps alone, so that its modes are found
    in a free vibration: poles of the realisation that the vibration has (Juang & Pappa 1985).

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
    z = np.linalg.eigvals(np.linalg.lstsq(left[:-axes], left[axes:], rcond=None)[0])
    s: Complexes = np.log(z[z.imag > 0.0]).astype(np.complex128) / dt
    oscillating: Complexes = s[(-s.real < np.abs(s)) & (s.imag * dt < np.pi / 2.0)]
    return oscillating[np.argsort(np.abs(oscillating))]


NEAR = 2.0
"""A mode of the loop is matched with one of the structure within this factor in frequency."""
_UNFIT = 1e6


@dataclass(frozen=True)
class Mode:
    """A mode of the whole structure, and in the test.

    Attributes
    ----------
    exact_hz, exact_damping, hz, damping : float
        Natural frequency in Hz and damping ratio of the structure, and of the test.
    false_damping : float
        What the test adds to the damping ratio.
    frequency_error : float
        Relative error of the natural frequency. What is of the test is None where the loop does not
        have the mode: that of a computed model with masses of its own.
    """

    exact_hz: float
    exact_damping: float
    hz: float | None = None
    damping: float | None = None
    false_damping: float | None = None
    frequency_error: float | None = None

    @classmethod
    def of_poles(cls, exact: complex, test: complex | None = None) -> "Mode":
        """Compare a pole of the structure with that in the test, if there is one, 1/s."""
        exact_hz, exact_damping = abs(exact) / (2 * np.pi), -exact.real / abs(exact)
        if test is None:
            return cls(exact_hz, exact_damping)
        hz, damping = abs(test) / (2 * np.pi), -test.real / abs(test)
        return cls(exact_hz, exact_damping, hz, damping, damping - exact_damping, hz / exact_hz - 1)


def predicted_modes(planned_test: PlannedTest) -> list[Mode]:
    """Modes of the whole structure beside those of the loop, lowest first.

    A mode is matched with the eigenvalue of the loop, near it in frequency, through which the
    ground motion moves the mode's shape most: the residue over the distance from the unit
    circle; each eigenvalue is matched once. Overdamped modes, and those that the loop does not
    show, are left out. If the method adapts to the specimen, the loop is that with the restoring
    force as measured. A computed model with masses of its own is a tangent in the loop, so that
    the structure's modes stand alone, see `modes_with_model`.
    """
    tested = WholeStructure.of_test(
        planned_test.rig.specimen, planned_test.section, planned_test.axes
    )
    whole, model = tested.structure, tested.computed.model
    if model is not None and not model.probed.is_static:
        found = modes_with_model(tested, model.every * planned_test.dt)
        return [Mode.of_poles(complex(pole)) for pole in found]
    n = len(planned_test.axes)
    _, shapes = eigh(whole.stiffness, whole.mass)
    poles = np.linalg.eigvals(whole.state_matrices()[0])
    exact = sorted(poles[poles.imag > 0], key=abs)
    if len(exact) < whole.axes:  # then shapes can't be matched by order
        return []
    z, residues = planned_test.loops()[-1].modes()
    upper = (z.imag > 0) & (np.abs(z) > 0.1)
    z, residues = z[upper], residues[upper]
    s = np.log(z) / planned_test.dt
    distance = np.abs(np.log(np.abs(s) / np.abs(exact)[:, np.newaxis]))
    weights = shapes[:n].T @ whole.mass[:n, :n]  # as far as a test measures a shape
    moved = np.linalg.norm(np.einsum("mi,pij->mpj", weights, residues), axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        fitness = np.log(moved / np.maximum(np.abs(1 - np.abs(z)), 1e-12)) - distance
    fits = (distance < np.log(NEAR)) & np.isfinite(fitness)
    pairs = zip(*linear_sum_assignment(np.where(fits, -fitness, _UNFIT)), strict=True)
    return [Mode.of_poles(exact[m], s[p]) for m, p in pairs if fits[m, p]]


_Verdict = Literal["stable", "marginal", "unstable"]

LINEAR = "Exact eigenvalues of the sampled closed loop."
SMALL_SIGNAL = (
    "The rig is not linear: exact eigenvalues of its limit for small motions. They do not include "
    "valve flow, friction, stops and yielding; seft simulate shows their effect."
)
IDENTIFIED = (
    "Exact eigenvalues for the identified plant: as good as its fit, within the band of the "
    "identification."
)
ADAPTIVE = (
    "The method adapts: this holds as long as its estimates stay near those at the start, and does "
    "not promise that they do, nor that the test is stable while they change."
)
FOLLOWS = (
    "The method follows the specimen: all numbers are the worse of the loops at the start and with "
    "the restoring force as measured, and do not cover the time while an estimate changes."
)


@dataclass(frozen=True)
class Preflight:
    """Verdict on a test before anything moves.

    Attributes
    ----------
    verdict : str
        ``unstable``: it oscillates; ``marginal``: stable, but a margin is below its reserve.
    reasons : list of str
        Why it is not ``stable``; empty if it is.
    promise : str
        Validity of the result.
    margins : Margins
        How far it is from instability.
    ends : list of MarginEnd
        The same, beside what a stable verdict needs.
    modes : list of Mode
        Of the whole structure in the test, lowest first; none if it is unstable: what grows has no
        damping in the test.
    """

    verdict: _Verdict
    reasons: list[str]
    promise: str
    margins: margin.Margins
    ends: list[margin.MarginEnd]
    modes: list[Mode]


def check_stability(test: PlannedTest, progress: margin.Progress | None = None) -> Preflight:
    """Find stability, margins and predicted errors of a test; ``progress``: see `find_margins`."""
    margins = margin.find_margins(test, progress)
    ends, unstable = list(margin.margin_ends(test, margins)), not test.is_stable()
    reasons = [end.reason for end in ends if end.decides and not unstable]
    reasons += [instability(test)] if unstable else []
    verdict: _Verdict = "unstable" if unstable else "marginal" if reasons else "stable"
    modes = [] if unstable else predicted_modes(test)
    return Preflight(verdict, reasons, _promise(test), margins, ends, modes)


def instability(planned_test: PlannedTest) -> str:
    """Say in a few words how the oscillation of an unstable test grows."""
    time = 1 / planned_test.growth_rate()
    return f"oscillates at {planned_test.hz():.3g} Hz, growing e-fold in {time:.2g} s"


FEWEST_SAMPLES = 2.5
"""In a period of an oscillation, with which accelerations still tell the velocity: at 2.4 the error
begins to grow, and below 2 the samples show another frequency."""


def folded(planned_test: PlannedTest) -> str:
    """Say which light oscillation of the rig is too fast for the rate; empty if none is."""
    light = lightly_damped(roots_of(np.linalg.eigvals(planned_test.rig.plant.a)))
    wanted = FEWEST_SAMPLES * max((root.hz for root in light), default=0.0)  # Hz
    if wanted * planned_test.dt <= 1.0:
        return ""
    few = f"with less than {FEWEST_SAMPLES:g} samples in a period"
    mend = f"take a rate of {wanted:.3g} Hz or more"
    return f"the oil column oscillates at {wanted / FEWEST_SAMPLES:.3g} Hz, {few}: {mend}"


def _promise(planned_test: PlannedTest) -> str:
    promise = SMALL_SIGNAL if planned_test.rig.small_signal else LINEAR
    if planned_test.rig.plant.source == "identified":
        promise = IDENTIFIED
    if planned_test.follows:
        return f"{promise} {FOLLOWS}"
    return f"{promise} {ADAPTIVE}" if planned_test.compensator().estimates() else promise
