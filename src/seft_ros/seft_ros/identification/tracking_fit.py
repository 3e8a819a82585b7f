"""Low-order fit of the closed loop, from reference force to measured force."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from seft_plant_sim.lti import TransferFunction

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_GOOD = 0.01
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

    The model is continuous and stable, and its dead time holds the loop's latency. Beside it
    stands the RMS of its error; |T| is near 1 where the loop is good.
    """

    model: TransferFunction
    error: float


def fit_tracking(
    frequencies_hz: Floats, tracking: Complexes, weight: Floats, least_dead_time: float = 0.0
) -> TrackingFit:
    """Fit as few pole pairs with dead time as are good to 1 %, or nearly as good as five.

    Each further pair starts where the last fit is furthest off, and comes with two zeros. Poles
    and dead time are sought, the numerator follows by linear least squares.

    Parameters
    ----------
    frequencies_hz, tracking, weight : ndarray
        Increasing, Hz; T from reference force to measured force there; weight of its error; (F,).
    least_dead_time : float
        Dead time that is there at any rate, s.
    """
    step = max(1, len(frequencies_hz) // _POINTS)
    data = _Data(frequencies_hz[::step], tracking[::step], weight[::step], least_dead_time)
    first = (data.solved(data.start(corner)) for corner in _CORNERS)
    fit, parameters = min(first, key=lambda found: found[0].error)
    fits = [fit]
    while fit.error >= _GOOD and len(fits) < _MOST_PAIRS:
        wider = np.concatenate([parameters[:1], data.misfit(fit.model), parameters[1:]])
        fit, parameters = data.solved(wider)
        fits.append(fit)
    least = min(fit.error for fit in fits)
    return next(fit for fit in fits if fit.error <= max(_GOOD, _NEAR * least))


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
        phase = np.unwrap(np.angle(tracking))
        self._longest = max(1e-3, least, float(-np.polyfit(omega, phase, 1, w=weight)[0]))
        self._least = least / self._longest

    def start(self, corner: float) -> Floats:
        """One pair, with the dead time that suits it best."""
        starts = [
            np.array([share, np.log(corner), np.log(0.7)])
            for share in np.linspace(self._least, 1.0, _DEAD_TIMES)
        ]
        return min(starts, key=lambda p: float(np.sum(self._residuals(p) ** 2)))

    def misfit(self, model: TransferFunction) -> Floats:
        """Parameters of a pair where a model is furthest off."""
        smooth = np.convolve(self._error(model), np.full(5, 0.2), "same")
        return np.log([float(np.abs(self._s[int(smooth.argmax())])), 0.1])

    def _error(self, model: TransferFunction) -> Floats:
        error: Floats = self._w * np.abs(model.response(self._f) - self._t)
        return error

    def solved(self, start: Floats) -> tuple[TrackingFit, Floats]:
        """Best fit from a start, and its parameters."""
        pairs = len(start) // 2
        bounds = (
            np.concatenate([[self._least], np.tile(_LOWEST, pairs)]),
            np.concatenate([[1.5], np.tile(_HIGHEST, pairs)]),
        )
        start = np.clip(start, *bounds)
        found = least_squares(self._residuals, start, bounds=bounds, max_nfev=_MOST_STEPS).x
        numerator, denominator = self._polynomials(found)
        order = len(denominator) - 1
        numerator = numerator * self._unit ** (order - np.arange(len(numerator))[::-1] * 1.0)
        denominator = denominator * self._unit ** np.arange(order + 1)
        late = float(found[0] * self._longest)
        model = TransferFunction(tuple(numerator.tolist()), tuple(denominator.tolist()), late)
        error = self._error(model)
        return TrackingFit(model, float(np.linalg.norm(error) / np.linalg.norm(self._w))), found

    def _lag(self, p: Floats) -> Complexes:
        """Dead time at every frequency."""
        lag: Complexes = np.exp(-self._s * self._unit * p[0] * self._longest)
        return lag

    def _polynomials(self, p: Floats) -> tuple[Floats, Floats]:
        """Numerator and denominator in s over the unit."""
        denominator = np.ones(1)
        for frequency, damping in np.exp(p[1:]).reshape(-1, 2):
            pair = np.array([1.0, 2 * damping * frequency, frequency**2])
            denominator = np.polymul(denominator, pair)
        degree = len(denominator) - 3  # two less: what is asked in a jump comes without one
        shape = self._w * self._lag(p) / np.polyval(denominator, self._s)
        columns = shape[:, np.newaxis] * self._s[:, np.newaxis] ** np.arange(degree, -1, -1)
        target = self._w * self._t
        numerator = np.linalg.lstsq(
            np.concatenate([columns.real, columns.imag]),
            np.concatenate([target.real, target.imag]),
            rcond=None,
        )[0]
        return numerator, denominator

    def _residuals(self, p: Floats) -> Floats:
        numerator, denominator = self._polynomials(p)
        ratio = np.polyval(numerator, self._s) / np.polyval(denominator, self._s)
        error = self._w * (ratio * self._lag(p) - self._t)
        return np.concatenate([error.real, error.imag])
