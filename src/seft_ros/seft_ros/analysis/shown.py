"""How people read the quantities of a test."""

UNITS = {"displacement": ("mm", 1e3), "force": ("N", 1.0), "acceleration": ("m/s²", 1.0)}
"""Quantity, in the order in which they are shown -> its unit, and the factor from SI."""


def number(value: float | None, scale: float, unit: str) -> str:
    """Show a number in a unit; a dash where there is none."""
    return "-" if value is None else f"{value * scale:.4g} {unit}".rstrip()
