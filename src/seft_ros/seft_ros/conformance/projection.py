"""Ratios between signals and their derivatives, without differentiating noise.

Both sides of y = dx/dt are multiplied by smooth functions that are zero at both ends, and
integrated; by parts, the derivative goes over to them (modulating functions, Shinbrot 1957).
"""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.trajectory import Floats

Complex = npt.NDArray[np.complex128]

LINES = np.arange(2.0, 8.01, 0.5)
"""Frequencies of the functions, Hz."""


def project(signal: Floats, dt: float) -> Complex:
    """Integrate a signal of shape (N, n) against the functions; shape (lines, n)."""
    return _weights(len(signal), dt)[0] @ signal * dt


def project_derivative(signal: Floats, dt: float) -> Complex:
    """Project the derivative of a signal of shape (N, n); shape (lines, n)."""
    return -(_weights(len(signal), dt)[1] @ (signal - signal.mean(axis=0))) * dt


def ratio(measured: Complex, expected: Complex) -> complex:
    """Least-squares factor of what was measured to what it should be; nan where that is nothing."""
    power = float(np.vdot(expected, expected).real)
    return complex(np.vdot(expected, measured) / power) if power > 0 else complex(np.nan)


def _weights(count: int, dt: float) -> tuple[Complex, Complex]:
    """Functions and their derivatives, each of shape (lines, N)."""
    time = np.arange(count) * dt
    length = max(count - 1, 1) * dt
    bell = np.sin(np.pi * time / length) ** 2
    slope = np.pi / length * np.sin(2 * np.pi * time / length)
    omega = 2 * np.pi * LINES[:, np.newaxis]
    waves = np.exp(-1j * omega * time)
    return bell * waves, (slope - 1j * omega * bell) * waves
