"""Poles and zeros as a laboratory reads them: natural frequencies and damping ratios."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Complexes, Floats

LIGHTLY_DAMPED = 0.5
"""Damping ratio up to which a pair counts as lightly damped: it shows in the magnitude."""

_CANCELLED = 0.01  # distance of a pole and a zero, over the decay rate, that nobody sees


@dataclass(frozen=True)
class Root:
    """A real pole or zero, or a conjugate pair of them.

    Attributes
    ----------
    hz : float
        Natural frequency of a pair, corner frequency of a real one (0: at the origin), Hz;
        negative for a real one in the right half-plane.
    damping : float or None
        Damping ratio of a pair; None: it is real.
    """

    hz: float
    damping: float | None = None


def polynomial_of(roots: Iterable[Root]) -> Floats:
    """Monic polynomial in s with these roots, highest power first."""
    product = np.ones(1)
    for root in roots:
        w = 2 * np.pi * root.hz
        factor = [1.0, w] if root.damping is None else [1.0, 2 * root.damping * w, w * w]
        product = np.convolve(product, factor)
    return product


def roots_of(values: npt.ArrayLike) -> list[Root]:
    """Poles or zeros given in rad/s, complex; lowest first."""
    values = np.asarray(values, dtype=np.complex128)
    # an imaginary part from rounding makes no pair
    real = np.abs(values.imag) <= 1e-9 * np.abs(values)
    found = [Root(float(-value.real / (2 * np.pi)) or 0.0) for value in values[real]]
    for value in values[~real & (values.imag > 0)]:
        damping = round(float(-value.real / abs(value)), 12) or 0.0  # no -1e-17 of an undamped one
        found.append(Root(float(abs(value) / (2 * np.pi)), damping))
    return sorted(found, key=lambda root: abs(root.hz))


def lightly_damped(roots: Iterable[Root]) -> list[Root]:
    """Pairs in the left half-plane, or on its edge, that are lightly damped; same order."""
    return [r for r in roots if r.damping is not None and 0 <= r.damping <= LIGHTLY_DAMPED]


def uncancelled(roots: Complexes, others: Complexes) -> Complexes:
    """Poles (or zeros) in rad/s that no zero (or pole) cancels."""
    kept, others = [], others[np.isfinite(others)]
    for root in roots[np.isfinite(roots)]:
        near = np.abs(others - root) <= _CANCELLED * abs(root.real) + 1e-9 * abs(root)
        if near.any():
            others = np.delete(others, near.argmax())
        else:
            kept.append(root)
    return np.array(kept, dtype=np.complex128)
