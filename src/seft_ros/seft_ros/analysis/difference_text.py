"""A comparison in words: the verdict, where two records first differ, what is not common."""

from typing import Any


def difference_lines(comparison: dict[str, Any], a: str = "a", b: str = "b") -> list[str]:
    """Say how two records differ, the verdict first.

    Parameters
    ----------
    comparison : dict
        As `seft_ros.analysis.compare.compare` gives it.
    a, b : str
        What the records are called.
    """
    names = {"a": a, "b": b}
    first, value = (comparison[key] for key in ("first_difference", "first_value_difference"))
    lines = [verdict(comparison, a, b) + _held(comparison["missed"], names)]
    if first is not None and first["field"] is None:
        lines.append(
            "all samples that both have are equal, bit for bit"
            if value is None
            else f"first value that differs, {_where(value, names)}"
        )
    rates, lengths = comparison["rate_hz"], comparison["length_s"]
    if comparison["aligned_by"] == "time":
        lines.append(
            f"rates differ ({rates['a']:g} Hz in {a}, {rates['b']:g} Hz in {b}): compared are the "
            "samples at times that both have"
        )
    if lengths["a"] != lengths["b"]:
        lines.append(f"lengths differ: {lengths['a']:g} s in {a}, {lengths['b']:g} s in {b}")
    alone = [
        f"{', '.join(comparison['axes'][f'only_{key}'])} only in {names[key]}"
        for key in ("a", "b")
        if comparison["axes"][f"only_{key}"]
    ]
    if alone:
        compared = ", ".join(comparison["axes"]["compared"])
        lines.append(f"axes differ: {'; '.join(alone)}; compared: {compared}")
    return lines


def verdict(comparison: dict[str, Any], a: str = "a", b: str = "b") -> str:
    """Say whether two records are identical, and if not, where they first differ."""
    first = comparison["first_difference"]
    if comparison["identical"]:
        return "identical, bit for bit"
    if first is None:
        return "not the same test, but equal, bit for bit, where both have samples"
    return f"first difference {_where(first, {'a': a, 'b': b})}"


def _where(first: dict[str, Any], names: dict[str, str]) -> str:
    where = f"at step {first['step']}"
    if "step_b" in first:
        where += f" of {names['a']} ({first['step_b']} of {names['b']})"
    where += f", {first['topic']}"
    if first["field"] is None:
        lacking = "a" if first["a"] == "missing" else "b"
        return f"{where}: the sample is missing in {names[lacking]}"
    values = f"{first['a']!r} in {names['a']}, {first['b']!r} in {names['b']}"
    return f"{where}, {first['field']} of axis {first['axis']}: {values}"


def _held(missed: dict[str, int | None], names: dict[str, str]) -> str:
    held = ", ".join(f"{missed[key]} in {names[key]}" for key in ("a", "b") if missed[key])
    return f"; steps without a command in time: {held}" if held else ""
