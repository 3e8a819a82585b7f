"""``seft conform``: whether a rig's driver keeps the contract of a test."""

import sys
from typing import TYPE_CHECKING, Annotated, Optional

import typer
from seft_msgs_py.errors import InputError

from seft_ros.commands.options import Config, Files, Json, Params, load_experiment, option
from seft_ros.commands.output import show, stderr_console

if TYPE_CHECKING:
    from seft_ros.conformance.finding import Finding


def conform(
    config: Config,
    param: Params = None,
    params_file: Files = None,
    start_rig: Annotated[
        bool, option("Start the simulated rig of CONFIG; else a rig runs already.", "--start-rig")
    ] = False,
    amplitude: Annotated[
        Optional[float],
        option("Largest valve command; default 0.2 V (50 N for an idealised actuator).", "V"),
    ] = None,
    travel: Annotated[
        float, option("Displacement from rest at which it is stopped, m.", "M")
    ] = 0.005,
    force: Annotated[float, option("Change of force at which it is stopped, N.", "N")] = 2000.0,
    yes: Annotated[
        bool, option("Move the rig without asking: nobody is within its reach.", "--yes")
    ] = False,
    json: Json = False,
) -> int:
    """See whether a rig's driver keeps its contract (docs/hardware.md) before a test relies on it.

    Plays supervisor and force controller for a node rig that runs already, such as a lab's own
    driver: looks at what it says and sends; moves it by a few tenths of a millimetre to see that
    units, signs and stamps fit one another; then sends what must be refused, and falls silent, to
    see that it trips, rests and stays at rest. Each check has one line: passed or failed, the
    measured number, how to mend it. What fails early ends the test before the rig moves further.

    CONFIG has rate, axes, limits, and the specimen's mass, damping and stiffness
    (reference_force: model.*); the rig's own parameters are taken from its description.

    Exit status 0: it conforms; 1: it does not.

    Examples:

        seft conform config/jhu.yaml --start-rig

        seft conform config/laboratory.yaml --amplitude 0.1

        seft conform config/laboratory.yaml --yes --json
    """
    from seft_ros.conformance.finding import finding_line, verdict
    from seft_ros.conformance.suite import conform as look_at

    experiment = load_experiment(config, param, params_file, None if start_rig else ["rig"])
    if len(experiment.rigs) > 1:
        raise InputError(
            f"{config}: the axes are of several rigs, but conform looks at one: give its axes "
            'alone, without its name, as -p "/**:axes:=[x]", and parameters for these'
        )
    for name, value in (("--amplitude", amplitude), ("--travel", travel), ("--force", force)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"{name} is {value:g}, but must be positive")
    if start_rig:
        experiment["rig"]["pace"] = "realtime"
    elif not yes:
        _ask(amplitude, travel)
    console = stderr_console()

    def tell(finding: "Finding") -> None:
        if not json:
            console.print(finding_line(finding), soft_wrap=True, highlight=False)

    findings = look_at(
        experiment, tell, start_rig=start_rig, amplitude=amplitude, travel=travel, force=force
    )
    result = verdict(findings)
    words = "conforms" if result["conforms"] else "does not conform"
    counts = "{passed} passed, {failed} failed, {not_run} not run".format_map(result)
    show({"config": str(config), **result}, json, [f"the rig {words}: {counts}"])
    return 0 if result["conforms"] else 1


def _ask(amplitude: float | None, travel: float) -> None:
    """Have a person say that the rig may move.

    Raises
    ------
    InputError
        If nobody can be asked, or the answer is no.
    """
    told = f"{amplitude or 0.2:g} V, stopped at {1e3 * travel:g} mm"
    if not sys.stdin.isatty():
        raise InputError(f"the rig will be moved ({told}): say --yes when nobody is in its reach")
    if not typer.confirm(f"The rig will be moved ({told}). Is nobody within its reach?", err=True):
        raise InputError("nothing was moved")
