"""What a conformance test found, for people."""

from collections.abc import Sequence
from typing import Any

from rich.text import Text

from seft_ros.conformance.finding import Finding

_MARKS = {
    "passed": ("passed ", "green"),
    "failed": ("FAILED ", "red"),
    "not run": ("not run", "dim"),
}


def finding_line(finding: Finding) -> Text:
    """Say in one line what a check found; below, how to mend it."""
    mark, colour = _MARKS[finding.verdict]
    text = Text.assemble((mark, f"bold {colour}"), f"  {finding.check}: {finding.told}")
    if finding.mend:
        text.append(f"\n           -> {finding.mend}")
    return text


def verdict(findings: Sequence[Finding]) -> dict[str, Any]:
    """Judge a rig by all findings; JSON values.

    Returns
    -------
    dict
        ``conforms``, how many checks ``passed``, ``failed`` and were ``not_run``, and ``checks``:
        of each ``check``, ``verdict``, ``told``, ``mend``, ``measured``.
    """
    counts = {
        word.replace(" ", "_"): sum(finding.verdict == word for finding in findings)
        for word in ("passed", "failed", "not run")
    }
    checks = [
        {
            "check": finding.check,
            "verdict": finding.verdict,
            "told": finding.told,
            "mend": finding.mend or None,
            "measured": finding.measured,
        }
        for finding in findings
    ]
    return {"conforms": not counts["failed"] and bool(findings), **counts, "checks": checks}
