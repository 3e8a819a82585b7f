"""The valve-to-force response by its poles and zeros, as a servo-hydraulic actuator has them."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from seft_ros.identification.rational import Rational
from seft_ros.loop_shaping.roots import Root

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class PlantModel:
    """Valve to force on one axis.

    ::

        H(s) = gain / (s + p) * prod(s^2 + 2 z w s + w^2)_zeros / prod(...)_poles
               * wv^2 / (s^2 + 2 zv wv s + wv^2) * e^(-s dead_time)

    Attributes
    ----------
    gain : float
        N/s/V: rate at which an open valve builds up force, k_oil q.
    zeros : tuple of Root
        Pairs; the first is the specimen's natural frequency (control-structure interaction).
    poles : tuple of Root
        As many pairs; the first is the oil-column resonance.
    leakage : Root
        Real pole: leakage lets a force decay.
    valve : Root
        Pole pair of the servo-valve.
    dead_time : float
        In s, without the loop's own step of latency.
    """

    gain: float
    zeros: tuple[Root, ...]
    poles: tuple[Root, ...]
    leakage: Root
    valve: Root
    dead_time: float

    def __call__(self, s: Complexes) -> Complexes:
        """Evaluate at points of the Laplace plane."""
        value = self.gain / np.polyval(self.leakage.polynomial(), s)
        for zero, pole in zip(self.zeros, self.poles, strict=True):
            value = value * np.polyval(zero.polynomial(), s) / np.polyval(pole.polynomial(), s)
        valve = self.valve.polynomial()
        result: Complexes = value * valve[-1] / np.polyval(valve, s) * np.exp(-s * self.dead_time)
        return result

    def rational(self) -> Rational:
        """Multiply the factors out."""
        valve = self.valve.polynomial()
        numerator = self.gain * valve[-1] * _product(self.zeros)
        denominator = _product((self.leakage, *self.poles, self.valve))
        return Rational(tuple(numerator.tolist()), tuple(denominator.tolist()), self.dead_time)

    def with_pair(self, pair: Root) -> "PlantModel":
        """Add a zero and a pole pair that cancel each other."""
        return replace(self, zeros=(*self.zeros, pair), poles=(*self.poles, pair))


def oil_column_model(
    gain: float,
    specimen: Root,
    oil_hz: float,
    leakage: float,
    valve: Root,
    dead_time: float,
) -> PlantModel:
    """Model of an actuator whose oil is a spring between valve flow and specimen.

    From f' = k_oil (q w - v) - lambda f against m v' + c v + k x = f::

        D(s) = (s + lambda) (s^2 + 2 z w s + w^2) + (k_oil / m) s

    Parameters
    ----------
    gain : float
        k_oil q, N/s/V.
    specimen : Root
        Natural frequency and damping of the specimen.
    oil_hz : float
        Undamped oil-column frequency: (2 pi oil_hz)^2 = (k + k_oil) / m; above the specimen's.
    leakage : float
        lambda, 1/s.
    valve : Root
        Pole pair of the valve.
    dead_time : float
        In s.
    """
    free = specimen.polynomial()
    oil = (2 * np.pi * oil_hz) ** 2 - free[2]
    roots = np.roots(np.polyadd(np.polymul([1.0, leakage], free), [oil, 0.0]))
    real = roots[np.argmin(np.abs(roots.imag))].real
    first, second = sorted((r for r in roots if r != real), key=lambda r: -abs(r))[:2]
    frequency = float(np.sqrt(abs(first * second)))
    pole = Root(frequency / (2 * np.pi), float(-(first + second).real / (2 * frequency)))
    return PlantModel(
        gain, (specimen,), (pole,), Root(max(0.0, -float(real)) / (2 * np.pi)), valve, dead_time
    )


def _product(roots: Iterable[Root]) -> Floats:
    result = np.ones(1)
    for root in roots:
        result = np.convolve(result, root.polynomial())
    return result
