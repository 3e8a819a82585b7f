"""Models fitted to responses: the specimen, and the closed force loop with its band and delay."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.optimize import least_squares
from scipy.signal import find_peaks
from seft_msgs_py.arrays import Complexes, Floats
from seft_plant_sim.calibration import SIGNIFICANT
from seft_plant_sim.lti import TransferFunction
from seft_plant_sim.simulated.specimen import Specimen

from seft_ros.design.plant import Root, roots_of
from seft_ros.identification.measured_test import BAND_HZ, Response

FLATNESS_DB = 1.0
BANDWIDTH_DB = -3.0

_OUTLIERS = 5  # points of the running median over |T|: two wild ones in a row change nothing
_DIP_DB = 0.2  # smallest dip that is distinguished from noise


@dataclass(frozen=True)
class Tracking:
    """How the measured force follows the reference force; None if the data do not show it.

    Attributes
    ----------
    closed_loop_flat_to_hz : float or None
        First frequency at which |T| leaves +-1 dB; 0 where it is outside from the start, None
        where it never leaves.
    bandwidth_hz : float or None
        First frequency at which |T| falls below -3 dB; likewise.
    delay_s : float or None
        Pure delay whose phase fits that of T best, over the band in which T is flat.
    dip_db, dip_hz : float or None
        |T| at the bottom of its deepest dip within the band, and where: it is higher on either
        side, as at a zero of the specimen that is not fully compensated.
    """

    closed_loop_flat_to_hz: float | None = None
    bandwidth_hz: float | None = None
    delay_s: float | None = None
    dip_db: float | None = None
    dip_hz: float | None = None


def tracking_measures(frequencies_hz: Floats, tracking: Complexes) -> Tracking:
    """Measure a closed loop T known at some frequencies, ascending, in Hz; shape (N,) both.

    Delay and dip are those of the band up to `BAND_HZ`. Against noise: magnitudes pass a
    running median of five points, dips below 0.2 dB do not count, and the delay is a
    least-squares fit. Phase is unwrapped from the lowest frequency up, so that noise beyond the
    band reaches nothing within it.
    """
    known = np.isfinite(tracking) & (tracking != 0)
    f, t = frequencies_hz[known], tracking[known]
    if not len(f):
        return Tracking()
    decibels = median_filter(20 * np.log10(np.abs(t)), _OUTLIERS, mode="nearest")
    phase = np.unwrap(np.angle(t))
    flat_to = _first_above(f, np.abs(decibels), FLATNESS_DB)
    bandwidth = _first_above(f, -decibels, -BANDWIDTH_DB)
    delay = _fitted_delay(f, phase, BAND_HZ if flat_to is None else min(flat_to, BAND_HZ))
    return Tracking(flat_to, bandwidth, delay, *_deepest_dip(f, decibels))


def _first_above(f: Floats, values: Floats, limit: float) -> float | None:
    """First frequency at which values pass a limit, interpolated; 0 if the first does."""
    above = values > limit
    if not above.any():
        return None
    i = int(above.argmax())
    return float(np.interp(limit, values[i - 1 : i + 1], f[i - 1 : i + 1])) if i else 0.0


def _fitted_delay(f: Floats, phase: Floats, to_hz: float) -> float | None:
    """Least squares of phase = -2 pi f tau through the origin, every Hz counting the same."""
    band = f <= to_hz
    if band.sum() < 2:
        return None
    omega = 2 * np.pi * f[band]
    weight = np.gradient(omega) * omega  # how densely the points lie must not matter
    return float(-(weight @ phase[band]) / (weight @ omega))


def _deepest_dip(f: Floats, decibels: Floats) -> tuple[float | None, float | None]:
    dips, _ = find_peaks(-decibels, prominence=_DIP_DB)
    dips = dips[f[dips] <= BAND_HZ]
    if not len(dips):
        return None, None
    deepest = dips[decibels[dips].argmin()]
    return float(decibels[deepest]), float(f[deepest])


_FLOOR = 4e-4  # of each term: to which a multisine test tells the scale of a sensor
_ORDER = 3  # of a filter that a lag has been taken from: what it leaves begins with s^3


@dataclass(frozen=True)
class SpecimenFit:
    """Identified specimen: M a + C v + K x = f.

    Attributes
    ----------
    mass, damping, stiffness : ndarray
        Shape (n, n), symmetric, in kg, N s/m and N/m.
    error : float
        RMS of the force that they leave unexplained, over that of the force, 0 to 1.
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    error: float

    def roots(self) -> list[Root]:
        """Natural frequencies and dampings, lowest first."""
        moving, _ = Specimen(self.mass, self.damping, self.stiffness).state_matrices()
        return roots_of(np.linalg.eigvals(moving))


def fit_specimen(measured: Sequence[Response]) -> SpecimenFit:
    """Fit mass, damping and stiffness to responses of force and motion.

    The responses to the excitation are its cross spectra with the sensors, so that noise of the
    sensors averages out (the excitation is the instrument). The equation error of each frequency
    is weighted by the inverse of its variance from the remaining noise of force, acceleration and
    displacement, for the fitted parameters: the maximum-likelihood estimator of errors in
    variables, which is consistent (Pintelon & Schoukens, System Identification, 2nd ed.,
    sec. 9.11). The mass follows from the acceleration, damping and stiffness from the
    displacement, each where it is strong.

    What filters and lags leave between the acceleration of an axis and the force, a factor
    exp(g_1 s + g_2 s^2 + g_3 s^3), is fitted too where it is significant: far above the specimen's
    frequency the least lag would count as damping, and one that is not there costs half of what the
    responses say of the damping.

    Parameters
    ----------
    measured : sequence of Response
        Of displacement, acceleration and force over n axes, stacked, to the excitation.
    """
    n = measured[0].response.shape[2]
    row, column = np.triu_indices(n)

    def matrices(p: Floats) -> Floats:
        """M, C and K, shape (3, n, n), of their upper triangles."""
        upper = np.zeros((3, n, n))
        upper[:, row, column] = p.reshape(3, -1)
        return upper + np.triu(upper, 1).swapaxes(1, 2)

    def residuals(p: Floats) -> Floats:
        specimen, g = matrices(p[: len(scale)] * scale), p[len(scale) :].reshape(n, _ORDER)
        errors = [_weighed(_seen_alike(part, g / units), *specimen).ravel() for part in measured]
        return np.concatenate([_real(np.concatenate(errors)), g.ravel()])

    start = _rough(measured[-1])[:, row, column]
    size = np.abs(start).max(axis=1, keepdims=True)
    scale = np.repeat(np.where(size > 0, size, 1.0), start.shape[1], axis=1).ravel()
    highest = 2 * np.pi * max(float(part.frequencies_hz[-1]) for part in measured)
    units = highest ** np.arange(1.0, _ORDER + 1.0)
    straight, none = start.ravel() / scale, np.zeros(n * _ORDER)
    robust = {"loss": "soft_l1", "f_scale": 3.0}
    plain = least_squares(lambda p: residuals(np.concatenate([p, none])), straight, **robust)
    found = np.concatenate([plain.x, none])
    shaped = least_squares(residuals, found, **robust)
    if 2.0 * (plain.cost - shaped.cost) > SIGNIFICANT**2 + len(none):  # beside what fits noise
        found = shaped.x
    mass, damping, stiffness = matrices(found[: len(scale)] * scale)
    g = found[len(scale) :].reshape(n, _ORDER) / units
    values, vectors = np.linalg.eigh(damping)
    damping = (vectors * np.maximum(values, 0.0)) @ vectors.T  # no specimen feeds energy in
    damping = (damping + damping.T) / 2
    unexplained = [
        np.linalg.norm(_error(part, mass, damping, stiffness)) / np.linalg.norm(_parts(part)[2])
        for part in (_seen_alike(part, g) for part in measured)
    ]
    return SpecimenFit(mass, damping, stiffness, float(np.mean(unexplained)))


def _seen_alike(measured: Response, g: Floats) -> Response:
    """Give the accelerations as if the force's sensor had shown them; g has shape (n, 3)."""
    powers = (2j * np.pi * measured.frequencies_hz)[:, np.newaxis] ** np.arange(1, _ORDER + 1)
    response, n = measured.response.copy(), len(g)
    response[:, n : 2 * n] *= np.exp(powers @ g.T)[:, :, np.newaxis]
    return replace(measured, response=response)


def _parts(measured: Response) -> list[Complexes]:
    """Displacement, acceleration and force, shape (F, n, n) each."""
    return np.split(measured.response, 3, axis=1)


def _motion(measured: Response, damping: Floats, stiffness: Floats) -> Complexes:
    s = 2j * np.pi * measured.frequencies_hz[:, np.newaxis, np.newaxis]
    return np.asarray(s * damping + stiffness, dtype=np.complex128)


def _error(measured: Response, mass: Floats, damping: Floats, stiffness: Floats) -> Complexes:
    """Error of the equation of motion M A + (jw C + K) X = F at every frequency."""
    x, a, f = _parts(measured)
    return f - mass @ a - _motion(measured, damping, stiffness) @ x


def _weighed(measured: Response, mass: Floats, damping: Floats, stiffness: Floats) -> Complexes:
    """Error over its standard deviation, shape (F, n, n): equations, inputs."""
    x, a, f = (np.abs(part) for part in _parts(measured))
    one = np.broadcast_to(np.eye(len(mass)), f.shape)
    rows = [-_motion(measured, damping, stiffness), -mass * one, one]
    by_noise = np.concatenate(rows, axis=2)
    power = np.einsum("fij,fjk,fik->fi", by_noise, measured.noise, by_noise.conj()).real
    variance = power[:, :, np.newaxis] * measured.input_gain[:, np.newaxis, :]
    terms = f + np.abs(mass) @ a + np.abs(stiffness) @ x
    deviation = np.sqrt(np.maximum(variance, 0.0) + (_FLOOR * terms) ** 2)
    return _error(measured, mass, damping, stiffness) / deviation


def _rough(measured: Response) -> Floats:
    """First guess, of each axis alone: linear least squares on relative errors; (3, n, n)."""
    n = measured.response.shape[2]
    found, s = np.zeros((3, n, n)), 2j * np.pi * measured.frequencies_hz
    for axis in range(n):
        x, a, f = (part[:, axis, axis] for part in _parts(measured))
        columns = np.stack([a, s * x, x], axis=1) / np.abs(f)[:, np.newaxis]
        target = f / np.abs(f)
        scale = np.linalg.norm(columns, axis=0)
        solution = np.linalg.lstsq(_real(columns) / scale, _real(target), rcond=None)[0]
        found[:, axis, axis] = np.abs(solution / scale)
    return found


def _real(equations: Complexes) -> Floats:
    """Complex equations, along the first axis, as twice as many real ones."""
    return np.concatenate([equations.real, equations.imag])


GOOD = 0.01
"""Error of a fitted response that is good enough."""
_MOST_PAIRS = 5
_NEAR = 1.25  # error over the least one at which fewer pairs are preferred
_CORNERS = (0.1, 0.2, 0.4, 0.8)  # of the highest frequency: starts of the first pair
_DEAD_TIMES = 12
_MOST_STEPS = 100
_POINTS = 400
_LOWEST, _HIGHEST = np.log([0.003, 0.003]), np.log([5.0, 20.0])  # of frequency and damping


@dataclass(frozen=True)
class TrackingFit:
    """Fitted response from reference force to the force measured at the same step.

    The model is continuous and stable, and its dead time includes the loop's latency. ``error`` is
    the RMS of its error; |T| is near 1 in the band of the loop.
    """

    model: TransferFunction
    error: float


def fit_tracking(
    frequencies_hz: Floats,
    tracking: Complexes,
    weight: Floats,
    least_dead_time: float = 0.0,
    good: float = GOOD,
) -> TrackingFit:
    """Fit dead time and as few pole pairs as reach a good error, or nearly that of five pairs.

    Each further pair starts where the error of the last fit is largest, and has two zeros. Poles
    and dead time are searched, the numerator follows by linear least squares.

    Parameters
    ----------
    frequencies_hz, tracking, weight : ndarray
        Increasing, Hz; T from reference force to measured force there; weight of its error; (F,).
    least_dead_time : float
        Lower bound of the dead time, s.
    good : float
        The good error.
    """
    step = max(1, len(frequencies_hz) // _POINTS)
    data = _Data(frequencies_hz[::step], tracking[::step], weight[::step], least_dead_time)
    first = (data.solved(data.start(corner)) for corner in _CORNERS)
    fit, parameters = min(first, key=lambda found: found[0].error)
    fits = [fit]
    while fit.error >= good and len(fits) < _MOST_PAIRS:
        wider = np.concatenate([parameters[:1], data.misfit(fit.model), parameters[1:]])
        fit, parameters = data.solved(wider)
        fits.append(fit)
    least = min(fit.error for fit in fits)
    return next(fit for fit in fits if fit.error <= max(good, _NEAR * least))


class _Data:
    """Weighted response, and the parameters that are fitted to it.

    They are the dead time over the longest one and, for each pole pair, the logarithms of its
    frequency, counted in the highest of the data, and of its damping ratio.
    """

    def __init__(
        self, frequencies_hz: Floats, tracking: Complexes, weight: Floats, least: float
    ) -> None:
        self._f, self._t, self._w = frequencies_hz, tracking, weight
        omega = 2 * np.pi * frequencies_hz
        self._unit = float(omega[-1])  # for polynomials of even size
        self._s: Complexes = np.multiply(1j / self._unit, omega)
        self._powers = self._s[:, np.newaxis] ** np.arange(2 * _MOST_PAIRS - 2, -1, -1)
        self._target = _real(self._w * self._t)
        phase = np.unwrap(np.angle(tracking))
        self._longest = max(1e-3, least, float(-np.polyfit(omega, phase, 1, w=weight)[0]))
        self._least = least / self._longest

    def start(self, corner: float) -> Floats:
        """One pair, with the dead time that suits it best."""
        shares = np.linspace(self._least, 1.0, _DEAD_TIMES)
        starts = [np.array([share, np.log(corner), np.log(0.7)]) for share in shares]
        return min(starts, key=lambda p: float(np.sum(self._residuals(p) ** 2)))

    def misfit(self, model: TransferFunction) -> Floats:
        """Parameters of a pair where the error of a model is largest."""
        smooth = np.convolve(self._error(model), np.full(5, 0.2), "same")
        return np.log([float(np.abs(self._s[int(smooth.argmax())])), 0.1])

    def _error(self, model: TransferFunction) -> Floats:
        return self._w * np.abs(model.response(self._f) - self._t)

    def solved(self, start: Floats) -> tuple[TrackingFit, Floats]:
        """Best fit from a start, and its parameters."""
        pairs = len(start) // 2
        low, high = np.tile(_LOWEST, pairs), np.tile(_HIGHEST, pairs)
        bounds = np.append(self._least, low), np.append(1.5, high)
        start = np.clip(start, *bounds)
        found = least_squares(self._residuals, start, bounds=bounds, max_nfev=_MOST_STEPS).x
        numerator, denominator = np.linalg.lstsq(*self._equations(found), rcond=None)[0], np.ones(1)
        for frequency, damping in np.exp(found[1:]).reshape(-1, 2).tolist():
            pair = np.array([1.0, 2 * damping * frequency, frequency**2])
            denominator = np.convolve(denominator, pair)
        order = len(denominator) - 1
        numerator = numerator * self._unit ** (order - np.arange(len(numerator))[::-1] * 1.0)
        denominator = denominator * self._unit ** np.arange(order + 1)
        late = float(found[0] * self._longest)
        model = TransferFunction(tuple(numerator.tolist()), tuple(denominator.tolist()), late)
        error = self._error(model)
        return TrackingFit(model, float(np.linalg.norm(error) / np.linalg.norm(self._w))), found

    def _equations(self, p: Floats) -> tuple[Floats, Floats]:
        """Columns and target whose least squares give the numerator in s over the unit."""
        shape = self._w * np.exp(-self._s * self._unit * p[0] * self._longest)
        for frequency, damping in np.exp(p[1:]).reshape(-1, 2).tolist():
            shape = shape / (self._s * (self._s + 2 * damping * frequency) + frequency**2)
        degree = len(p) - 3  # two less than the denominator: the response to a step has no jump
        return _real(shape[:, np.newaxis] * self._powers[:, -degree - 1 :]), self._target

    def _residuals(self, p: Floats) -> Floats:
        columns, target = self._equations(p)
        basis, _ = np.linalg.qr(columns)
        return basis @ (basis.T @ target) - target
