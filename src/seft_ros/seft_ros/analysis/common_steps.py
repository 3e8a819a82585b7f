"""The steps that two series share."""

import numpy as np
import numpy.typing as npt

Steps = npt.NDArray[np.int64]
Where = slice | npt.NDArray[np.intp]


def common_steps(one: Steps, other: Steps) -> tuple[Steps, Where, Where]:
    """Find the steps that are in both, and where they stand in each.

    Where both are the same, as they mostly are, places are slices: they copy nothing.

    Parameters
    ----------
    one, other : ndarray of int64
        Shape (N,) and (M,), strictly increasing.
    """
    if np.array_equal(one, other):
        return one, slice(None), slice(None)
    common, in_one, in_other = np.intersect1d(one, other, assume_unique=True, return_indices=True)
    return common, in_one, in_other
