"""``seft motion``: look at a ground motion before it moves anything."""

from pathlib import Path
from typing import Annotated, Optional

import typer
from seft_msgs_py.wire.timebase import Timebase

from seft_ros.commands.options import JsonOption, print_json


def motion(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="PEER AT2, columns or csv.")],
    column: Annotated[
        Optional[list[int]],
        typer.Option("--column", help="Column, from 0; once for each axis to be shown."),
    ] = None,
    unit: Annotated[str, typer.Option("--unit", help="g, m/s2 or cm/s2.")] = "g",
    dt: Annotated[
        float, typer.Option("--dt", help="Sampling period in s, where the file has none.")
    ] = 0.0,
    time_scale: Annotated[float, typer.Option("--time-scale", help="0.5: twice as fast.")] = 1.0,
    rate: Annotated[float, typer.Option("--rate", help="Rate of the loop in Hz.")] = 500.0,
    figure: Annotated[
        Optional[Path],
        typer.Option("--figure", metavar="PNG", help="Where to draw; default FILE's name + .png."),
    ] = None,
    json: JsonOption = False,
) -> int:
    """Show a record as a test at this rate would use it: numbers, and a figure with spectrum.

    Examples:

        seft motion kobe_nishi_akashi_090.AT2

        seft motion kobe_jma_1995.txt --unit cm/s2 --dt 0.005 --column 0 --column 1

        seft motion record.csv --unit m/s2 --time-scale 0.5 --json
    """
    from seft_ros.drawing.style import save_figure
    from seft_ros.ground_motion.block import GroundMotion
    from seft_ros.ground_motion.figure import motion_figure
    from seft_ros.ground_motion.parameters import TABLE
    from seft_ros.ground_motion.spectrum import motion_summary

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
    summary = {"source": block.source, "rate_hz": rate, **motion_summary(block)}
    summary["figure"] = str(path)
    if json:
        print_json(summary)
    else:
        _show(summary, axes)
    return 0


def _show(summary: dict[str, object], axes: list[str]) -> None:
    from rich.console import Console
    from rich.table import Table

    rows = (
        ("peak acceleration", "m/s²", "peak_acceleration"),
        ("Arias intensity", "m/s", "arias_intensity"),
        ("significant duration (5-95 %)", "s", "significant_duration"),
    )
    table = Table(title=f"{summary['source']}: {summary['steps']} steps at {summary['rate_hz']} Hz")
    table.add_column("")
    for axis in axes:
        table.add_column(axis, justify="right")
    for label, unit, key in rows:
        values = summary[key]
        assert isinstance(values, list)
        table.add_row(f"{label}, {unit}", *(f"{value:.4g}" for value in values))
    console = Console()
    console.print(table)
    console.print(f"figure: {summary['figure']}", soft_wrap=True, highlight=False)
