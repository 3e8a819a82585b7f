"""``seft preflight``: stability and delay margins before anything moves."""

from pathlib import Path
from typing import Annotated, Optional

from seft_ros.commands.options import (
    Config,
    External,
    Files,
    Json,
    Params,
    Plant,
    load_experiment,
    option,
)
from seft_ros.commands.output import complain, late_progress, show
from seft_ros.design import Source


def preflight(
    config: Config,
    param: Params = None,
    params_file: Files = None,
    external: External = None,
    plant: Plant = Source.AUTO,
    figure: Annotated[
        Optional[Path],
        option(
            "Draw where the test would be stable: mass ratio against dead time, and against "
            "the specimen's local stiffness.",
            "FILE",
        ),
    ] = None,
    write: Annotated[
        Optional[Path],
        option("Write limits that fit the test into a parameter file, for --params-file.", "FILE"),
    ] = None,
    json: Json = False,
) -> int:
    """Tell whether a planned test is stable, and how far from its limits, without moving anything.

    Takes the eigenvalues of the sampled closed loop of rig, compensation and force controller:
    critical mass ratio, critical delay, margins against a wrong gain and a wrong delay, and the
    false damping that the test will show; and sweeps the specimen's local stiffness from 0 to 3
    times the told one. Exact where the loop is linear; the table says what that does not promise.

    The exact response of the planned test gives the peaks to expect, and limits that fit them.

    Exit status 1: the plan is unstable.

    Examples:

        seft preflight config/jhu.yaml -p reference_force:mass_ratio:=1.0

        seft preflight config/demo.yaml --figure preflight.png

        seft preflight config/jhu.yaml --write limits.yaml

        seft preflight config/jhu.yaml --params-file identified/model.yaml --plant identified
    """
    from seft_ros.design.plan import Plan
    from seft_ros.design.preflight_tables import (
        expected_peaks,
        limits_table,
        preflight_tables,
        proposed_limits,
        summarise,
        write_limits,
    )
    from seft_ros.design.stability_map import preflight_figure, stability_maps
    from seft_ros.design.stability_verdict import preflight as fly
    from seft_ros.drawing.style import check_figure, save_figure

    path = check_figure(figure) if figure is not None else None
    experiment = load_experiment(config, param, params_file, external)
    plan = Plan(experiment, plant)
    with late_progress() as tell:
        found = fly(plan, tell)
        summary = summarise(plan, found)
        peaks = expected_peaks(experiment)
        limits = proposed_limits(peaks)
        summary |= {"expected_peaks": peaks, "proposed_limits": limits}
        if write is not None:
            write_limits(write, limits)
        if path is not None:
            maps = stability_maps(plan, found.margins, tell)
            save_figure(preflight_figure(plan, found, maps), path)
            summary["figure"] = str(path)
    tables = preflight_tables(plan, found, f"preflight of {config}")
    show(summary, json, [*tables, limits_table(experiment, peaks)], "figure")
    for reason in found.reasons:
        complain(f"{found.verdict}: {reason}")
    return 1 if found.verdict == "unstable" else 0
