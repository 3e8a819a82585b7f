"""Time histories and spectra as csv, with the unit of each column in its name."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, VALVE_COMMAND
from seft_plant_sim.whole_structure import ReferenceResponse

from seft_ros.bags.record import Record, Series
from seft_ros.drawing.style import check_file

_STATE = ("displacement (m)", "velocity (m/s)", "acceleration (m/s^2)", "force (N)")
_EXACT = {"displacement": "m", "acceleration": "m/s^2", "force": "N"}


def check_table(path: Path) -> Path:
    """Complete the name of a csv file, before the work is done that it holds.

    An InputError says that there is no such folder, or that the name does not end in .csv.
    """
    return check_file(path, "tables", ".csv", [".csv"])


def write_table(path: Path, names: Sequence[str], table: Floats) -> None:
    """Write columns, shape (N, c), as csv with their names; what is not known (NaN) is empty.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    rows = (["" if value != value else repr(value) for value in row] for row in table.tolist())
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([names, *rows])
    except OSError as error:
        raise InputError(f"{path}: the table can't be written ({error.strerror})") from None


def histories(record: Record, reference: ReferenceResponse | None) -> tuple[list[str], Floats]:
    """Give the histories of a test: a row for each step of the rig, a column for each quantity.

    Parameters
    ----------
    record : Record
        Of the test.
    reference : ReferenceResponse or None
        Its exact response, from step 0; None: unknown.

    Returns
    -------
    names : list of str
        ``time (s)``, then for each axis ground acceleration, displacement, velocity,
        acceleration, force, reference force, valve command, and the exact displacement,
        acceleration and force; with the axis in front where there are several.
    table : ndarray
        Shape (N, c); NaN where a sample was lost.
    """
    axes, steps = record.experiment.axes, record.states.steps
    columns = [("time (s)", steps * record.experiment.timebase.dt)]
    for axis, name in enumerate(axes):
        prefix = f"{name} " if len(axes) > 1 else ""
        columns += [(prefix + label, y) for label, y in _of_axis(record, reference, steps, axis)]
    names, values = zip(*columns, strict=True)
    return list(names), np.stack(values, axis=1)


def _of_axis(
    record: Record, reference: ReferenceResponse | None, steps: Ints, axis: int
) -> Iterable[tuple[str, Floats]]:
    def of(topic: str, quantity: int) -> Floats:
        return _at(record.series[topic], steps, quantity, axis)

    def measured(quantity: int) -> Floats:
        return _at(record.states, steps, quantity, axis)

    yield "ground acceleration (m/s^2)", of(GROUND_MOTION.name, 0)
    for quantity, label in enumerate(_STATE):
        yield label, measured(quantity)
    yield "reference force (N)", of(REFERENCE_FORCE.name, -1)
    yield "valve command (V)", of(VALVE_COMMAND.name, 0)
    for name, unit in _EXACT.items() if reference is not None else ():
        exact = getattr(reference, name)[:, axis]
        known = np.full(len(steps), np.nan)
        there = steps < len(exact)
        known[there] = exact[steps[there]]
        yield f"exact {name} ({unit})", known


def _at(series: Series, steps: Ints, quantity: int, axis: int) -> Floats:
    """Values at these steps; NaN where there is none."""
    found = np.full(len(steps), np.nan)
    if len(series.steps):
        places = np.minimum(np.searchsorted(series.steps, steps), len(series.steps) - 1)
        there = series.steps[places] == steps
        found[there] = series.values[places[there], quantity, axis]
    return found
