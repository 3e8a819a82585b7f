"""``seft motion``: look at a ground motion before it moves anything."""

from pathlib import Path
from typing import Annotated, Optional

import typer
from seft_msgs_py.wire.timebase import Timebase

from seft_ros.commands.options import Json, option
from seft_ros.commands.output import show

_ROWS = {
    "peak_acceleration": "peak acceleration, m/s²",
    "arias_intensity": "Arias intensity, m/s",
    "significant_duration": "significant duration (5-95 %), s",
}


def motion(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="PEER AT2, columns or csv.")],
    column: Annotated[
        Optional[list[int]], option("Column, from 0; once for each axis to be shown.")
    ] = None,
    unit: Annotated[str, option("g, m/s2 or cm/s2.")] = "g",
    dt: Annotated[float, option("Sampling period in s, where the file has none.")] = 0.0,
    time_scale: Annotated[float, option("0.5: twice as fast.")] = 1.0,
    rate: Annotated[float, option("Rate of the loop in Hz.")] = 500.0,
    figure: Annotated[
        Optional[Path], option("Where to draw; default FILE's name + .png.", "PNG")
    ] = None,
    json: Json = False,
) -> int:
    """Show a record as a test at this rate would use it: numbers, and a figure with spectrum.

    Examples:

        seft motion kobe_nishi_akashi_090.AT2

        seft motion kobe_jma_1995.txt --unit cm/s2 --dt 0.005 --column 0 --column 1

        seft motion record.csv --unit m/s2 --time-scale 0.5 --json
    """
    from rich.table import Table

    from seft_ros.drawing.style import save_figure
    from seft_ros.ground_motion.ground_motion_block import TABLE, GroundMotion
    from seft_ros.ground_motion.response_spectrum import motion_figure, motion_summary

    columns = column or [0]
    axes = [f"column {index}" for index in columns]
    given = TABLE.check(
        {
            "file": str(file),
            "column": columns,
            "unit": unit,
            "dt": dt,
            "time_scale": time_scale,
            "tail": 0.0,
        },
        "seft motion",
    )
    defaults = {row.name: row.default for row in TABLE.rows.values()}
    block = GroundMotion.from_parameters({**defaults, **given}, axes, Timebase.from_rate(rate))
    path = figure or Path(f"{file.stem}.png")
    drawn = motion_figure(block.samples, block.timebase.dt, axes, f"{file.name}, {rate:g} Hz")
    save_figure(drawn, path)
    numbers = motion_summary(block.samples, block.timebase.dt)
    table = Table(title=f"{block.source}: {numbers['steps']} steps at {rate} Hz")
    table.add_column("")
    for axis in axes:
        table.add_column(axis, justify="right")
    for name, label in _ROWS.items():
        table.add_row(label, *(f"{value:.4g}" for value in numbers[name]))
    summary = {"source": block.source, "rate_hz": rate, **numbers, "figure": str(path)}
    show(summary, json, [table], "figure")
    return 0
