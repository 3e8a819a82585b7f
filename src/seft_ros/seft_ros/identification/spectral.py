"""Spectra of measured signals, and the responses that they hold."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.signal

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

_HANN_OVERLAP_GAIN = 0.947  # independent averages for each half-overlapped Hann segment


@dataclass(frozen=True)
class Spectra:
    """Cross-spectral densities of m signals.

    Attributes
    ----------
    frequencies_hz : ndarray
        Shape (F,).
    density : ndarray
        Shape (F, m, m): element (i, j) is the mean of conj(X_i) X_j; Hermitian.
    averages : float
        Number of independent averages.
    """

    frequencies_hz: Floats
    density: Complexes
    averages: float


@dataclass(frozen=True)
class Measurement:
    """Measured frequency response on one axis.

    Attributes
    ----------
    frequencies_hz : ndarray
        Shape (F,), increasing.
    response, deviation : ndarray
        Response and its standard deviation, shape (F,).
    coherence : ndarray
        Multiple coherence, shape (F,), 0 to 1.
    """

    frequencies_hz: Floats
    response: Complexes
    deviation: Floats
    coherence: Floats


@dataclass(frozen=True)
class Response:
    """Measured frequency response of p outputs to n inputs.

    Attributes
    ----------
    frequencies_hz : ndarray
        Shape (F,).
    response : ndarray
        Shape (F, p, n), output over input.
    coherence : ndarray
        Multiple coherence of each output with all inputs, shape (F, p), 0 to 1.
    noise : ndarray
        Covariance density of what the inputs do not explain, shape (F, p, p).
    input_gain : ndarray
        Variance of column j of the response per unit of noise, shape (F, n).
    """

    frequencies_hz: Floats
    response: Complexes
    coherence: Floats
    noise: Complexes
    input_gain: Floats

    def variance(self) -> Floats:
        """Variance of each element of the response, shape (F, p, n)."""
        power = np.einsum("fii->fi", self.noise).real
        product: Floats = power[:, :, np.newaxis] * self.input_gain[:, np.newaxis, :]
        return product

    def of_axis(self, axis: int) -> Measurement:
        """Response of one output to the input of its place."""
        return Measurement(
            self.frequencies_hz,
            self.response[:, axis, axis],
            np.sqrt(np.maximum(self.variance()[:, axis, axis], 0.0)),
            self.coherence[:, axis],
        )


def spectra(signals: Floats, rate: float, segment: float) -> Spectra:
    """Cross-spectral densities by Welch's method: Hann windows, half overlapped.

    Of signals of shape (N, m), sampled at a rate in Hz, in segments of so many s.
    """
    length = min(int(segment * rate), len(signals))
    columns = signals.T
    frequencies, density = scipy.signal.csd(
        columns[:, np.newaxis],
        columns[np.newaxis],
        fs=rate,
        window="hann",
        nperseg=length,
        noverlap=length // 2,
        detrend=False,  # the signals are free of drift, or what drifts is part of them
    )
    count = (len(signals) - length // 2) // (length - length // 2)
    averages = max(1.0, _HANN_OVERLAP_GAIN * count) if count > 1 else 1.0
    return Spectra(frequencies, np.moveaxis(density, -1, 0), averages)


def response(
    measured: Spectra, inputs: slice, outputs: slice, band: tuple[float, float]
) -> Response:
    """Response of some signals to others, H1 = S_yu S_uu^-1, unbiased by noise of the outputs.

    The slices say which signals are the n inputs and the p outputs; the band is in Hz.
    """
    low, high = band
    within = (measured.frequencies_hz >= low) & (measured.frequencies_hz <= high)
    density = measured.density[within]
    # element (i, j) of a density has the conjugate on i: S_yu in the usual writing is (u, y)
    s_uu = np.swapaxes(density[:, inputs, inputs], 1, 2)
    s_yu = np.swapaxes(density[:, inputs, outputs], 1, 2)
    s_yy = np.swapaxes(density[:, outputs, outputs], 1, 2)
    inverse = np.linalg.inv(s_uu)
    found = s_yu @ inverse
    explained = found @ np.conj(np.swapaxes(s_yu, 1, 2))
    total = np.einsum("fii->fi", s_yy).real
    share = np.einsum("fii->fi", explained).real / np.where(total > 0, total, 1.0)
    spare = measured.averages - s_uu.shape[1]
    noise = (s_yy - explained) * (measured.averages / spare if spare > 0 else 1.0)
    gain = np.einsum("fii->fi", inverse).real / measured.averages
    return Response(measured.frequencies_hz[within], found, np.clip(share, 0.0, 1.0), noise, gain)
