"""State-space form of a transfer function."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def companion_form(numerator: Floats, denominator: Floats) -> tuple[Floats, Floats, Floats, float]:
    """Make the controllable canonical form of a proper transfer function.

    It is made in s over the fastest pole: in s itself its entries spread over many decades.

    Parameters
    ----------
    numerator, denominator : ndarray
        In s, highest power first, without leading zeros; the numerator no longer than the
        denominator.

    Returns
    -------
    a, b, c : ndarray
        Shapes (s, s), (s,) and (s,).
    d : float
        Direct part.
    """
    order = denominator.size - 1
    scale = float(np.abs(np.roots(denominator)).max(initial=0.0)) or 1.0
    powers = scale ** np.arange(order, -1.0, -1.0)
    den = denominator * powers
    num = np.concatenate([np.zeros(order + 1 - numerator.size), numerator]) * powers / den[0]
    den = den / den[0]
    a = np.eye(order, k=-1)
    a[:1] = -den[1:]
    return scale * a, scale * np.eye(order, 1)[:, 0], num[1:] - num[0] * den[1:], float(num[0])
