"""``seft run`` (DDS), ``simulate`` (one process); ``start``, ``stop``, ``reset`` and ``status``."""

import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Optional

import typer
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError
from seft_msgs_py.printing import escaped
from seft_plant_sim.rig_parameters import as_simulated

from seft_ros.bags.recording import Recording
from seft_ros.cli import shared
from seft_ros.cli.shared import option
from seft_ros.test_run.parameter_tables import TABLES

if TYPE_CHECKING:
    from seft_ros.ground_motion.ground_motion_block import GroundMotion
    from seft_ros.test_run.observer import Observer

_SUPERVISOR_TIMEOUT_S = 5.0  # s, in which a supervisor that runs is heard
_POLL_PERIOD = 0.05  # s


def start() -> int:
    """Start the test whose nodes run and are ready.

    For nodes that were started one by one. The supervisor's log, and seft status, say which node
    it waits for.

    Exit status 1: there is no supervisor, or it refuses.

    Examples:

        seft status

        seft start
    """
    return _request("start")


def stop(
    at_once: bool = option(False, "Trip instead: the rig goes to its safe command.", "--at-once"),
) -> int:
    """Ramp the reference force of the running test down, and end the test.

    This is software. People and hydraulics are protected by the emergency stop in hardware.

    Exit status 1: there is no supervisor, or no test runs.

    Examples:

        seft stop

        seft stop --at-once
    """
    return _request("estop" if at_once else "stop")


def reset() -> int:
    """Allow a new test to start after one that is done or has tripped.

    Exit status 1: there is no supervisor, or it refuses.

    Examples:

        seft reset
    """
    return _request("reset")


def status(json: shared.Json = False) -> int:
    """Print the state of the test, why it is in it, and the time of the test.

    Exit status 1: there is no supervisor, or the test has tripped.

    Examples:

        seft status

        seft status --json
    """
    from seft_msgs_py.wire.outcome import MOVING, State

    with _supervised() as observer:
        state, detail = observer.state, observer.reported.detail
        if state in MOVING:
            observer.spin(2 * _POLL_PERIOD)
        found = {"state": state, "detail": detail, "time_s": observer.time_ns / 1e9}
        if (steps := observer.reported.steps) is not None:
            found["steps"] = steps
    name = state.replace("_", " ")
    text = name if detail == name else f"{name}: {detail}"
    shared.show(found, json, [f"{text} ({found['time_s']:.1f} s)" if state in MOVING else text])
    return 1 if state == State.TRIPPED else 0


def _request(service: str) -> int:
    with _supervised() as observer:
        accepted, answer = observer.call(service)
    if not accepted:
        raise ExperimentError(answer)
    print(escaped(answer))
    return 0


@contextmanager
def _supervised() -> Iterator["Observer"]:
    """Observe the test whose supervisor is heard."""
    from seft_msgs_py.node.process import prepare_on_this_host

    from seft_ros.test_run.observer import Observer

    prepare_on_this_host()
    with closing(Observer()) as observer:
        deadline = time.monotonic() + _SUPERVISOR_TIMEOUT_S
        while not observer.state:
            if time.monotonic() > deadline:
                raise ExperimentError(
                    f"no supervisor is in ROS domain {observer.domain}: start the nodes; if they "
                    "run, set ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE as they have them"
                )
            observer.spin(_POLL_PERIOD)
        yield observer


LINK_TIME = 5.0  # s for which a link is measured before a test
_DRAW = "Draw a figure into the bag's folder."
Figure = Annotated[bool, typer.Option("--figure/--no-figure", help=_DRAW)]


def run(
    config: shared.Config,
    param: shared.Params = None,
    params_file: shared.Files = None,
    external: shared.External = None,
    out: Optional[Path] = option(None, "New folder of the bag; default by the time.", "DIR"),
    pin: bool = option(True, "Give the loop's nodes cores of their own; keep cores awake."),
    composed: bool = option(False, "Run the loop's nodes in one process.", "--composed"),
    priority: int = option(0, "Real-time priority of the loop; 0: none.", "N", min=0, max=98),
    accept_unstable: bool = option(
        False, "Run also an unstable or unfit test.", "--accept-unstable"
    ),
    figure: Figure = True,
    json: shared.Json = False,
) -> int:
    """Run an experiment as separate nodes over DDS, record it, and show how it went.

    The test must be stable by the closed loop's eigenvalues, which seft preflight shows in detail;
    an unstable test is refused. So is one that uses less than 2 % or more than 90 % of a sensor's
    range, or whose expected peaks are beyond a limit, the stroke, the force capacity or the flow of
    the valve, and, always, one whose stiffness or mass seems to be in another unit, or whose mass
    is not the identified one.

    Starts ground_motion, reference_force, force_controller, rig, recorder and supervisor,
    waits until all have found each other, runs the test, and ends them. The bag is in the
    recorder's directory, unless --out names another folder.

    --composed puts rig, reference_force and force_controller into one process, for rates that
    separate processes can't hold; topics and samples stay the same. --priority also locks the
    memory of the loop's nodes, and keeps cores awake.

    Examples:

        seft run config/demo.yaml

        seft run config/jhu.yaml -p rig:pace:=lockstep --out bags/lockstep

        ROS_DOMAIN_ID=7 seft run config/jhu.yaml --json

        seft run config/jhu.yaml --composed --priority 50 -p rate:=2000.0

        seft run config/jhu.yaml --external rig

        seft run config/jhu.yaml --params-file plan.yaml --accept-unstable
    """
    # beyond 60 lines: its options and its help
    from seft_ros.design import preflight_tables
    from seft_ros.test_run.blocks import build_blocks
    from seft_ros.test_run.processes import ProcessLayout
    from seft_ros.test_run.run import bag_path

    shared.announce_compilation()
    experiment = shared.load_experiment(config, param, params_file, external)
    bag = bag_path(experiment, out)
    experiment = _with_measured_delay(experiment)
    # making the blocks checks them; an external node has checked its own parameters
    is_whole = all(table.node in experiment.sections for table in TABLES)
    blocks = build_blocks(experiment) if is_whole else None
    motion = blocks.ground_motion if blocks else preflight_tables.planned_motion(experiment)
    in_lockstep = experiment.sections.get("rig", {}).get("pace") == "lockstep"
    model = None if in_lockstep else preflight_tables.model_time(experiment, motion)
    if model is not None and (too_slow := model.refusal()):
        raise InputError(too_slow)
    _check_plan(experiment, motion, accept_unstable)
    layout = ProcessLayout(pin=pin, composed=composed, priority=priority)
    steps = motion.steps if motion else 0
    recording, bag = shared.dds_test(experiment, bag, steps, external or (), layout=layout)
    if shared.show_test(recording, bag, as_json=json, figure=figure):
        return 0
    shared.complain(_fault(recording))
    return 1


def simulate(
    config: shared.Config,
    param: shared.Params = None,
    params_file: shared.Files = None,
    out: Optional[Path] = option(None, "Write a bag and a figure to a new folder.", "DIR"),
    figure: Figure = True,
    json: shared.Json = False,
) -> int:
    """Run an experiment in one process, without ROS, and compare it with the exact response.

    The samples are, bit for bit, those of seft run where no command was missed.

    Examples:

        seft simulate config/jhu.yaml

        seft simulate config/jhu.yaml -p reference_force:mass_ratio:=0.5

        seft simulate config/demo.yaml --out bags/demo

        seft simulate config/demo.yaml -p ground_motion:file:=kobe.AT2
    """
    shared.announce_compilation()
    experiment = as_simulated(shared.load_experiment(config, param, params_file))
    if out is not None:
        shared.check_out(out)
    recording = shared.offline_test(experiment, out)
    if shared.show_test(recording, out, as_json=json, figure=figure):
        return 0
    shared.complain(f"{_fault(recording)}; see seft preflight")
    return 1


def _fault(recording: Recording) -> str:
    """Say in a few words why a test is not stable: a limit that trips it is no instability."""
    if recording.trip is not None:
        return f"the test tripped: {recording.trip.reason}"
    return "unstable: values are not finite"


def _with_measured_delay(experiment: Experiment) -> Experiment:
    """Measure the delay of the loop over its link, where the experiment asks for that.

    Raises `InputError` if the other side does not answer.
    """
    section = experiment.sections.get("reference_force")
    if section is None or section["loop_delay"] >= 0:
        return experiment
    if "force_controller" in experiment.sections:
        raise InputError(
            "/**: loop_delay is to be measured, but there is no link: force_controller is to run "
            "here; give a number of steps, or --external force_controller"
        )
    from seft_ros.test_run.link import measure_link, message_size, with_loop_delay

    rate = experiment.timebase.rate
    size, delays = message_size(experiment), []
    for rig in experiment.rigs:
        with shared.step_progress(round(LINK_TIME * rate)) as progress:
            delays.append(measure_link(rate, LINK_TIME, size, progress, rig).loop_delay)
        whose = f" to {rig.name}" if rig.name else ""
        shared.complain(f"the link{whose} needs a delay of the loop of {delays[-1]} steps")
    return with_loop_delay(experiment, max(delays))


def _check_plan(experiment: Experiment, motion: "GroundMotion | None", accept: bool) -> None:
    """Raise `InputError` for a test that is refused and not accepted; warn of limits far away."""
    from seft_ros.design import plausibility, preflight_tables

    response = plausibility.expected_response(experiment, motion)
    by_axis = plausibility.peaks_of(response)
    if wrong := plausibility.unit_refusal(experiment, motion, by_axis):
        raise InputError(wrong)
    _check_stable(experiment, accept)
    beyond = plausibility.excess_text(plausibility.excesses(experiment, response))
    reasons = plausibility.range_refusal(experiment, by_axis), beyond
    if unfit := "; ".join(filter(None, reasons)):
        if not accept:
            raise InputError(f"{unfit}, or run it all the same with --accept-unstable")
        shared.complain(f"{unfit}; accepted")
    peaks = preflight_tables.expected_peaks(by_axis)
    if warning := preflight_tables.far_limits(experiment, peaks):
        shared.warn(warning)


def _check_stable(experiment: Experiment, accept_unstable: bool) -> None:
    """Raise `InputError` for an unstable test that is not accepted; warn if it is not known."""
    from seft_ros.design.planned_tests import PlannedTest
    from seft_ros.design.stability_margins import critical_mass_ratio
    from seft_ros.design.stability_verdict import instability
    from seft_ros.reference_force.compensator import NotLinearError

    try:
        test = PlannedTest(experiment)
        if test.is_stable():
            return
    except NotLinearError as error:
        recording = shared.simulated_instead(experiment, error)
        if not (recording is None or recording.trip is None or accept_unstable):
            raise InputError(
                "the test is unstable in simulation; see seft simulate, lower reference_force: "
                "mass_ratio, or run it all the same with --accept-unstable"
            ) from None
        return
    except InputError as error:  # what the nodes themselves can't use has been refused before
        shared.complain(f"preflight could not be done: {error}")
        return
    reason = f"unstable test: {instability(test)}"
    if accept_unstable:
        shared.complain(f"{reason}; accepted")
        return
    critical = critical_mass_ratio(test)
    where = f"; the critical mass ratio is {critical.value:.3g}" if critical else ""
    raise InputError(
        f"{reason}{where}; see seft preflight, lower reference_force: mass_ratio, choose another "
        "compensation.method, or run it all the same with --accept-unstable"
    )
