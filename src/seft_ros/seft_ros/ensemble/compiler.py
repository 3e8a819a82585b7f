"""The loop's steps as machine code, kept on disk from one use to the next."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from seft_plant_sim.compiled import code_folder, numba

from seft_ros.ensemble import loop_steps


@lru_cache(maxsize=1)
def compiled_run() -> Callable[..., tuple[int, int, int, int, int]]:
    """`seft_ros.ensemble.loop_steps.run`, compiled at its first call, or read from the disk.

    It holds no lock of the interpreter, so that threads run tests side by side.
    """
    known = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(code_folder(Path(__file__).parent))
    found: Callable[..., tuple[int, int, int, int, int]] = _compile(loop_steps.run)
    numba.config.CACHE_DIR = known
    return found


def _compile(function: Callable[..., Any]) -> Any:
    try:
        return numba.njit(nogil=True, cache=True, **loop_steps.OPTIONS)(function)
    except RuntimeError:  # nowhere to be kept
        return numba.njit(nogil=True, **loop_steps.OPTIONS)(function)
