"""``seft design``: shape the force loop."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from seft_msgs_py.config.parameter_table import nearest
from seft_msgs_py.errors import InputError

from seft_ros.commands.options import (
    ConfigArgument,
    JsonOption,
    OverrideOption,
    ParamsFileOption,
    PlantOption,
    complain,
    load_experiment,
    print_json,
)
from seft_ros.loop_shaping.source import Source

if TYPE_CHECKING:  # scipy and all: other commands start without
    from seft_ros.loop_shaping.design import LoopDesign


def design(
    config: ConfigArgument,
    param: OverrideOption = None,
    params_file: ParamsFileOption = None,
    plant: PlantOption = Source.AUTO,
    axis: Annotated[
        Optional[str],
        typer.Option("--axis", metavar="NAME", help="Axis to be shown; default the first."),
    ] = None,
    crossover: Annotated[
        Optional[float],
        typer.Option("--crossover", metavar="HZ", help="Propose a controller for this crossover."),
    ] = None,
    gain_margin: Annotated[
        float,
        typer.Option("--gain-margin", metavar="DB", help="Least gain margin of a proposal in dB."),
    ] = 6.0,
    gain: Annotated[
        Optional[float],
        typer.Option("--gain", help="Try gain * product(s - zeros) / product(s - poles)."),
    ] = None,
    zero: Annotated[
        Optional[list[str]],
        typer.Option(
            "--zero",
            metavar="HZ[,DAMPING]",
            help="Its zeros, one option each: real, or with a damping ratio a conjugate pair; "
            "0 is a differentiator.",
        ),
    ] = None,
    pole: Annotated[
        Optional[list[str]],
        typer.Option("--pole", metavar="HZ[,DAMPING]", help="Its poles; 0 is an integrator."),
    ] = None,
    numerator: Annotated[
        Optional[str],
        typer.Option("--numerator", help='Or its coefficients in s, highest power first: "37".'),
    ] = None,
    denominator: Annotated[
        Optional[str], typer.Option("--denominator", help='Likewise: "1 17.14 4002".')
    ] = None,
    out: Annotated[
        Optional[Path],
        typer.Option("--out", metavar="FILE", help="Write the controller to a new parameter file."),
    ] = None,
    figure: Annotated[Path, typer.Option("--figure", metavar="PNG", help="Where to draw.")] = Path(
        "design.png"
    ),
    json: JsonOption = False,
) -> int:
    """Shape the force loop: plant, controller, loop and closed loop, with margins and delay.

    The plant leads from valve to actuator force. Its zeros are the specimen's poles
    (control-structure interaction): the controller's poles go there, and its gain sets the
    crossover, well below the oil-column resonance. Margins are those of the loop as it runs,
    sampled, held and a step late; beside them stands what continuous time would give.

    Without further options the experiment's own controller is judged. Exit status 1: with
    this controller the loop is unstable; it is not written then.

    Examples:

        seft design config/jhu.yaml

        seft design config/jhu.yaml --crossover 12 --out controller.yaml

        seft simulate config/jhu.yaml --params-file controller.yaml

        seft design config/jhu.yaml --gain 37 --pole 10.07,0.1355

        seft design config/jhu.yaml --numerator 37 --denominator "1 17.14 4002" --json
    """
    from seft_ros.drawing.style import save_figure
    from seft_ros.loop_shaping.controller import Controller
    from seft_ros.loop_shaping.design import shape_loop
    from seft_ros.loop_shaping.design_table import summarise, summarise_axes
    from seft_ros.loop_shaping.figure import design_figure
    from seft_ros.loop_shaping.given_controller import given_controller
    from seft_ros.loop_shaping.parameter_file import check_new, write_controller
    from seft_ros.loop_shaping.plant import choose_plant
    from seft_ros.loop_shaping.proposal import propose_controller
    from seft_ros.loop_shaping.sampling import dominant_pole

    if out is not None:
        check_new(out)
    experiment = load_experiment(config, param, params_file)
    dt, axes = experiment.timebase.dt, experiment.axes
    shown = _index(axes, axis)
    whole = choose_plant(experiment, plant)
    controller = given_controller(gain, zero or (), pole or (), numerator, denominator)
    if crossover is not None:
        if controller is not None:
            raise InputError("--crossover proposes a controller: leave out what gives one")
        controller = propose_controller(whole.axis(shown), crossover, dt, gain_margin)
    elif controller is None:
        controller = Controller.from_parameters(experiment["force_controller"])
    loops = [shape_loop(whole.axis(index), controller, dt) for index in range(len(axes))]
    slowest = dominant_pole(whole, controller, dt)

    loop = loops[shown]
    title = f"{config}, axis {axes[shown]}: force loop at {1 / dt:g} Hz, plant: {whole.source}"
    path = figure if figure.suffix else figure.with_suffix(".png")
    save_figure(design_figure(loop, title), path)
    summary = summarise(loop)
    summary["axes"] = summarise_axes(axes, loops)
    summary |= {"stable": abs(slowest) < 1, "proposed": crossover is not None, "figure": str(path)}
    if out is not None and summary["stable"]:
        write_controller(controller, out)
        summary["out"] = str(out)
    if json:
        print_json(summary)
    else:
        _show(loop, title, summary)
    if summary["stable"]:
        return 0
    complain(_unstable(slowest, dt))
    return 1


def _index(axes: tuple[str, ...], name: str | None) -> int:
    if name is None:
        return 0
    if name not in axes:
        raise InputError(f"--axis {name}: there is no such axis{nearest(name, axes)}")
    return axes.index(name)


def _unstable(pole: complex, dt: float) -> str:
    import cmath

    return (
        f"unstable: with this controller the force loop oscillates at "
        f"{abs(cmath.phase(pole)) / (2 * cmath.pi * dt):.3g} Hz, times {abs(pole):.4g} each step"
    )


def _show(loop: "LoopDesign", title: str, summary: dict[str, Any]) -> None:
    from rich.console import Console

    from seft_ros.loop_shaping.design_table import axes_table, design_table

    console = Console()
    console.print(design_table(loop, title))
    if len(summary["axes"]) > 1:
        console.print(axes_table(summary["axes"]))
    for name in ("figure", "out"):
        if name in summary:
            console.print(f"{name + ':':8}{summary[name]}", soft_wrap=True, highlight=False)
