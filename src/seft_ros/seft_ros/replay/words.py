"""Words for what a replay could not do as the test did."""

import numpy as np
import numpy.typing as npt


def listed(what: str, steps: npt.ArrayLike) -> str:
    """Say of how many steps, and name the first."""
    first, *more = np.asarray(steps).tolist()
    return f"{what}: step {first}" + (f" and {len(more)} more" if more else "")
