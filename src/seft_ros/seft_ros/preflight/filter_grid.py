"""A method's filters over many mass ratios and model stiffnesses at once."""

import time

import numpy as np
import numpy.typing as npt
from numpy.polynomial.chebyshev import chebpts1, chebvander2d

from seft_ros.preflight.closed_loop import Matrices
from seft_ros.preflight.plan import Plan
from seft_ros.preflight.spreading import spread

Floats = npt.NDArray[np.float64]

NODES = (6, 10, 15, 21)
"""Nodes along either direction, more and more of them until the filters are met."""
EXACT = 1e-10
"""Error of an element, over the largest that it has, up to which they are."""
_CHECKED = np.array([[-0.97, 0.31], [-0.52, -0.83], [0.08, 0.93], [0.44, -0.21], [0.91, -0.66]])
"""Where the filters must be met: between the nodes, from -1 to 1 in either direction."""


def filters_over(plan: Plan, mass_ratios: Floats, factors: Floats) -> Matrices:
    """Make a method's filters at all pairs of mass ratio and factor on the model's stiffness.

    Each takes milliseconds, and their elements change smoothly. So they are made at the nodes of
    Chebyshev's polynomials in the logarithms of 1 + mass ratio and of the factor, and taken from
    the polynomials through these where they meet filters that are made between the nodes. Where
    they do not, every single one is made: the method `model` has another number of steps on the
    way for a stiffer one.

    Parameters
    ----------
    plan : Plan
        The test.
    mass_ratios, factors : ndarray
        Shapes (p,) and (q,), ascending; see `Plan.compensation`.

    Returns
    -------
    tuple of ndarray
        a, b, c, d of the filters, each with q and p in front of its own shape.
    """
    shape = len(factors), len(mass_ratios)
    wanted = np.meshgrid(np.log1p(mass_ratios), np.log(factors))
    low, high = (np.array([end(own) for own in wanted]) for end in (np.min, np.max))
    middle, half = (high + low) / 2, (high - low) / 2

    start = time.perf_counter()
    _elements(plan, [float(mass_ratios[-1]), float(factors[-1])])
    each = time.perf_counter() - start

    def made(places: Floats) -> Floats:
        """Elements of the filters at places from -1 to 1, shape (places, elements)."""
        first, second = (middle + half * places).T
        pairs = np.stack([np.expm1(first), np.exp(second)], axis=1).tolist()
        rows: Floats = np.array(list(spread(plan, _elements, pairs, each * len(pairs))))
        return rows

    with np.errstate(invalid="ignore"):
        places = np.stack([own.ravel() for own in wanted], axis=1) - middle
        places = np.where(half > 0, places / np.where(half > 0, half, 1.0), 0.0)
    checked = made(_CHECKED) if len(places) > NODES[0] else np.zeros((0, 0))
    for count in NODES:
        sizes = [count if width > 0 else 1 for width in half]
        if sizes[0] * sizes[1] >= len(places):
            break
        first, second = (chebpts1(size) for size in sizes)
        nodes = np.stack([own.ravel() for own in np.meshgrid(first, second)], axis=1)
        known = made(nodes)
        weights = np.linalg.inv(_polynomials(nodes, sizes))
        largest = np.abs(known).max(axis=0)
        error = np.abs(_polynomials(_CHECKED, sizes) @ weights @ known - checked)
        if (error <= EXACT * largest).all():
            constant = np.ptp(known, axis=0) == 0.0  # zeros above all: they take a loop apart
            found = _polynomials(places, sizes) @ weights @ known
            return _parts(plan, np.where(constant, known[0], found), shape)
    return _parts(plan, made(places), shape)


def _polynomials(places: Floats, sizes: list[int]) -> Floats:
    degrees = [size - 1 for size in sizes]
    return np.asarray(chebvander2d(places[:, 0], places[:, 1], degrees), dtype=np.float64)


def _elements(plan: Plan, pair: list[float]) -> Floats:
    made = plan.compensation(mass_ratio=pair[0], stiffness=pair[1])
    row: Floats = np.concatenate([part.ravel() for part in (made.a, made.b, made.c, made.d)])
    return row


def _parts(plan: Plan, elements: Floats, shape: tuple[int, int]) -> Matrices:
    """Put rows of elements back into matrices."""
    one = plan.compensation()
    found, start = [], 0
    for part in (one.a, one.b, one.c, one.d):
        stop = start + part.size
        found.append(np.reshape(elements[:, start:stop], (*shape, *part.shape)))
        start = stop
    a, b, c, d = found
    return a, b, c, d
