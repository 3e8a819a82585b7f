"""``seft paper``: the paper's figures and claims, reproduced."""

from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError

from seft_ros.commands.options import Files, Json, Params, load_experiment, option
from seft_ros.commands.output import show, step_progress


def paper(
    config: Annotated[
        Optional[Path],
        typer.Argument(
            metavar="[CONFIG]",
            help="Experiment: a ROS 2 parameter file; default the paper's rig, config/jhu.yaml, as "
            "installed.",
            show_default=False,
        ),
    ] = None,
    file: Annotated[
        Optional[Path],
        option(
            "Record: PEER AT2, columns or csv. The paper's is Kobe 1995, JMA N-S. Default: "
            "CONFIG's motion, which is synthetic.",
            "MOTION",
        ),
    ] = None,
    unit: Annotated[Optional[str], option("g, m/s2 or cm/s2; default g.")] = None,
    dt: Annotated[Optional[float], option("Sampling period in s, where the file has none.")] = None,
    column: Annotated[
        Optional[int], option("Column of the file, from 0; default the first.")
    ] = None,
    out: Annotated[Path, option("The page.", "HTML")] = Path("paper.html"),
    workers: Annotated[
        Optional[int], option("Processes that calculate; default one for each core.", min=1)
    ] = None,
    param: Params = None,
    params_file: Files = None,
    json: Json = False,
) -> int:
    """Reproduce the figures and claims of the paper (Nakata & Combs 2012) on one page.

    Identifies the simulated rig, runs the paper's tests and simulations, and judges every number
    and statement by a criterion that stands beside it. Results do not depend on the number of
    workers.

    Exit status 0: the page was made. A claim that does not agree is a finding, not a failure; it
    is shown as such. 1: interrupted, or the rig can't be identified. 2: wrong input.

    Examples:

        seft paper

        seft paper --file kobe_jma_1995.txt --unit cm/s2 --dt 0.005 --column 0 --out kobe.html

        seft paper --json -p rig:actuator.valve_frequency:=50.0
    """
    from seft_ros.drawing.page import check_page
    from seft_ros.paper.claims import claims_table, judge_claims, summarise_paper
    from seft_ros.paper.findings import CALCULATIONS, find
    from seft_ros.paper.paper_page import write_paper
    from seft_ros.paper.paper_tests import check_rig, default_config
    from seft_ros.tournament.workers import free_cores

    path = check_page(out)
    given = {"unit": unit, "dt": dt, "column": column}
    experiment = load_experiment(config or default_config(), param, params_file)
    experiment = _with_motion(experiment, file, given)
    check_rig(experiment)
    with step_progress(CALCULATIONS, "there is no page") as tell:
        found = find(experiment, workers or free_cores(), tell)
    claims = judge_claims(found)
    name = "the paper's rig" if config is None else str(config)
    write_paper(found, claims, name, path)
    summary = summarise_paper(found, claims, path)
    agreed = f"{summary['agree']} of {len(claims)} claims agree"
    table = claims_table(claims, f"{name} under {Path(found.source).name}: {agreed}")
    show(summary, json, [table], "page")
    return 0


def _with_motion(experiment: Experiment, file: Path | None, given: dict[str, Any]) -> Experiment:
    """Put the record of the command line in the place of the experiment's own."""
    from seft_ros.ground_motion.parameters import TABLE
    from seft_ros.paper.paper_tests import changed

    words = {name: value for name, value in given.items() if value is not None}
    if file is None:
        if words and not experiment["ground_motion"]["file"]:
            raise InputError(
                f"--{next(iter(words))}: there is no record that it could be of; name one by --file"
            )
        section = words
    else:
        section = {"file": str(file), "unit": "g", "dt": 0.0, "column": 0, **words}
    return changed(experiment, {"ground_motion": TABLE.check(section, "seft paper")})
