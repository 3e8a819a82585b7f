"""``seft link``, ``seft check`` and ``seft new``: a link, hardware, a package to begin with."""

import keyword
import sys
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any, Optional

import typer
from rich.console import Console
from seft_msgs_py.config.experiment import Experiment, write_parameter_file
from seft_msgs_py.config.facts import EVERY_NODE, command_unit
from seft_msgs_py.errors import InputError
from seft_msgs_py.printing import escaped
from seft_msgs_py.wire.topics import RigAxes

from seft_ros.cli import shared
from seft_ros.cli.shared import option

RATE, SIZE = 500.0, 1000  # Hz and bytes, without an experiment


def link(
    config: Optional[Path] = typer.Argument(
        None, metavar="[CONFIG]", help="Experiment, for its rate, message size and margin."
    ),
    param: shared.Params = None,
    params_file: shared.Files = None,
    echo: bool = option(False, "Be the other side: send messages back until Ctrl-C.", "--echo"),
    rig: str = option("", "Rig at the other side, if the test has several.", "NAME"),
    duration: float = option(10.0, "Duration of the measurement in s.", "S"),
    out: Optional[Path] = option(None, "Write the delay, for --params-file.", "FILE"),
    json: shared.Json = False,
) -> int:
    """Measure the link to another host, and say which tests it is good for.

    Sends messages of the size of a reference force at the rate of the test. The other side sends
    them back: seft link --echo, or a force_controller with a loop_delay. Reports round trips,
    loss, reordering, the delay of the loop (loop_delay) that the link needs, the highest rate that
    needs none, and with CONFIG the mass ratio up to which the test is stable.

    Exit status 1: the link is unusable, or the test unstable over it.

    Examples:

        seft link --echo

        seft link config/demo.yaml

        seft link config/demo.yaml --out link.yaml

        seft link config/two_pier_bridge.yaml --rig east

    The test over the link then takes link.yaml as --params-file, and the nodes of the other side
    as --external (docs/hosts.md).
    """
    # beyond 60 lines: its options and its help
    from seft_ros.test_run.link import allowed, assess_link, link_texts, measure_link, message_size

    if echo:
        return _echo()
    if out is not None and config is None:
        raise InputError("--out needs CONFIG: the delay is counted in steps at its rate")
    if duration <= 0:
        raise InputError(f"--duration is {duration:g} s, but must be positive")
    experiment = None if config is None else shared.load_experiment(config, param, params_file)
    rate, size = RATE, SIZE
    if experiment is not None:
        rate, size = experiment.timebase.rate, message_size(experiment)
    other_side = _rig(rig, experiment)
    with shared.step_progress(max(2, round(duration * rate))) as progress:
        trips = measure_link(rate, duration, size, progress, other_side)
    test = None if experiment is None else allowed(experiment, trips.loop_delay)
    verdict, reasons = assess_link(trips, test)
    summary: dict[str, Any] = {**trips.numbers_by_name(), "size_bytes": size}
    summary |= {"test": test and asdict(test), "verdict": verdict, "reasons": reasons}
    if out is not None:
        steps = {EVERY_NODE: {"loop_delay": trips.loop_delay}}
        comment = "by seft link: steps at the rate of the experiment"
        write_parameter_file(out, steps, [comment], replace=True)
        summary["file"] = str(out)
    shared.show(summary, json, link_texts(summary))
    for reason in reasons:
        shared.complain(f"{verdict}: {reason}")
    return 1 if verdict == "unusable" else 0


def _rig(name: str, experiment: Experiment | None) -> RigAxes | None:
    """Find the rig whose link is measured; None where there is but one."""
    if experiment is None or len(experiment.rigs) < 2:
        if name:
            raise InputError(f"--rig {name}: needs CONFIG of a test with several rigs")
        return None
    rigs = {rig.name: rig for rig in experiment.rigs}
    if name not in rigs:
        raise InputError(f"--rig {name}: must be {' or '.join(rigs)}")
    return rigs[name]


def _echo() -> int:
    from seft_ros.test_run.link import echo

    with suppress(KeyboardInterrupt), Console(stderr=True).status("echoing") as status:
        echo(lambda count: status.update(f"echoing: {count} messages so far"))
    return 0


def check(
    config: shared.Config,
    param: shared.Params = None,
    params_file: shared.Files = None,
    rig: str = option("", "Rig to check, if the test has several.", "NAME"),
    amplitude: Optional[float] = option(None, "Largest command; default 0.2 V, 0.5 mm, or 50 N."),
    travel: float = option(0.005, "Displacement from rest at which the rig is stopped, m.", "M"),
    force: float = option(2000.0, "Change of force at which the rig is stopped, N.", "N"),
    yes: bool = option(False, "Move the rig without asking: nobody is within its reach.", "--yes"),
    json: shared.Json = False,
) -> int:
    """Check by a small motion that the hardware of a rig fits CONFIG, before a test relies on it.

    Hosts what rig: hardware names as the rig node does, without ROS. Moves each axis by a few
    tenths of a millimetre, first by an eighth of that, and finds what only motion can show: signs,
    units and lags of the channels, dead time, whether safe() stops the piston, time of the calls.
    Each check has one line: good, or wrong and the parameter to change. At the end, after Ctrl-C
    and after every error it brings the rig to rest, and says that it is at rest, or that it is not.

    Exit status 0: all is good; 1: something is wrong.

    Examples:

        seft check config/jhu.yaml

        seft check laboratory.yaml -p hardware:=board.py:Board --amplitude 0.05
    """
    from seft_msgs_py.node.transport import MACHINE

    from seft_ros.check.motion_checks import RigCheck
    from seft_ros.check.rig_mover import RigMover

    experiment = shared.load_experiment(config, param, params_file)
    of = _rig(rig, experiment) or experiment.rigs[0]
    for name, value in (("--amplitude", amplitude), ("--travel", travel), ("--force", force)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"{name} is {value:g}, but must be positive")
    if not (experiment["rig"]["hardware"] == "simulated" or yes):
        unit = command_unit(experiment["rig"]["actuator.kind"])
        _ask(f"{amplitude or (0.2 if unit == 'V' else 5e-4):g} {unit}", travel)
    mover = RigMover(experiment, of, MACHINE, travel, force)
    found = []
    try:
        for each in RigCheck(mover, experiment, of, amplitude).findings():
            found.append(each)
            if not json:
                line = f"{'good ' if each.ok else 'WRONG'}  {each.name}: {each.text}"
                print(escaped(line), file=sys.stderr, flush=True)  # a laboratory's text
    finally:
        rests = mover.close()
        shared.stands(rests)
        shared.complain(rests)
    wrong, checks = sum(not each.ok for each in found), [each._asdict() for each in found]
    summary = {"config": str(config), "good": not wrong, "rest": rests, "checks": checks}
    shared.show(summary, json, [f"{len(found) - wrong} good, {wrong} wrong"])
    return min(wrong, 1)


def _ask(amplitude: str, travel: float) -> None:
    """Ask a person whether the rig may move; raise `InputError` without a yes."""
    motion = f"{amplitude}, stopped at {1e3 * travel:g} mm"
    if not sys.stdin.isatty():
        raise InputError(f"the rig will be moved ({motion}): say --yes when nobody is in its reach")
    question = f"The rig will be moved ({motion}). Is nobody within its reach?"
    if not typer.confirm(question, err=True):
        raise InputError("nothing was moved")


TEMPLATES = Path(__file__).parent / "templates"
TEMPLATE_PACKAGE = "rig_driver"  # of the template's package


def new(
    what: str = typer.Argument(..., help="The hardware of your rig.", metavar="driver"),
    name: str = typer.Argument(..., help="Name of the package, and of the folder.", metavar="NAME"),
) -> int:
    """Make a package for your own rig, in a new folder here.

    It has one class on a simulated converter board, which the node rig hosts, a parameter file, and
    a test. It works as it is, so that you change one thing at a time. docs/hardware.md shows the
    way from here to the first test.

    Example:

        seft new driver my_rig
    """
    if what != "driver":
        raise InputError(f"can't make a new {what}; seft new driver NAME makes a driver")
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise InputError(f"{name}: not a package name; use lower-case letters, digits and _")
    if name in sys.stdlib_module_names or name.startswith("seft_"):
        raise InputError(f"{name}: another package has this name; choose another")
    folder = Path(name)
    try:
        folder.mkdir()
        _copy_template(name, folder)
    except FileExistsError:
        raise InputError(f"{folder}: exists already; choose another name") from None
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}") from None
    print(f"made {folder}/; next, in that folder:")
    print("  by simulation:  seft simulate laboratory.yaml")
    print("  check it:       seft check laboratory.yaml")
    print("  its test:       python -m pytest")
    print(f"  your board:     {name}.py")
    return 0


def _copy_template(name: str, folder: Path) -> None:
    """Copy the template's files under a package's name."""
    template = TEMPLATES / TEMPLATE_PACKAGE
    for file in sorted(template.rglob("*")):
        parts = file.relative_to(template).parts
        if file.is_dir() or any(part.startswith((".", "__pycache__")) for part in parts):
            continue
        place = folder.joinpath(*(part.replace(TEMPLATE_PACKAGE, name) for part in parts))
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(file.read_text().replace(TEMPLATE_PACKAGE, name))
