"""What a multisine test says of mass, scale, lag and bias of the channels, with standard errors.

Each sine gives the complex amplitude of each channel, over whole cycles. Velocity and acceleration
of an axis are derivatives of the displacement X, with scale s, lag tau and, where a channel has
another filter than the displacement, a gain and a phase that are curved (g, h)::

    Y_i = sum_j s_ij (i w)^k X_j exp(-i w tau_i + g_i w^p + i h_i w^3)                     (1)

p is 4 for filters that are flat (Butterworth's of second order: log H = -i sqrt(2) u - u^4 / 2 -
i sqrt(2) u^3 / 3, u = w / w_c) and 2 for others (Bessel's, one pole): what fits better counts.
Off the diagonal s is the tilt of an accelerometer. What hides it is the noise of its own axis'
displacement, twice differentiated, so for the tilt X is that of displacement and velocity by their
noise, and a test by random commands, which is longer, says it, too. With these known, the force
is::

    F_i exp(i w tau_i) = sum_j M_ij A_j + (K_ij + i H_ij + i w C_ij) X_j + (K'_i + i H'_i) t X_i
                                                                                           (2)

K' and H' are a change in the time t of the multisine test: some specimens degrade. K + iH is the
stiffness at the multisine test's amplitude of a specimen that does not depend on rate; where
friction bends the motion it is made so (`uneven_force`). Load cell and displacement sensor are the
reference, unless velocity and acceleration agree against the displacement: two sensors that are
wrong by the same factor are less likely than one. Of scales that all are wrong by the same factor,
and of a lag that all have in common, a multisine test says nothing. Standard errors are those of
the sensors' noise or of what the equations leave, if that is more. To those of scales and masses
comes what the steps q of the converters make of an amplitude A, alike in all sines, with noise
sigma::

    2 q J_1(2 pi A / q) / pi exp(-2 (pi sigma / q)^2)                                      (3)

Over all A it has an RMS of q sqrt(2 q / A) / pi^2 times the exponential
(Widrow & Kollar, Quantization Noise, 2008, ch. 5).

Friction bends the piston's motion, most where an overtone meets the oil column's resonance. Then
the force at the sine's own frequency is another one, although the specimen's law is the same. The
law is estimated from all sines and their odd overtones, as stop operators in parallel (Prandtl and
Ishlinskii, see `seft_ros.reference_force.restoring_model`) beside mass, stiffness and damping, none
of which is negative. Taken out of the force is only what the effective stiffness of the stops
differs by from its mean over the sines, so that an error of the law counts little.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from seft_msgs_py.arrays import Complexes, Floats
from seft_plant_sim.calibration import SIGNIFICANT, significant
from seft_plant_sim.channels import ACCELERATION, DISPLACEMENT, FORCE

from seft_ros.identification.multisine import Sine
from seft_ros.reference_force.stop_operators import stop_operators

_ORDERS = (1, 3, 5)  # a law that is odd has no others
_STOPS, _LEAST, _MOST = 8, 0.03, 0.8  # thresholds over the displacement
_POINTS = 512  # of a cycle


def uneven_force(w: Floats, x: Complexes, a: Complexes, f: Complexes, noise: Floats) -> Complexes:
    """Force of friction in excess of that with the mean effective stiffness.

    Parameters
    ----------
    w : ndarray
        Frequencies of m sines, shape (m,), rad/s.
    x, a, f : ndarray
        Displacement, acceleration and force of one axis, aligned, shape (m, H): amplitudes of the
        sine and of its overtones, in the order of their frequencies; 0: not evaluated.
    noise : ndarray
        Standard errors of the force, shape (m, H), N.

    Returns
    -------
    ndarray
        At the sines' frequencies, shape (m,), N.
    """
    travel = float(np.mean(np.abs(x[:, 0])))
    thresholds = travel * np.geomspace(_LEAST, _MOST, _STOPS)
    stops = np.array([_stopped(each, thresholds) for each in x])  # (m, H, stops)
    rows, wanted = [], []
    for order in (each for each in _ORDERS if each <= x.shape[1]):
        k = order - 1
        own = np.stack([a[:, k], x[:, k], 1j * order * w * x[:, k]], axis=1)
        seen = f[:, k] != 0.0
        rows.append((np.concatenate([own, stops[:, k]], axis=1) / noise[:, [k]])[seen])
        wanted.append((f[:, k] / noise[:, k])[seen])
    columns, force = np.concatenate(rows), np.concatenate(wanted)
    real = np.concatenate([columns.real, columns.imag])
    size = np.maximum(np.linalg.norm(real, axis=0), 1e-300)
    found, _ = nnls(real / size, np.concatenate([force.real, force.imag]))
    effective = stops[:, 0] / x[:, :1]
    uneven: Complexes = ((effective - effective.mean(axis=0)) * x[:, :1]) @ (found / size)[3:]
    return uneven


def _stopped(x: Complexes, thresholds: Floats) -> Complexes:
    """Amplitudes of stop operators that follow a periodic motion, shape (H, stops)."""
    phase = 2 * np.pi * np.arange(2 * _POINTS) / _POINTS  # the first cycle is from rest
    orders = np.arange(1, len(x) + 1)[:, np.newaxis]
    motion = (x[:, np.newaxis] * np.exp(1j * orders * phase)).real.sum(axis=0)
    stops = stop_operators(motion, thresholds)
    spectrum = np.fft.rfft(stops[_POINTS:], axis=0) * 2.0 / _POINTS
    return np.asarray(spectrum[1 : len(x) + 1], dtype=np.complex128)


_OVERTONES = 9  # of a sine, which friction makes, and which are no noise
_ROUNDS = 4  # of linearisation in the lag; it converges quadratically


@dataclass(frozen=True)
class Harmonics:
    """Amplitudes of m sines on n axes.

    Attributes
    ----------
    w : ndarray
        Shape (m,), rad/s.
    overtones : ndarray
        Amplitudes of displacement, velocity, acceleration and force, complex, shape (m, H, 4, n):
        of the sine and of its overtones; 0: not evaluated.
    errors : ndarray
        Standard error of their real and imaginary parts, alike.
    mean : ndarray
        Mean over whole cycles, shape (m, 4, n).
    time : ndarray
        Of each sine, -1 to 1 over those of an axis, shape (m,); 0: of all at once.
    rounding : ndarray
        RMS of Eq. (3) over the amplitude, shape (4, n).
    """

    w: Floats
    overtones: Complexes
    errors: Floats
    mean: Floats
    time: Floats
    rounding: Floats

    def passed(self, response: Callable[[Floats], Complexes]) -> "Harmonics":
        """Give those of channels after filters of a response, (..., 4, n), at w of shape (...)."""
        orders = np.arange(1, 1 + self.overtones.shape[1])
        passed = response(np.outer(self.w, orders))
        return replace(self, overtones=self.overtones * passed, errors=self.errors * np.abs(passed))

    @property
    def amplitude(self) -> Complexes:
        """Amplitudes of the sines, shape (m, 4, n)."""
        return self.overtones[:, 0]

    @property
    def noise(self) -> Floats:
        """Standard errors of the sines, shape (m, 4, n)."""
        return self.errors[:, 0]


def harmonics(samples: Floats, sines: Sequence[Sine], dt: float) -> Harmonics:
    """Evaluate a multisine test; ``samples`` are as measured, shape (N, 4, n)."""
    overtones, noise, mean, rounding = [], [], [], []
    steps = np.abs(np.diff(samples.reshape(len(samples), -1), axis=0))
    steps = np.where(steps > 0.0, steps, np.inf).min(axis=0)
    for sine in sines:
        part = samples[sine.first : sine.end]
        flat = part.reshape(len(part), -1)
        t = dt * np.arange(sine.first, sine.end)
        w = 2 * np.pi * sine.frequency
        slow = np.linspace(-1.0, 1.0, len(t))  # the piston may drift
        orders = np.arange(1, max(1, min(_OVERTONES, int(0.45 * 2 * np.pi / (w * dt)))) + 1)
        waves = w * t[:, np.newaxis] * orders
        rows = [np.cos(waves), np.sin(waves), np.ones((len(t), 1)), slow[:, np.newaxis]]
        columns = np.concatenate(rows, axis=1)
        found, *_ = np.linalg.lstsq(columns, flat, rcond=None)
        left = flat - columns @ found
        variance = (left**2).sum(axis=0) / (len(t) - columns.shape[1])
        count = len(orders)
        waves = np.zeros((_OVERTONES, flat.shape[1]), dtype=np.complex128)
        waves[:count] = found[:count] - 1j * found[count : 2 * count]
        overtones.append(waves)
        noise.append(np.sqrt(2.0 * variance / len(t)))
        mean.append(found[-2])
        rounding.append(_rounding(np.abs(waves[0]), steps, variance))
    shape = (len(sines), *samples.shape[1:])
    middle = np.array([(sine.first + sine.end) / 2 for sine in sines])
    for axis in {sine.axis for sine in sines}:
        own = [sine.axis == axis for sine in sines]
        first, end = middle[own].min(), middle[own].max()
        middle[own] = (2 * middle[own] - first - end) / max(end - first, 1.0)
    return Harmonics(
        2 * np.pi * np.array([sine.frequency for sine in sines]),
        np.reshape(overtones, (len(sines), _OVERTONES, *samples.shape[1:])),
        np.repeat(np.reshape(noise, shape)[:, np.newaxis], _OVERTONES, axis=1),
        np.reshape(mean, shape),
        middle,
        np.reshape(np.min(rounding, axis=0), shape[1:]),
    )


def _rounding(amplitude: Floats, step: Floats, variance: Floats) -> Floats:
    """RMS of Eq. (3) over the amplitude; the variance is that of noise and converter together."""
    steps = np.where(np.isfinite(step), np.maximum(amplitude / step, 0.1), np.inf)
    noise = np.maximum(variance / step**2 - 1.0 / 12.0, 0.0)
    return math.sqrt(2.0) * np.exp(-2.0 * np.pi**2 * noise) / (np.pi**2 * steps**1.5)


@dataclass(frozen=True)
class Fit:
    """Estimates of a linear regression with their standard errors, shape (p,).

    ``left`` is the sum of the squares that are left, over their variance.
    """

    value: Floats
    error: Floats
    left: float


def regressed(columns: Complexes, target: Complexes, noise: Floats) -> Fit:
    """Real solution of complex equations, shape (m, p) and (m,), by weighted least squares.

    ``noise`` is the standard error of the real and the imaginary part of each equation. The
    standard errors follow from it, or from what is left, if that is more.
    """
    weighted, wanted = columns / noise[:, np.newaxis], target / noise
    a = np.concatenate([weighted.real, weighted.imag])
    b = np.concatenate([wanted.real, wanted.imag])
    products = a.T @ a
    size = np.maximum(np.sqrt(products.diagonal()), 1e-300)
    inverse = np.linalg.pinv(products / size / size[:, np.newaxis], rcond=1e-12)
    value = inverse @ (a.T @ b / size) / size
    left = b - a @ value
    squares = float(left @ left)
    spread = max(1.0, squares / max(1, len(b) - a.shape[1]))
    return Fit(value, np.sqrt(inverse.diagonal() * spread) / size, squares)


@dataclass(frozen=True)
class MultisineFit:
    """What a multisine test says; everything as published, after what was known of the channels.

    Attributes
    ----------
    mass, mass_error : ndarray
        M and its standard errors, shape (n, n), kg: force over acceleration, whose scale is
        corrected if that is significant.
    stiffness : ndarray
        K of Eq. (2), shape (n, n), N/m.
    hysteresis, hysteresis_error : ndarray
        H of Eq. (2) of each axis for itself, shape (n,), N/m.
    damping, damping_error : ndarray
        C of Eq. (2), shape (n, n), N s/m.
    scale, scale_error : ndarray
        Measured over true, shape (4, n); 1 for the force, and for the displacement unless velocity
        and acceleration agree against it.
    lag, lag_error : ndarray
        Behind the displacement, shape (4, n), s. That of the force is behind the aligned
        acceleration.
    bias, bias_error : ndarray
        Mean over whole cycles, shape (4, n), SI units.
    tilt, tilt_error : ndarray
        What the accelerometers show of the acceleration of each axis, shape (n, n).
    """

    mass: Floats
    mass_error: Floats
    stiffness: Floats
    hysteresis: Floats
    hysteresis_error: Floats
    damping: Floats
    damping_error: Floats
    scale: Floats
    scale_error: Floats
    lag: Floats
    lag_error: Floats
    bias: Floats
    bias_error: Floats
    tilt: Floats
    tilt_error: Floats

    @property
    def rubs(self) -> bool:
        """Whether the specimen dissipates what does not depend on rate: it rubs, or yields."""
        return bool((self.hysteresis > SIGNIFICANT * self.hysteresis_error).any())

    def behind_filters(self, unsure: Floats) -> "MultisineFit":
        """Add what is not known of the response of the channels' filters, relative, (4, n)."""
        of_mass = np.hypot(unsure[FORCE][:, np.newaxis], unsure[ACCELERATION]) * self.mass
        of_scale = np.hypot(unsure, unsure[DISPLACEMENT]) * self.scale
        of_scale[[DISPLACEMENT, FORCE]] = 0.0
        return replace(
            self,
            mass_error=np.hypot(self.mass_error, of_mass),
            scale_error=np.hypot(self.scale_error, of_scale),
        )

    def weighed(self, mass: Floats) -> "MultisineFit":
        """Take the masses of the axes for known, (n,), kg: the load cells are off by the rest.

        No motion tells a wrong mass from a wrong scale of the force.
        """
        shown = self.mass.diagonal() / mass
        scale, error = self.scale.copy(), self.scale_error.copy()
        scale[FORCE], error[FORCE] = shown, self.mass_error.diagonal() / mass
        both = np.sqrt(np.outer(shown, shown))
        return replace(
            self,
            mass=self.mass / both,
            mass_error=self.mass_error / both,
            stiffness=self.stiffness / both,
            hysteresis=self.hysteresis / shown,
            hysteresis_error=self.hysteresis_error / shown,
            damping=self.damping / both,
            damping_error=self.damping_error / both,
            scale=scale,
            scale_error=error,
        )


def fit_multisine(
    of: Harmonics,
    fault_free: tuple[Complexes, Floats],
    derived: bool = False,
    tilt_elsewhere: tuple[Floats, Floats] | None = None,
) -> MultisineFit:
    """Estimate mass, scales, lags and biases.

    Parameters
    ----------
    of : Harmonics
        Of at least five sines on each axis.
    fault_free : tuple of ndarray
        Velocity and acceleration that a fault-free rig shows, over the derivatives of the
        displacement, shape (m, 2): a held command folds down. And what is not known of them and of
        the mass, (m, 3), see `seft_ros.design.plant.held_relations`.
    derived : bool
        Whether the velocity is derived from the displacement.
    tilt_elsewhere : tuple of ndarray, optional
        Tilt that another test shows, and its standard errors, see `tilt_shown`.
    """
    m, _, n = of.amplitude.shape
    scale, lag = np.ones((4, n)), np.zeros((4, n))
    scale_error, lag_error = np.zeros((4, n)), np.zeros((4, n))
    acceleration = of.amplitude[:, 2].copy()
    expected, unsure = fault_free
    folded = unsure.max(axis=0)
    tilt, tilt_error = tilt_shown(of, expected, derived)
    if tilt_elsewhere is not None:
        tilt, tilt_error = _mean_tilt((tilt, tilt_error), tilt_elsewhere)
    seen = np.abs(tilt - np.eye(n)) > SIGNIFICANT * tilt_error
    is_tilted = (seen & ~np.eye(n, dtype=bool)).any(axis=1)
    tilt[~is_tilted], tilt_error[~is_tilted] = np.eye(n)[~is_tilted], 0.0
    for order, i in ((order, i) for order in (1, 2) for i in range(n)):
        crossed = bool(is_tilted[i]) if order == 2 else None
        own, aligning = _relation(of, order, i, expected[:, order - 1], crossed)
        scale[order, i] = own.value[i]
        rounding = math.hypot(of.rounding[0, i], of.rounding[order, i])
        scale_error[order, i] = math.hypot(own.error[i], folded[order - 1], rounding)
        lag[order, i], lag_error[order, i] = own.value[n], own.error[n]
        if order == 2:
            acceleration[:, i] *= aligning
    scale[0], scale_error[0] = _displacement_scale(scale, scale_error)
    scale[1:3] *= scale[0]
    adopted = 1.0 + significant(scale - 1.0, scale_error)
    acceleration = np.linalg.solve(adopted[2][:, np.newaxis] * tilt, acceleration.T).T
    mass, mass_error, stiffness, damping, damping_error = np.zeros((5, n, n))
    hysteresis, hysteresis_error = np.zeros((2, n))
    for i in range(n):
        force = of.amplitude[:, 3, i]
        own = _inertia(of, force, acceleration, adopted, i)
        even = force - _uneven(of, i, lag[2, i], own.value[-1], adopted[[0, 2], i])
        own = _inertia(of, even, acceleration, adopted, i)
        mass[i], stiffness[i], h, damping[i] = own.value[: 4 * n].reshape(4, n)
        of_mass, _, of_h, damping_error[i] = own.error[: 4 * n].reshape(4, n)
        hysteresis[i], hysteresis_error[i] = h[i], of_h[i]
        common = math.hypot(folded[1], *of.rounding[[0, 2, 3], i])
        mass_error[i] = np.hypot(np.hypot(of_mass, common * np.abs(mass[i])), folded[2])
        lag[3, i], lag_error[3, i] = own.value[-1], own.error[-1]
    bias, bias_error = of.mean.mean(axis=0), of.mean.std(axis=0, ddof=1) / np.sqrt(m)
    law = stiffness, hysteresis, hysteresis_error, *_symmetric(damping, damping_error)
    channels = scale, scale_error, lag, lag_error, bias, bias_error, tilt, tilt_error
    return MultisineFit(*_symmetric(mass, mass_error), *law, *channels)


def _symmetric(value: Floats, error: Floats) -> tuple[Floats, Floats]:
    """Mean of what is right and left of the diagonal, and its standard errors."""
    of_mean = np.hypot(error, error.T) / 2 * np.sqrt(1.0 + np.eye(len(value)))
    return (value + value.T) / 2, of_mean


def tilt_shown(of: Harmonics, fault_free: Complexes, derived: bool) -> tuple[Floats, Floats]:
    """Tilt of the accelerometers and its standard errors, shape (n, n); see `fit_multisine`."""
    n = of.amplitude.shape[2]
    tilt, error = np.eye(n), np.zeros((n, n))
    if n == 1:
        return tilt, error
    motion, noise, s = of.amplitude[:, 0].copy(), of.noise[:, 0].copy(), 1j * of.w
    for i in () if derived else range(n):
        own, aligning = _relation(of, 1, i, fault_free[:, 0])
        velocity = of.amplitude[:, 1, i] / fault_free[:, 0] * aligning / own.value[i]
        ratio = of.noise[:, 1, i] / (own.value[i] * of.w * noise[:, i])
        share = 1.0 / (1.0 + ratio**2)
        motion[:, i] = (1.0 - share) * motion[:, i] + share * velocity / s
        noise[:, i] *= np.sqrt(1.0 - share)
    for i in range(n):
        y, columns = of.amplitude[:, 2, i] / fault_free[:, 1], (s * s)[:, np.newaxis] * motion
        fit, _ = _shaped(y, columns, np.hypot(of.noise[:, 2, i], of.w**2 * noise[:, i]), of.w)
        tilt[i], error[i] = fit.value[:n] / fit.value[i], fit.error[:n] / fit.value[i]
    error[np.diag_indices(n)] = 0.0
    return tilt, error


def _mean_tilt(one: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Mean of two estimates by their errors; the diagonal has none."""
    (a, of_a), (b, of_b) = one, other
    both = np.maximum(np.hypot(of_a, of_b), 1e-300)
    share = (of_a / both) ** 2
    return (1.0 - share) * a + share * b, of_a * of_b / both


def _displacement_scale(scale: Floats, error: Floats) -> tuple[Floats, Floats]:
    """Scale of the displacement and its standard error, (n,), from those against it, (4, n).

    It is 1, without an error, unless velocity and acceleration both differ, by the same factor.
    """
    (v, a), (of_v, of_a) = scale[1:3], error[1:3]
    differ = (np.abs(v - 1.0) > SIGNIFICANT * of_v) & (np.abs(a - 1.0) > SIGNIFICANT * of_a)
    alike = differ & (np.abs(v - a) <= SIGNIFICANT * np.hypot(of_v, of_a))
    p, q = of_v**-2.0, of_a**-2.0
    found = (p + q) / (p * v + q * a)
    return np.where(alike, found, 1.0), np.where(alike, found**2 / np.sqrt(p + q), 0.0)


def _relation(
    of: Harmonics, order: int, i: int, fault_free: Complexes, crossed: bool | None = None
) -> tuple[Fit, Complexes]:
    """Fit Eq. (1) for axis i: scales to each axis, lag; and give the factor that aligns it.

    ``crossed`` says whether it shows other axes, too; by default if that is significant.
    """
    n = of.amplitude.shape[2]
    by_x = (1j * of.w) ** order
    y, motion = of.amplitude[:, order, i] / fault_free, by_x[:, np.newaxis] * of.amplitude[:, 0]
    noise = np.hypot(of.noise[:, order, i], np.abs(by_x) * of.noise[:, 0, i])
    used = np.arange(n)
    fit, shape = _shaped(y, motion, noise, of.w)
    if crossed is None:
        others = used != i
        crossed = bool((np.abs(fit.value[:n]) > SIGNIFICANT * fit.error[:n])[others].any())
    if n > 1 and not crossed:
        used = np.array([i])
        fit, shape = _shaped(y, motion[:, used], noise, of.w)
    value, error = np.zeros(n + 1), np.zeros(n + 1)
    at = np.append(used, n)
    value[at], error[at] = fit.value, fit.error
    return Fit(value, error, fit.left), shape


def _shaped(y: Complexes, columns: Complexes, noise: Floats, w: Floats) -> tuple[Fit, Complexes]:
    """Fit y = columns b exp(-i w tau + g w^p + i h w^3); give b and tau, and the factor on y.

    Without g and h, unless one of them is significant.
    """
    late, bent = -1j * w, 1j * w**3
    fits = (aligned(y, columns, noise, _stacked(late, w**p, bent)) for p in (4, 2))
    fit, shape = min(fits, key=lambda tried: tried[0].left)
    if not (np.abs(fit.value[-2:]) > SIGNIFICANT * fit.error[-2:]).any():
        fit, shape = aligned(y, columns, noise, _stacked(late))
    count = columns.shape[1] + 1
    return Fit(fit.value[:count], fit.error[:count], fit.left), shape


def _stacked(*columns: NDArray[Any]) -> Complexes:
    return np.stack(columns, axis=1).astype(np.complex128)


def aligned(
    y: Complexes, columns: Complexes, noise: Floats, powers: Complexes, start: float | Floats = 0.0
) -> tuple[Fit, Complexes]:
    """Fit y = columns b exp(powers q); give (b, q), and the factor on y."""
    count = powers.shape[1]
    found = np.zeros(count) + start
    for _ in range(_ROUNDS):
        turned = y * np.exp(-powers @ found)
        more = powers * turned[:, np.newaxis]
        fit = regressed(np.concatenate([columns, more], axis=1), turned, noise)
        found = found + fit.value[-count:]
    value = np.append(fit.value[:-count], found)
    return Fit(value, fit.error, fit.left), np.exp(-powers @ found)


def _uneven(
    of: Harmonics, i: int, late_acceleration: float, late_force: float, scale: Floats
) -> Complexes:
    """Force of friction on axis i that differs from sine to sine, as measured, shape (m,).

    The motion's overtones are those of displacement and acceleration by their noise: a filter of
    one that is taken back would bury them. ``scale`` is that of both, (2,).
    """
    uneven = np.zeros(len(of.w), dtype=np.complex128)
    if of.overtones.shape[1] == 1:  # of a spectrum
        return uneven
    own = np.abs(of.amplitude[:, 0]).argmax(axis=1) == i  # the sines of this axis
    orders = np.arange(1, of.overtones.shape[1] + 1)
    s = 1j * of.w[own, np.newaxis] * orders
    x, _, a, f = np.moveaxis(of.overtones[own, :, :, i], 2, 0)
    of_x, _, of_a, of_f = np.moveaxis(of.errors[own, :, :, i], 2, 0)
    a, f = a * np.exp(s * late_acceleration), f * np.exp(s * late_force)
    squares = (s * s).real
    share = 1.0 / (1.0 + (squares * of_x / scale[0] / (of_a / scale[1])) ** 2)
    x = share * x + (1.0 - share) * a / squares * scale[0] / scale[1]
    uneven[own] = uneven_force(of.w[own], x, a, f, of_f) * np.exp(-s[:, 0] * late_force)
    return uneven


def _inertia(
    of: Harmonics, force: Complexes, acceleration: Complexes, scale: Floats, i: int
) -> Fit:
    """Fit Eq. (2) for axis i: M, K, H and C of its row, last the lag of the force.

    ``acceleration`` is corrected by ``scale``, of which that of the displacement counts, too.
    """
    n, w = acceleration.shape[1], of.w[:, np.newaxis]
    x = of.amplitude[:, 0] / scale[0]
    columns = np.concatenate([acceleration, x, 1j * x, 1j * w * x], axis=1)
    if of.time.any():
        changed = of.time * x[:, i]
        columns = np.concatenate([columns, np.stack([changed, 1j * changed], axis=1)], axis=1)
    noise = of.noise[:, 3, i]
    for _ in range(2):
        fit, _ = _shaped(force, columns, noise, of.w)
        m, k, h, c = fit.value[: 4 * n].reshape(4, n)
        motion = (of.noise[:, 0] / scale[0] * np.abs(k + 1j * (h + w * c))) ** 2
        motion += (of.noise[:, 2] / scale[2] * m) ** 2
        noise = np.sqrt(of.noise[:, 3, i] ** 2 + motion.sum(axis=1))
    return fit
