"""Figure of a ground motion: accelerations and response spectra."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from seft_ros.drawing.style import tidy
from seft_ros.ground_motion.response_spectrum import response_spectrum

PERIODS = np.geomspace(0.02, 5.0, 150)
"""Natural periods of the spectrum in s."""

_DAMPING = 0.05


def motion_figure(
    samples: npt.NDArray[np.float64], dt: float, axes: Sequence[str], title: str
) -> Figure:
    """Draw acceleration against time, one panel per axis, above the 5 % response spectra.

    ``samples`` have shape (N, n), in m/s^2, with sampling period ``dt`` in s; ``axes`` names their
    n axes. The figure is made without pyplot: save it with ``figure.savefig``.
    """
    n = samples.shape[1]
    figure = Figure(figsize=(8.0, 3.6 + 1.9 * n), layout="constrained")
    *panels, spectra = figure.subplots(n + 1, 1, height_ratios=[*[1.0] * n, 1.6])
    figure.suptitle(title)
    times = dt * np.arange(len(samples))
    limit = 1.08 * float(np.abs(samples).max()) or 1.0
    for index, (name, panel) in enumerate(zip(axes, panels, strict=True)):
        values = samples[:, index]
        peak = int(np.abs(values).argmax())
        panel.plot(times, values, color=f"C{index}", linewidth=0.8)
        panel.plot(times[peak], values[peak], "o", color=f"C{index}", markersize=4)
        label = f"{name}: peak {values[peak]:.3g} m/s²"
        panel.text(0.99, 0.95, label, transform=panel.transAxes, ha="right", va="top")
        panel.set(xlim=(0, times[-1] or dt), ylim=(-limit, limit), ylabel="ground acc. (m/s²)")
        tidy(panel)
        panel.label_outer() if index < n - 1 else panel.set_xlabel("time (s)")
        spectrum = response_spectrum(values, dt, PERIODS, _DAMPING)
        spectra.semilogx(PERIODS, spectrum, color=f"C{index}", label=name)
    spectra.set(
        xlim=(PERIODS[0], PERIODS[-1]),
        xlabel="natural period (s)",
        ylabel="pseudo-acceleration (m/s²)",
        title=f"response spectrum, {_DAMPING:.0%} damping",
    )
    spectra.set_ylim(bottom=0)
    spectra.xaxis.set_major_formatter("{x:g}")
    tidy(spectra)
    if n > 1:
        spectra.legend(title="axis", frameon=False)
    return figure
