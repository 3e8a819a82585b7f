"""``seft motion``, ``seft parameters`` and ``seft monitor``: they move nothing."""

import re
import secrets
import webbrowser
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Optional

import numpy as np
import typer
from seft_msgs_py.config.facts import EVERY_NODE, FACTS, fact_of, place_of
from seft_msgs_py.config.parameter_table import Parameter, Section, nearest
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import Timebase

from seft_ros.cli.shared import Files, Json, Params, load_experiment, option, show
from seft_ros.test_run.parameter_tables import TABLES


def monitor(
    host: str = option("127.0.0.1", "Address to serve at.", "ADDRESS"),
    port: int = option(8765, "Port; 0: any that is free.", "N", min=0, max=65535),
    token: str = option(
        "", "Token that a browser needs; default a new one.", "TEXT", envvar="SEFT_MONITOR_TOKEN"
    ),
    namespace: str = option("", "Namespace of the test's topics.", "NAME"),
    open_page: bool = option(False, "Open the page in a browser.", "--open"),
) -> int:
    """Show a running test on a page in the browser, with buttons to start and stop it.

    Shows any test on the ROS domain, of seft run or ros2 run, one after another. It shows the
    state and trips, displacement, acceleration and force with their reference, round trip and
    missed commands, margins to the limits. A reload of the page keeps the history.

    Buttons call the supervisor: Start, Stop and Reset ask for confirmation, Abort test acts at
    once. A button in a browser is no emergency stop; that must be a circuit in hardware.

    It prints its address with a token: who has it sees the test, and may press the buttons. It
    listens at 127.0.0.1; another host sees it by an SSH tunnel (docs/monitor.md), or where --host
    says. The variable SEFT_MONITOR_TOKEN sets a token that is not in the list of processes. Ctrl-C
    ends the monitor, not the test. A browser that --open starts keeps off the loop's core, too.

    Examples:

        seft monitor

        seft monitor --open

        ROS_DOMAIN_ID=7 seft monitor --port 8801

        seft monitor --host 0.0.0.0 --token "$(openssl rand -hex 16)"
    """
    from seft_ros.monitor.server import keep_off_the_loop, listen, page_address, serve_monitor

    if not re.fullmatch(r"[\w.~-]*", token, re.ASCII):
        raise InputError("--token: use letters, digits, and any of _ . ~ -")
    if not re.fullmatch(r"(/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*)?", namespace, re.ASCII):
        raise InputError(f"--namespace {namespace}: is not a valid ROS namespace, such as /lab2")
    token = token or secrets.token_urlsafe(24)
    keep_off_the_loop()
    listening = listen(host, port)
    address = page_address(host, listening.getsockname()[1], token)

    def ready() -> None:
        print(f"seft monitor: {address}", flush=True)
        if open_page:
            webbrowser.open(address)

    serve_monitor(listening, token, namespace, ready)
    return 0


_ROWS = {
    "peak_acceleration": "peak acceleration (PGA), m/s²",
    "peak_velocity": "peak velocity (PGV), m/s",
    "peak_displacement": "peak displacement (PGD), m",
    "offset": "mean acceleration (offset), m/s²",
    "residual_velocity": "velocity at the end, m/s",
    "residual_displacement": "displacement at the end, m",
    "arias_intensity": "Arias intensity, m/s",
    "significant_duration": "significant duration (5-95 %), s",
}


def motion(
    file: Optional[list[Path]] = typer.Argument(
        None, metavar="[FILE...]", help="Record, or one for each axis.", show_default=False
    ),
    config: Optional[Path] = option(None, "Show it as this experiment uses it.", "CONFIG"),
    param: Params = None,
    params_file: Files = None,
    column: Optional[list[int]] = option(None, "Column, from 0; once for each axis to show."),
    rows: Optional[bool] = option(None, "One motion in rows of several numbers.", "--rows"),
    unit: Optional[str] = option(None, "g, m/s2, cm/s2 or gal, if the file does not say."),
    dt: Optional[float] = option(None, "Sampling period in s, if the file has none."),
    response: Optional[Path] = option(None, "Station's metadata, for counts.", "FILE"),
    correct: Optional[str] = option(None, "none, offset or baseline."),
    rate: Optional[float] = option(None, "Rate of the loop in Hz; default CONFIG's, or 500."),
    figure: Optional[Path] = option(None, "Draw time history and response spectrum.", "FILE"),
    csv: Optional[Path] = option(None, "Write the response spectrum as csv.", "FILE"),
    json: Json = False,
) -> int:
    """Show a ground motion as a test uses it: source, unit, scale, peak, duration.

    Reads PEER AT2, COSMOS, SMC, CSMIP, GeoNet, ESM, K-NET, SAC, miniSEED, columns, rows and csv;
    docs/records.md says what of each. It prints which column was taken, and where unit and sampling
    period come from; where a file does not say, it asks.

    Without --config, a record is only corrected (--correct) and resampled to the rate of the loop.
    With it, the motion is also processed as in the experiment: peak_force, time_scale, influence,
    tail. The displacement at the end shows whether a record needs a correction.

    Examples:

        seft motion kobe.AT2 --figure kobe.png

        seft motion kobe.txt --unit cm/s2 --dt 0.005 --column 0 --column 1

        seft motion elcentro.acc --rows --unit g --dt 0.02

        seft motion GIL067.AT2 GIL337.AT2 --figure pair.png

        seft motion --config config/demo.yaml

        seft motion kobe.AT2 --config config/demo.yaml --csv spectrum.csv
    """
    # beyond 60 lines: its options and its help; what it shows follows in order
    from seft_ros.analysis.result_text import motion_rows
    from seft_ros.drawing import style
    from seft_ros.ground_motion import response_spectrum as spectrum
    from seft_ros.ground_motion.conditioning import baseline_numbers
    from seft_ros.ground_motion.ground_motion_block import GROUND_MOTION_TABLE, GroundMotion

    path = style.check_figure(figure) if figure is not None else None
    spectrum_file = style.check_table(csv) if csv is not None else None
    if config is not None:
        experiment = load_experiment(config, param, params_file)
        axes, timebase, section = experiment.axes, experiment.timebase, experiment["ground_motion"]
    elif not file:
        raise InputError("seft motion: name a record, or an experiment by --config")
    elif param or params_file:
        raise InputError("-p and --params-file change an experiment; name it by --config")
    else:
        axes = tuple(f"column {index}" for index in column or ()) or ("motion",)
        if len(file) > 1:
            axes = tuple(f"motion {number}" for number, _ in enumerate(file, start=1))
        timebase = Timebase.from_rate(500.0)
        section = {row.name: row.default for row in GROUND_MOTION_TABLE.rows.values()}
        section["tail"] = 0.0
    metadata = None if response is None else str(response)
    words = {"column": column or None, "rows": rows, "unit": unit, "dt": dt, "response": metadata}
    section |= _as_named(section, file or [], words, correct)
    timebase = timebase if rate is None else Timebase.from_rate(rate)
    block = GroundMotion(section, axes, timebase)
    samples, dt = block.samples, timebase.dt
    if path is not None:
        title = f"{block.facts['source']}, {timebase.rate:g} Hz"
        style.save_figure(spectrum.motion_figure(samples, dt, axes, title, block.uncorrected), path)
    moving = samples[: block.steps - round(section["tail"] * timebase.rate)]
    if spectrum_file is not None:
        names = ["period (s)", *(f"{axis} pseudo-acceleration (m/s^2)" for axis in axes)]
        periods = spectrum.SPECTRUM_PERIODS
        spectra = spectrum.response_spectrum(samples, dt, periods)
        style.write_table(spectrum_file, names, np.column_stack([periods, spectra]))
    numbers = spectrum.motion_summary(samples, dt) | baseline_numbers(moving, dt)
    lines = [["steps", *[str(numbers["steps"])] * len(axes)]]
    lines += [[label, *(f"{x:.4g}" for x in numbers[name])] for name, label in _ROWS.items()]
    summary = {**block.facts, "rate_hz": timebase.rate, **numbers}
    summary["figure"] = None if path is None else str(path)
    summary["csv"] = None if spectrum_file is None else str(spectrum_file)
    facts = style.TextTable((), motion_rows(block.facts))
    show(summary, json, [facts, style.TextTable(["", *axes], lines)], "figure", "csv")
    return 0


def _as_named(
    section: Section, file: Sequence[Path], words: Mapping[str, Any], correct: str | None
) -> Section:
    """Give the parameters of a motion that a command line names beside an experiment's own."""
    from seft_ros.ground_motion.ground_motion_block import GROUND_MOTION_TABLE, OF_RECORD

    given: Section = {name: value for name, value in words.items() if value is not None}
    if file:  # what the experiment says of its own record does not hold for another one
        files = [str(each) for each in file]
        own = {name: GROUND_MOTION_TABLE.rows[name].default for name in OF_RECORD}
        given = {"file": files if len(files) > 1 else files[0], **own, **given}
    elif given and not section["file"]:
        raise InputError(f"--{next(iter(given))}: needs a record; name its file")
    given |= {} if correct is None else {"correct": correct}
    return GROUND_MOTION_TABLE.check(given, "seft motion")


def parameters(
    node: Optional[str] = typer.Argument(None, metavar="[NODE]", help="A node; default all."),
    word: Optional[str] = typer.Argument(
        None, metavar="[WORD]", help="Only what has this in its name or meaning."
    ),
) -> int:
    """Print parameters with type, default, unit, bounds and meaning, as Markdown.

    What is known of rig and specimen stands once in a file, under /**: the facts. Of a node they
    are those that it uses.

    Examples:

        seft parameters rig

        seft parameters noise

        seft parameters rig simulated.sensors
    """
    names = [table.node for table in TABLES]
    if node is not None and node not in names:
        if word is not None:
            raise InputError(f"there is no node {node}{nearest(node, names)}")
        node, word = None, node
    if not (found := parameters_text(node or "", word or "")):
        where = "no parameter" if node is None else f"no parameter of {node}"
        raise InputError(f"{where} has {word} in its name or meaning; seft parameters lists all")
    print(found)
    return 0


def parameters_text(node: str = "", word: str = "") -> str:
    """Tabulate parameters in Markdown, by their place in a file.

    Of one node, and of these what has a word in its name or meaning; default all. Empty if nothing
    has.
    """
    rows = {place: dict[str, Parameter]() for place in (EVERY_NODE, *(t.node for t in TABLES))}
    for table in TABLES:
        for name, row in table.rows.items():
            text = f"{name} {row.description}".lower()
            if node in ("", table.node) and word.lower() in text:
                rows[place_of(name, table.node)].setdefault(name, row)
    order = list(FACTS)
    rows[EVERY_NODE] = dict(sorted(rows[EVERY_NODE].items(), key=lambda one: order.index(one[0])))
    parts = [f"## `{place}`\n\n{_table(own.values())}" for place, own in rows.items() if own]
    return "\n\n".join(parts)


def _table(rows: Iterable[Parameter]) -> str:
    lines = ["| parameter | type | default | unit | meaning |", "|---|---|---|---|---|"]
    for row in rows:
        meaning = row.description.replace("|", "\\|") + (" (*live*)" if row.live else "")
        lines.append(f"| `{row.name}` | {_type(row)} | {_default(row)} | {row.unit} | {meaning} |")
    return "\n".join(lines)


def _type(row: Parameter) -> str:
    if row.choices:
        texts = [f"`{choice}`" if choice else '`""`' for choice in row.choices]
        texts += ["a name that a package registers"] if row.registered is not None else []
        return " \\| ".join(texts)
    if row.file_name:
        return "name of a file"
    limits = ((">", 0 if row.positive else None), (">=", row.minimum), ("<=", row.maximum))
    bounds = [f"{sign} {value:g}" for sign, value in limits if value is not None]
    return f"{row.kind} {', '.join(bounds)}".strip()


def _default(row: Parameter) -> str:
    if row.default is not None:
        return f"`{row.default!r}`".replace("'", '"')
    return f"`/**: {fact}`" if (fact := fact_of(row.name)) else "**required**"
