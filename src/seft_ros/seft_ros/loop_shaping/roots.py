"""Poles and zeros as a designer writes them: frequency in Hz, and damping."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

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

    @classmethod
    def parse(cls, text: str, option: str) -> "Root":
        """Read ``HZ`` or ``HZ,DAMPING``.

        Raises
        ------
        InputError
            If it has not that form, or would lie in the right half-plane.
        """
        try:
            values = [float(word) for word in text.split(",")]
        except ValueError:
            values = []
        if len(values) not in (1, 2) or not np.isfinite(values).all() or min(values) < 0:
            raise InputError(
                f"{option} {text}: expected HZ or HZ,DAMPING, neither below zero, such as 10,0.13"
            )
        return cls(*values)

    def polynomial(self) -> Floats:
        """Monic factor in s, highest power first."""
        w = 2 * np.pi * self.hz
        if self.damping is None:
            return np.array([1.0, w])
        return np.array([1.0, 2 * self.damping * w, w * w])

    def __str__(self) -> str:
        if self.damping is None:
            return f"{self.hz:.4g} Hz" if self.hz else "0"
        return f"{self.hz:.4g} Hz (damping {self.damping:.3g})"


def polynomial_of(roots: Iterable[Root]) -> Floats:
    """Monic polynomial in s with these roots, highest power first."""
    product = np.ones(1)
    for root in roots:
        product = np.convolve(product, root.polynomial())
    return product


def roots_of(values: npt.ArrayLike) -> list[Root]:
    """Poles or zeros given in rad/s, complex; lowest first."""
    values = np.asarray(values, dtype=np.complex128)
    # what rounding leaves of an imaginary part makes no pair
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
    """Those of poles (or zeros) in rad/s that none of the zeros (or poles) cancels."""
    kept, others_left = [], list(others[np.isfinite(others)])
    for root in roots[np.isfinite(roots)]:
        reach = _CANCELLED * abs(root.real) + 1e-9 * abs(root)
        near = [i for i, other in enumerate(others_left) if abs(other - root) <= reach]
        if near:
            others_left.pop(near[0])
        else:
            kept.append(root)
    return np.array(kept, dtype=np.complex128)
