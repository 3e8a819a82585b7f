"""The loop's steps as machine code, kept on disk from one use to the next."""

import hashlib
import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from seft_plant_sim import nonlinearity, restoring_force

from seft_ros.ensemble import loop_steps, rig_step
from seft_ros.interlock import instability, ramp_down

_SOURCES = (loop_steps, rig_step, nonlinearity, restoring_force, instability, ramp_down)
"""Modules whose text is in the machine code: another text, another code."""


@lru_cache(maxsize=1)
def compiled_run() -> Callable[..., tuple[int, int, int, int, int]]:
    """`seft_ros.ensemble.loop_steps.run`, compiled at its first call, or read from the disk.

    It holds no lock of the interpreter, so that threads run tests side by side.
    """
    text = b"".join(Path(str(module.__file__)).read_bytes() for module in _SOURCES)
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    # numba itself looks at the file of the function alone, not at what that calls
    place = Path(home) / "seft" / hashlib.sha256(text).hexdigest()[:16]
    numba.config.CACHE_DIR = str(place)  # type: ignore[attr-defined]
    found: Callable[..., tuple[int, int, int, int, int]] = _compile(loop_steps.run)
    return found


def _compile(function: Callable[..., Any]) -> Any:
    try:
        return numba.njit(nogil=True, cache=True, **rig_step.OPTIONS)(function)
    except RuntimeError:  # nowhere to be kept
        return numba.njit(nogil=True, **rig_step.OPTIONS)(function)
