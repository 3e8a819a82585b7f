"""Signals of a test that the page shows, as columns of its history."""

from typing import Any

from seft_msgs_py.wire.topics import RIG_STATE

MEASURED = ("displacement", "acceleration", "force")
ROWS = tuple(RIG_STATE.quantities.index(name) for name in ("positions", "accelerations", "effort"))
"""Rows of a sample of rig/state that hold them."""


class Signals:
    """Columns of a history over n axes: measured, reference, and the answer's time.

    Attributes
    ----------
    axes : tuple of str
        Names of the n axes.
    measured, reference : dict of str to slice
        Columns of a quantity in `MEASURED`, one an axis; m, m/s^2, N.
    answer : slice
        Time from a state's publication to that of its reference force, ms.
    count : int
        Number of columns.
    """

    def __init__(self, axes: tuple[str, ...]) -> None:
        n = len(axes)
        self.axes = axes
        self.measured = {q: slice(2 * i * n, (2 * i + 1) * n) for i, q in enumerate(MEASURED)}
        self.reference = {
            q: slice((2 * i + 1) * n, (2 * i + 2) * n) for i, q in enumerate(MEASURED)
        }
        self.answer = slice(2 * n * len(MEASURED), 2 * n * len(MEASURED) + 1)
        self.count = self.answer.stop

    def told(self) -> dict[str, Any]:
        """Where what stands, for the page."""
        return {
            "axes": list(self.axes),
            "measured": {name: part.start for name, part in self.measured.items()},
            "reference": {name: part.start for name, part in self.reference.items()},
            "answer": self.answer.start,
        }
