"""The response spectrum of a ground motion, and its characteristic numbers."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from seft_msgs_py.arrays import Floats

from seft_ros.ground_motion.conditioning import velocity_and_displacement
from seft_ros.ground_motion.readers.statements import STANDARD_GRAVITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BLOCK = 256

SPECTRUM_PERIODS = np.geomspace(0.02, 5.0, 150)
"""Natural periods of the spectrum in s."""

_DAMPING = 0.05


def response_spectrum(
    accelerations: npt.ArrayLike, dt: float, periods: npt.ArrayLike, damping: float = 0.05
) -> Floats:
    """Pseudo-acceleration response spectrum of a ground motion.

    The response of each oscillator, ``x'' + 2 z w x' + w^2 x = -a``, from rest, is exact at
    the samples for a motion that is linear between them (Nigam and Jennings, 1969). The
    recursion runs in modal form, one complex number per oscillator.

    Parameters
    ----------
    accelerations : array_like
        Shape (N,), or (N, S) for several motions, in m/s^2.
    dt : float
        Sampling period in s.
    periods : array_like
        Shape (P,), natural periods in s; 0 gives the peak ground acceleration.
    damping : float
        Damping ratio z, from 0 to below 1.

    Returns
    -------
    ndarray
        Shape (P,), or (P, S): ``w^2 max |x|`` in m/s^2, over the samples. For periods below about
        ten dt the peaks lie between samples, and the values are too small. Free vibration after the
        last sample is not included (unless a tail of zeros is appended).
    """
    a = np.asarray(accelerations, dtype=float)
    running = RunningSpectrum(periods, dt, damping)
    running.advance(a.reshape(len(a), -1))
    return running.spectrum.reshape(-1, *a.shape[1:])


class RunningSpectrum:
    """The response spectra of some motions, piece by piece; for arguments see `response_spectrum`.

    Attributes
    ----------
    spectrum : ndarray
        Shape (P, S) over the samples so far, in m/s^2; (P, 0) without samples.
    """

    def __init__(self, periods: npt.ArrayLike, dt: float, damping: float = 0.05) -> None:
        periods = np.asarray(periods, dtype=float)
        self.spectrum = np.zeros((len(periods), 0))
        self._moving = periods > 0
        w = 2 * np.pi / periods[self._moving]
        damped = w * np.sqrt(1 - damping**2)
        # with q = x' - conj(s) x:  q' = s q - a,  Im q = damped x
        z = dt * (-damping * w + 1j * damped)
        self._decay = np.exp(z)[:, np.newaxis]
        self._first = -dt * (np.expm1(z) / z - _phi2(z))[:, np.newaxis]
        self._second = -dt * _phi2(z)[:, np.newaxis]
        self._scale = (w**2 / damped)[:, np.newaxis]
        self._last: Floats | None = None

    def advance(self, accelerations: Floats) -> None:
        """Add the next samples of S motions, shape (N, S), N at least 1, in m/s^2."""
        a = accelerations
        if self._last is None:
            self._q = np.zeros((len(self._decay), a.shape[1]), complex)
            self.spectrum = np.zeros((len(self._moving), a.shape[1]))
        else:
            a = np.vstack([self._last, a])
        q, largest = self._q, np.zeros(self._q.shape)
        for start in range(0, len(a) - 1, _BLOCK):
            part = a[start : start + _BLOCK + 1, np.newaxis]
            forced = part[:-1] * self._first + part[1:] * self._second
            for row in forced:  # in place: forced becomes the response
                row += self._decay * q
                q = row
            np.maximum(largest, np.abs(forced.imag).max(axis=0), out=largest)
        self._q, self._last = q.copy(), a[-1:].copy()
        found = np.broadcast_to(np.abs(accelerations).max(axis=0), self.spectrum.shape).copy()
        found[self._moving] = self._scale * largest
        np.maximum(self.spectrum, found, out=self.spectrum)


def _phi2(z: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    """Compute (exp(z) - 1 - z) / z^2; by its series for small z, where terms would cancel."""
    series = 1 / 2 + z * (1 / 6 + z * (1 / 24 + z * (1 / 120 + z * (1 / 720 + z / 5040))))
    return np.where(np.abs(z) < 0.01, series, (np.expm1(z) - z) / z**2)


def motion_summary(samples: Floats, dt: float) -> dict[str, Any]:
    """Characteristic numbers of a ground motion.

    Parameters
    ----------
    samples : ndarray
        Shape (N, n), in m/s^2.
    dt : float
        Sampling period in s.

    Returns
    -------
    dict
        ``steps``; ``duration`` in s, from the first sample to the last; and lists with one
        number per axis: ``peak_acceleration`` in m/s^2, ``arias_intensity`` in m/s, that is
        ``pi / (2 g)`` times the integral of a^2 (Arias, 1970), and ``significant_duration``
        in s, from 5 to 95 % of it. The integral is exact for a piecewise-linear motion.
    """
    energy = _squared_integral(samples, dt)
    significant = [end - start for start, end in significant_parts(samples, dt)]
    return {
        "steps": len(samples),
        "duration": (len(samples) - 1) * dt,
        "peak_acceleration": np.abs(samples).max(axis=0).tolist(),
        "arias_intensity": (np.pi / (2 * STANDARD_GRAVITY) * energy[-1]).tolist(),
        "significant_duration": significant,
    }


def significant_parts(samples: Floats, dt: float) -> list[tuple[float, float]]:
    """Find the times, s, at which 5 and 95 % of the Arias intensity are reached, by axis."""
    times = dt * np.arange(len(samples))
    return [
        (float(np.interp(0.05 * e[-1], e, times)), float(np.interp(0.95 * e[-1], e, times)))
        for e in _squared_integral(samples, dt).T
    ]


def _squared_integral(samples: Floats, dt: float) -> Floats:
    """Integral of a^2 up to each sample, exact for a piecewise-linear motion."""
    before, after = samples[:-1], samples[1:]
    energy = np.zeros_like(samples)
    np.cumsum(dt / 3 * (before**2 + before * after + after**2), axis=0, out=energy[1:])
    return energy


def motion_figure(
    samples: Floats, dt: float, axes: Sequence[str], title: str, before: Floats | None = None
) -> "Figure":
    """Draw acceleration against time, one panel per axis, above the 5 % response spectra.

    ``samples`` have shape (N, n), in m/s^2, with sampling period ``dt`` in s; ``axes`` names their
    n axes. Samples ``before`` a correction are drawn behind, and add a panel of displacement for
    each axis. The figure is made without pyplot: save it with ``figure.savefig``.
    """
    from matplotlib.figure import Figure  # here: the monitor and reports need no figure
    from matplotlib.ticker import LogLocator

    from seft_ros.drawing.style import REFERENCE, tidy

    n = samples.shape[1]
    rows = n if before is None else 2 * n
    figure = Figure(figsize=(8.0, 3.6 + 1.9 * rows), layout="constrained")
    *panels, spectra = figure.subplots(rows + 1, 1, height_ratios=[*[1.0] * rows, 1.6])
    figure.suptitle(title)
    times = dt * np.arange(len(samples))
    limit = 1.08 * float(np.abs(samples).max()) or 1.0
    if before is not None:
        limit = max(limit, 1.08 * float(np.abs(before).max()))
        earlier = dt * np.arange(len(before))
        moved = [velocity_and_displacement(a, dt)[1] for a in (before, samples)]
        for index, panel in enumerate(panels[n:]):
            panels[index].plot(earlier, before[:, index], color=REFERENCE, linewidth=0.8)
            panel.plot(earlier, moved[0][:, index], color=REFERENCE, label="as recorded")
            panel.plot(times, moved[1][:, index], color=f"C{index}", label="corrected")
            panel.set(xlim=(0, times[-1]), ylabel="displacement / m", xlabel="time / s")
            panel.legend(title=axes[index], frameon=False)
            tidy(panel)
    for index, (name, panel) in enumerate(zip(axes, panels[:n], strict=True)):
        values = samples[:, index]
        peak = int(np.abs(values).argmax())
        panel.plot(times, values, color=f"C{index}", linewidth=0.8)
        panel.plot(times[peak], values[peak], "o", color=f"C{index}", markersize=4)
        label = f"{name}: peak {values[peak]:.3g} m/s²"
        panel.text(0.99, 0.95, label, transform=panel.transAxes, ha="right", va="top")
        panel.set(xlim=(0, times[-1] or dt), ylim=(-limit, limit), ylabel="ground acc. / (m/s²)")
        tidy(panel)
        panel.label_outer() if index < n - 1 else panel.set_xlabel("time / s")
        spectrum = response_spectrum(values, dt, SPECTRUM_PERIODS, _DAMPING)
        spectra.semilogx(SPECTRUM_PERIODS, spectrum, color=f"C{index}", label=name)
    spectra.set(
        xlim=(SPECTRUM_PERIODS[0], SPECTRUM_PERIODS[-1]),
        xlabel="natural period / s",
        ylabel="pseudo-acceleration / (m/s²)",
        title=f"response spectrum, {_DAMPING * 100:.0f} % damping",
    )
    spectra.set_ylim(bottom=0)
    spectra.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    spectra.xaxis.set_major_formatter("{x:g}")
    tidy(spectra)
    if n > 1:
        spectra.legend(title="axis", frameon=False)
    return figure
