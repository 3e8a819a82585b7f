"""``seft link``: self-test of the link between two hosts."""

from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes

from seft_ros.commands.options import Files, Json, Params, load_experiment, option
from seft_ros.commands.output import complain, show, stderr_console, step_progress

RATE, SIZE = 500.0, 1000  # Hz and bytes, where no experiment tells them


def link(
    config: Annotated[
        Optional[Path],
        typer.Argument(
            metavar="[CONFIG]",
            help="Experiment whose rate and message size are used, and which preflight looks at.",
        ),
    ] = None,
    param: Params = None,
    params_file: Files = None,
    echo: Annotated[
        bool, option("Be the other side: send back what comes, until Ctrl-C.", "--echo")
    ] = False,
    rig: Annotated[str, option("Of several rigs, whose link it is.", "NAME")] = "",
    duration: Annotated[float, option("Time for which the link is measured.", "S")] = 10.0,
    out: Annotated[
        Optional[Path],
        option(
            "Write the delay of the loop as a parameter file, to be read by --params-file.", "FILE"
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Measure the link to another host, and tell what test it is good for.

    Sends messages of the size of a reference force at the rate of the test, which the other side
    sends back: seft link --echo there, or its force_controller with a loop_delay. Tells round
    trips, loss, reordering, the delay of the loop (loop_delay) that the link needs, the rate up to
    which none would be needed, and with CONFIG the mass ratio up to which the test is stable.

    Exit status 1: the link is unusable, or the test unstable over it.

    Examples:

        seft link --echo

        seft link config/demo.yaml

        seft link config/demo.yaml --out link.yaml

        seft link config/two_pier_bridge.yaml --rig east

        seft run config/demo.yaml --params-file link.yaml --external rig
        --external force_controller
    """
    from seft_ros.test_run.link_judgement import allowed, judge, link_table, message_size
    from seft_ros.test_run.link_measurement import measure

    if echo:
        return _echo()
    if out is not None and config is None:
        raise InputError("--out needs CONFIG: a delay in steps is one at the rate of a test")
    if duration <= 0:
        raise InputError(f"--duration is {duration:g} s, but must be positive")
    experiment = None if config is None else load_experiment(config, param, params_file)
    rate, size = RATE, SIZE
    if experiment is not None:
        rate, size = experiment.timebase.rate, message_size(experiment)
    other_side = _rig(rig, experiment)
    with step_progress(max(2, round(duration * rate))) as tell:
        trips = measure(rate, duration, size, tell, other_side)
    test = None if experiment is None else allowed(experiment, trips.loop_delay)
    verdict, reasons = judge(trips, test)
    summary: dict[str, Any] = {
        **trips.numbers_by_name(),
        "size_bytes": size,
        "test": None if test is None else test.numbers(),
        "verdict": verdict,
        "reasons": reasons,
    }
    if out is not None:
        _write(out, trips.loop_delay)
        summary["file"] = str(out)
    show(summary, json, [link_table(summary)])
    for reason in reasons:
        complain(f"{verdict}: {reason}")
    return 1 if verdict == "unusable" else 0


def _rig(name: str, experiment: Experiment | None) -> RigAxes | None:
    """Find the rig whose link is measured; None where there is but one."""
    rigs: dict[str, RigAxes | None] = {"": None}
    if experiment is not None and len(experiment.rigs) > 1:
        rigs = {one.name: one for one in experiment.rigs}
    if name not in rigs:
        raise InputError(
            f"--rig {name}: must be {' or '.join(rigs)}, whose link it is"
            if rigs.keys() != {""}
            else f"--rig {name}: give CONFIG of a test that has several rigs"
        )
    return rigs[name]


def _echo() -> int:
    from seft_ros.test_run.link_measurement import echo

    console = stderr_console()
    with console.status("echoing") as status:
        try:
            echo(lambda count: status.update(f"echoing: {count} messages so far"))
        except KeyboardInterrupt:
            return 0
    return 0


def _write(file: Path, loop_delay: int) -> None:
    text = (
        "# by seft link: steps at the rate of the experiment\n"
        f"reference_force:\n  ros__parameters:\n    loop_delay: {loop_delay}\n"
    )
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{file}: can't be written: {error.strerror}") from None
