"""Reference and measured force as an on-line fit wants them: in a band, and in blocks."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from seft_ros.reference_force.compensation.delay.band_pass import BandPass

Floats = npt.NDArray[np.float64]


class ForceBlocks:
    """Passes both forces of n axes through the same band-pass and hands them out in blocks.

    Parameters
    ----------
    band : sequence of float
        Edges of the band-pass, Hz.
    dt : float
        Sampling period, s.
    axes : int
        Number of axes n.
    past, block : int
        Steps before a block that come with it, and steps of a block.

    Raises
    ------
    InputError
        If the band does not fit the sampling rate.
    """

    def __init__(self, band: Sequence[float], dt: float, axes: int, past: int, block: int) -> None:
        self._band = BandPass(band, dt, 2 * axes)
        self._raw = np.zeros((2, axes))
        self._samples = np.zeros((past + block, 2, axes))
        self._past = self._row = past

    def reset(self) -> None:
        """Forget the past."""
        self._band.reset()
        self._samples[:] = 0.0
        self._row = self._past

    def step(self, reference: Floats, measured: Floats) -> Floats | None:
        """Take in the forces of one step, shape (n,) each, N.

        A step with a value that is not finite is left out.

        Returns
        -------
        ndarray or None
            With the last step of a block, the steps before it and its own, shape (past + block, 2,
            n): reference force and measured force in the band. It holds until the next step.
        """
        if self._row == len(self._samples):
            self._samples[: self._past] = self._samples[-self._past :]
            self._row = self._past
        raw = self._raw
        raw[0] = reference
        raw[1] = measured
        if not math.isfinite(raw.sum()):
            return None
        self._samples[self._row] = self._band.step(raw.ravel()).reshape(raw.shape)
        self._row += 1
        return self._samples if self._row == len(self._samples) else None
