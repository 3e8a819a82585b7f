"""What a force controller's section of an experiment says of its kind."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from seft_ros.force_controller.names import TRANSFER_FUNCTION


def one_controller(numerator: Sequence[float], denominator: Sequence[float]) -> dict[str, Any]:
    """Give the parameters that make it so, whatever was chosen before."""
    return {
        "method": TRANSFER_FUNCTION,
        "per_axis": False,
        "gain": [1.0],
        "numerator": list(numerator),
        "denominator": list(denominator),
    }


def is_one_controller(section: dict[str, Any]) -> bool:
    """Whether a section is of one."""
    same = section.get("method", TRANSFER_FUNCTION) == TRANSFER_FUNCTION  # not in an older record
    return same and not section.get("per_axis") and np.size(section.get("gain", 1.0)) == 1
