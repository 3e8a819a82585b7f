"""The controller of the force loop, by gain, poles and zeros or by coefficients."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.errors import InputError

from seft_ros.force_controller.block import bilinear
from seft_ros.force_controller.kinds import is_one_controller
from seft_ros.force_controller.names import TRANSFER_FUNCTION
from seft_ros.loop_shaping.roots import Root, roots_of

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class Controller:
    """C_f from force error (N) to valve drive (V).

    Attributes
    ----------
    numerator, denominator : tuple of float
        In s, highest power first.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    @classmethod
    def from_coefficients(
        cls, numerator: npt.ArrayLike, denominator: npt.ArrayLike
    ) -> "Controller":
        """Make it of two polynomials; a number is one of degree 0.

        Raises
        ------
        InputError
            If one of them is zero.
        """
        num, den = (
            tuple(np.atleast_1d(np.asarray(values, dtype=np.float64)).tolist())
            for values in (numerator, denominator)
        )
        for name, values in (("numerator", num), ("denominator", den)):
            if not any(values):
                raise InputError(f"force_controller: {name} is zero")
        return cls(num, den)

    @classmethod
    def from_parameters(cls, section: dict[str, Any]) -> "Controller":
        """Make it of a force controller's section of an experiment.

        Raises
        ------
        InputError
            If another package's controller is in use, axes have different ones or are mixed, or
            a polynomial is zero.
        """
        if not is_one_controller(section):
            raise InputError(
                "force_controller: method, per_axis or gain make it something else than one "
                f"{TRANSFER_FUNCTION} for all axes, which alone can be judged here; give one as "
                "options"
            )
        gain = float(np.ravel(section.get("gain", 1.0))[0])
        return cls.from_coefficients(section["numerator"], section["denominator"]).scaled(gain)

    @classmethod
    def from_roots(cls, gain: float, zeros: Iterable[Root], poles: Iterable[Root]) -> "Controller":
        """Make it of its factors: gain * product(s - zeros) / product(s - poles)."""
        return cls.from_coefficients(gain * _product(zeros), _product(poles))

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

    def response(self, frequencies_hz: Floats) -> Complexes:
        """Frequency response C_f(jw), shape (N,), V/N."""
        s = np.asarray(2j * np.pi * frequencies_hz, dtype=np.complex128)
        return _ratio(self.numerator, self.denominator, s)

    def sampled_response(self, frequencies_hz: Floats, dt: float) -> Complexes:
        """Frequency response as `force_controller` runs it, by the bilinear transform.

        Raises
        ------
        InputError
            If the controller can't be discretised.
        """
        b, a = bilinear(self.numerator, self.denominator, dt)
        return _ratio(b, a, np.exp(2j * np.pi * frequencies_hz * dt))


def _product(roots: Iterable[Root]) -> Floats:
    product = np.ones(1)
    for root in roots:
        product = np.convolve(product, root.polynomial())
    return product


def _ratio(
    numerator: Floats | Sequence[float], denominator: Floats | Sequence[float], points: Complexes
) -> Complexes:
    with np.errstate(divide="ignore", invalid="ignore"):  # a pole may lie on a point
        return np.polyval(numerator, points) / np.polyval(denominator, points)
