"""The controller of the force loop, by gain, zeros and poles or by coefficients."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Complexes, Floats
from seft_msgs_py.config.experiment import write_parameter_file
from seft_msgs_py.errors import InputError
from seft_plant_sim.lti import TransferFunction, bilinear, ratio

from seft_ros.force_controller.force_controller_parameters import (
    TRANSFER_FUNCTION,
    is_one_controller,
    one_controller,
)

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

    def __str__(self) -> str:
        if self.damping is None:
            return f"{self.hz:.4g} Hz" if self.hz else "0"
        return f"{self.hz:.4g} Hz (damping {self.damping:.3g})"


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


class Controller(TransferFunction):
    """C_f from force error (N) to valve drive (V)."""

    @classmethod
    def from_coefficients(
        cls, numerator: npt.ArrayLike, denominator: npt.ArrayLike
    ) -> "Controller":
        """Make it of two polynomials, both not zero; a number has degree 0."""
        num, den = (
            tuple(np.atleast_1d(values).astype(float).tolist())
            for values in (numerator, denominator)
        )
        if not any(num) or not any(den):
            raise InputError(
                f"force_controller: {'denominator' if any(num) else 'numerator'} is zero"
            )
        return cls(num, den)

    @classmethod
    def from_parameters(cls, section: dict[str, Any]) -> "Controller":
        """Make it of a force controller's section of an experiment.

        An InputError says if the controller is another package's, is not the same on all axes,
        or has a polynomial that is zero.
        """
        if not is_one_controller(section):
            raise InputError(
                "force_controller: method, per_axis or gain are set, but seft design needs one "
                f"{TRANSFER_FUNCTION} for all axes; give one by options"
            )
        gain = float(np.ravel(section.get("gain", 1.0))[0])
        return cls.from_coefficients(section["numerator"], section["denominator"]).scaled(gain)

    @classmethod
    def from_roots(cls, zeros: Iterable[Root], poles: Iterable[Root]) -> "Controller":
        """Make it of its factors: product(s - zeros) / product(s - poles)."""
        return cls.from_coefficients(polynomial_of(zeros), polynomial_of(poles))

    @property
    def gain(self) -> float:
        """Gain of the factored form: the quotient of the leading coefficients."""
        leading = [next(filter(None, part)) for part in (self.numerator, self.denominator)]
        return leading[0] / leading[1]

    @property
    def zeros(self) -> list[Root]:
        """Zeros, lowest first."""
        return roots_of(np.roots(self.numerator))

    @property
    def poles(self) -> list[Root]:
        """Poles, lowest first."""
        return roots_of(np.roots(self.denominator))

    def scaled(self, factor: float) -> "Controller":
        """Multiply the gain."""
        return Controller(tuple(factor * value for value in self.numerator), self.denominator)

    def sampled_response(self, frequencies_hz: Floats, dt: float) -> Complexes:
        """Frequency response as `force_controller` runs it, by the bilinear transform."""
        b, a = bilinear(self.numerator, self.denominator, dt)
        return ratio(b, a, np.exp(2j * np.pi * frequencies_hz * dt))


def given_controller(numerator: str | None, denominator: str | None) -> Controller | None:
    """Read the controller that options give; None if they give none.

    The coefficients in s, highest power first, with blanks or commas between them. An InputError
    says if one of the two is missing, or a text can't be read.
    """
    if numerator is None and denominator is None:
        return None
    if numerator is None or denominator is None:
        raise InputError("--numerator and --denominator go together; one of them is missing")
    return Controller.from_coefficients(
        _coefficients(numerator, "--numerator"), _coefficients(denominator, "--denominator")
    )


def _coefficients(text: str, option: str) -> list[float]:
    try:
        values = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        values = []
    if not values or not np.isfinite(values).all():
        raise InputError(f'{option} "{text}": expected numbers, such as "1 17.14 4002"')
    return values


def write_controller(controller: Controller, path: Path) -> None:
    """Write a new parameter file, to be read after the experiment's own."""
    section = one_controller(controller.numerator, controller.denominator)
    comment = "Controller of the force loop, by seft design: force error (N) to valve (V)"
    write_parameter_file(path, {"force_controller": section}, [comment])
