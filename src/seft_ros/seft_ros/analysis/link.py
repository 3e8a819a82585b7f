"""How the reference force came over the link of a test on several hosts."""

from collections.abc import Mapping
from typing import Any

from seft_ros.recording.record import Record

_SHARES = {"p50": 0.5, "p99": 0.99}


def link_numbers(record: Record) -> dict[str, Any] | None:
    """Summarise what the force controller counted.

    Returns
    -------
    dict or None
        ``loop_delay`` (steps), ``age`` of the messages in steps (p50, p99, largest), ``late``
        (forces whose message was older than the loop's delay: they are predictions), ``held``
        (forces of which no message told: the one before was held), ``forces`` (all of them); None
        where no link lies between reference force and force controller, or nothing was told.
    """
    link, section = record.link, record.experiment.sections.get("reference_force", {})
    loop_delay = section.get("loop_delay", 0)
    total = sum(link.ages.values()) if link is not None else 0
    if link is None or not loop_delay or not total:
        return None
    return {
        "loop_delay": loop_delay,
        "age": {name: _quantile(link.ages, share * total) for name, share in _SHARES.items()}
        | {"largest": max(link.ages)},
        "late": link.older_than(loop_delay),
        "held": link.held,
        "forces": total,
    }


def _quantile(ages: Mapping[int, int], rank: float) -> int:
    below = 0
    for age in sorted(ages):
        below += ages[age]
        if below >= rank:
            return age
    return max(ages)
