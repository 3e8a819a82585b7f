"""How reference forces came over the link in a test, as the force controller counts it."""

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class LinkRecord:
    """Ages of the messages that the forces of a test were taken from.

    Attributes
    ----------
    ages : mapping of int to int
        Steps between the step of a force and that of its message -> number of forces.
    held : int
        Forces that no message brought: the one before was held.
    """

    ages: Mapping[int, int]
    held: int

    @classmethod
    def of_all(cls, records: Iterable["LinkRecord"]) -> "LinkRecord":
        """Add up what the force controllers of several rigs tell."""
        ages: Counter[int] = Counter()
        held = 0
        for record in records:
            ages.update(record.ages)
            held += record.held
        return cls(dict(sorted(ages.items())), held)

    def older_than(self, loop_delay: int) -> int:
        """Count the forces whose messages were older than the loop's delay: bridged ones."""
        return sum(count for age, count in self.ages.items() if age > loop_delay)

    def to_json(self) -> str:
        """Text for a status."""
        return json.dumps(
            {"ages": {str(age): n for age, n in self.ages.items()}, "held": self.held}
        )

    @classmethod
    def from_json(cls, text: str) -> "LinkRecord":
        """Read what `to_json` wrote.

        Raises
        ------
        ValueError
            If it is something else.
        """
        try:
            values = json.loads(text)
            ages = {int(age): int(count) for age, count in values["ages"].items()}
            return cls(ages, int(values["held"]))
        except (AttributeError, KeyError, TypeError, OverflowError, RecursionError) as error:
            raise ValueError(f"link: {error}") from None
