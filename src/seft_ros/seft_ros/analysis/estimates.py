"""What a compensation method has identified on line, in numbers for people and programs."""

from typing import Any

import numpy as np

from seft_ros.recording.record import Estimates

_UNITS = {"delay": ("ms", 1e3), "stiffness": ("kN/m", 1e-3), "damping": ("N s/m", 1.0)}


def summarise_estimates(
    estimates: Estimates | None, axes: tuple[str, ...]
) -> dict[str, dict[str, dict[str, float]]]:
    """Summarise how each estimate went, in SI units.

    Returns
    -------
    dict
        Name -> axis -> ``first``, ``last``, ``least`` and ``largest``; empty if nothing was
        identified.
    """
    if estimates is None:
        return {}
    return {
        name: {
            axis: {
                "first": float(values[0]),
                "last": float(values[-1]),
                "least": float(np.min(values)),
                "largest": float(np.max(values)),
            }
            for axis, values in zip(axes, estimates.values[:, row].T, strict=True)
        }
        for row, name in enumerate(estimates.names)
    }


def estimate_lines(summary: dict[str, Any]) -> list[str]:
    """Tell how each estimate of a summary went, one line each."""
    return [
        f"{name} as identified: "
        + ", ".join(
            f"{axis} {_course(name, found)}" if len(by_axis) > 1 else _course(name, found)
            for axis, found in by_axis.items()
        )
        for name, by_axis in summary["estimates"].items()
    ]


def _course(name: str, found: dict[str, float | None]) -> str:
    unit, scale = shown_unit(name)
    values = (found[key] for key in ("first", "last", "least", "largest"))
    first, last, least, largest = ("-" if v is None else f"{v * scale:.4g}" for v in values)
    return f"{first} to {last} {unit}".rstrip() + f" (between {least} and {largest})"


def shown_unit(name: str) -> tuple[str, float]:
    """Give the unit in which people read an estimate and its factor from SI; if unknown, none."""
    return _UNITS.get(name, ("", 1.0))
