"""One step of the transfer functions of a force controller, compiled."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from seft_plant_sim.compiled import compiled, multiply

Floats = npt.NDArray[np.float64]


class TransferParameters(NamedTuple):
    """What does not change of a controller of n axes with d delays.

    Attributes
    ----------
    matrix : ndarray
        Shape (d + n, n + d), transposed: takes (delays, error) to (drive, delays) without a limit.
    from_drive : ndarray
        What the delays lose with a change of the drive, shape (d, n).
    limit : float
        Largest magnitude of the drive, V.
    feedback : bool
        Whether the measured force is fed back.
    """

    matrix: Floats
    from_drive: Floats
    limit: float
    feedback: bool


class TransferState(NamedTuple):
    """What changes of it.

    Attributes
    ----------
    work, result : ndarray
        Delays and error, and what the matrix makes of them, shape (d + n,).
    """

    work: Floats
    result: Floats


@compiled
def transfer_step(
    parameters: TransferParameters,
    state: TransferState,
    points: Floats,
    measured: Floats,
    command: Floats,
) -> bool:
    """Find the drive that answers a sample.

    Parameters
    ----------
    parameters, state
        The state is brought up to date.
    points : ndarray
        Of the reference force, shape (p, q, n).
    measured : ndarray
        Displacement, velocity, acceleration and force, shape (4, n).
    command : ndarray
        The result, shape (n,), V.

    Returns
    -------
    bool
        Whether the drive is at its limit on any axis.
    """
    p, work, result, n = parameters, state.work, state.result, len(command)
    delays, last, limited = len(work) - n, points.shape[1] - 1, False
    for i in range(n):
        error = points[0, last, i]
        work[delays + i] = error - measured[3, i] if p.feedback else error
    multiply(p.matrix, work, result)
    for i in range(n):
        drive = result[i]
        if abs(drive) >= p.limit:
            limited = True
            drive = p.limit if drive > 0.0 else -p.limit
        command[i] = drive
    for j in range(delays):
        work[j] = result[n + j]
    if limited:
        for j in range(delays):
            for i in range(n):
                work[j] -= p.from_drive[j, i] * (command[i] - result[i])
    return limited
