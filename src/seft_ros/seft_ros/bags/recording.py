"""The recording of a test: its samples by step, how it ended, and its description in a bag."""

import json
import os
import platform
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cache, cached_property, reduce
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Self

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.config.facts import CHANNELS
from seft_msgs_py.config.parameter_table import Section
from seft_msgs_py.errors import InputError, WireError
from seft_msgs_py.wire.outcome import LinkReport, Saturation, Simulated, Trip
from seft_msgs_py.wire.topics import MEASURED, RIG_STATE, RigAxes, bare

PACKAGES = ("numpy", "scipy", "rosbags", "rclpy", "seft_msgs_py", "seft_plant_sim", "seft_ros")
GIT_TIMEOUT = 5.0  # s


@dataclass
class Description:
    """What a test was, as far as it was recorded.

    Attributes
    ----------
    sections : dict
        Node -> its resolved parameters.
    environment : dict
        See `describe_environment`.
    facts : dict
        Node -> what else it says of itself.
    """

    sections: dict[str, Section] = field(default_factory=dict)
    environment: dict[str, Any] = field(default_factory=dict)
    facts: dict[str, dict[str, Any]] = field(default_factory=dict)

    def experiment(self) -> Experiment:
        """Make the experiment of the nodes' parameters; of several rigs the first's count.

        Raises
        ------
        InputError
            If no node published its parameters, or they contradict one another.
        """
        if not self.sections:
            raise InputError("no node published its parameters")
        sections: dict[str, Section] = {}
        for node, section in self.sections.items():
            sections.setdefault(bare(node), section)
        try:
            return Experiment(sections)
        except (KeyError, TypeError, ValueError, AttributeError):
            why = "rate or axes are missing, or are none"
            raise InputError(f"the nodes' parameters make no experiment: {why}") from None


def write_description(
    sections: Mapping[str, Section],
    environment: Mapping[str, Any],
    facts: Mapping[str, dict[str, Any]] | None = None,
) -> list[str]:
    """Texts that describe a test: one for each node with its facts, one for the environment."""
    nodes = [
        {"node": node, "parameters": dict(section), **(facts or {}).get(node, {})}
        for node, section in sections.items()
    ]
    parts = *nodes, {"environment": dict(environment)}
    return [json.dumps(part, allow_nan=False) for part in parts]


def read_description(texts: Iterable[str]) -> tuple[Description, int]:
    """Read a bag's texts, and count those that are no description.

    Of a node that published two descriptions the last counts.
    """
    description, refused = Description(), 0
    for text in texts:
        try:
            part = json.loads(text)
        except (ValueError, RecursionError):
            part = None
        match part:
            case {"node": str(node), "parameters": dict(parameters), **facts}:
                description.sections[node] = parameters
                if facts:
                    description.facts[node] = {str(name): fact for name, fact in facts.items()}
            case {"environment": dict(environment)}:
                description.environment = environment
            case _:
                refused += 1
    return description, refused


def describe_environment(mode: str) -> dict[str, Any]:
    """Describe where and with what a test is run; no names of people, hosts or folders.

    All are JSON values.

    Parameters
    ----------
    mode : str
        How the test is run: ``simulate``, or the rig's pace.

    Returns
    -------
    dict
        ``start`` (wall clock, ISO 8601 with zone), ``mode``, ``git`` (``revision`` and
        whether Python files are ``dirty``, of the checkout this file is part of, or None),
        ``python``, ``platform``, ``cpus``, ``versions`` (of packages; None: not installed).
    """
    return {
        "start": datetime.now().astimezone().isoformat(),
        "mode": mode,
        "git": git_state(Path(__file__).resolve()),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
        "versions": {package: _version(package) for package in PACKAGES},
    }


@cache
def git_state(file: Path) -> dict[str, Any] | None:
    """Revision of the checkout that tracks a file, and whether its Python files differ.

    None if git does not track the file: one that was installed into another project's folder
    does not belong to that project. Git runs once in a process (some 20 ms).
    """
    found = _git(file.parent, "rev-parse", "--show-toplevel", "HEAD")
    if found is None or _git(file.parent, "ls-files", "--error-unmatch", file.name) is None:
        return None
    top, revision = found.splitlines()
    changes = _git(Path(top), "status", "--porcelain", "--", "*.py")
    return None if changes is None else {"revision": revision, "dirty": bool(changes)}


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(folder), *arguments],
            capture_output=True,
            text=True,
            timeout=GIT_TIMEOUT,
            check=True,
        )
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError):
        return None
    return done.stdout.strip()


@cache
def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


@dataclass(frozen=True)
class Series:
    """Samples of one topic, in the order of their steps.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,), strictly increasing; lost steps are missing.
    values : ndarray
        Shape (N, q, n): samples, quantities as on the topic, axes; SI units.
    received_ns : ndarray of int64 or None
        Shape (N,): when each was received, ns of the wall clock; None if no message was, and
        for ground motion, which is sent ahead.
    """

    steps: Ints
    values: Floats
    received_ns: Ints | None = field(default=None, kw_only=True)

    def samples(self) -> Iterator[tuple[int, Floats]]:
        """Give the samples one by one: step, and values of shape (q, n)."""
        return zip(self.steps.tolist(), self.values, strict=True)

    def rows(self, which: Any) -> Self:
        """Keep some samples: an index, mask or slice of the first axis."""
        received = None if self.received_ns is None else self.received_ns[which]
        steps, values = self.steps[which], self.values[which]
        return replace(self, steps=steps, values=values, received_ns=received)

    def until(self, last_step: int) -> Self:
        """Cut the series after a step."""
        return self.rows(slice(int(np.searchsorted(self.steps, last_step, side="right"))))

    def of_steps(self, steps: Ints) -> Self:
        """Keep the samples of some steps."""
        return self.rows(np.isin(self.steps, steps))


def every_step(series: Series, every: Ints) -> Floats:
    """Values at every one of these consecutive steps, shape (N, q, n); lost ones interpolated."""
    if len(every) == 0 or np.array_equal(series.steps[: len(every)], every):
        return series.values[: len(every)]
    flat = series.values.reshape(len(series.steps), -1)
    columns = [np.interp(every, series.steps, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(len(every), *series.values.shape[1:])


def series_of(samples: Mapping[int, Floats], quantities: int, axes: int) -> Series:
    """Make a series of samples by step, each of shape (q, n), or (n,) where q is 1.

    If there are samples, ``axes`` may be -1.
    """
    steps = sorted(samples)
    values = np.array([samples[step] for step in steps])
    return Series(np.array(steps, np.int64), values.reshape(len(steps), quantities, axes))


@dataclass(frozen=True)
class Estimates(Series):
    """What the compensation method identified on line, sampled every few steps.

    Attributes
    ----------
    names : tuple of str
        The q quantities: ``delay`` (s), ``stiffness`` (N/m), ``damping`` (N s/m)...
    """

    names: tuple[str, ...]


@dataclass(frozen=True)
class Event:
    """What a node reported while a test ran: a state, a warning, a trip.

    Attributes
    ----------
    time_s : float
        When it was received, s after the rig's first sample was received.
    source : str
        The node.
    level : str
        ``ok``, ``warn``, ``error`` or ``stale``.
    text : str
        The report.
    """

    time_s: float
    source: str
    level: str
    text: str


@dataclass(frozen=True)
class Recording:
    """One test, from a bag or from the offline loop.

    Attributes
    ----------
    experiment : Experiment
        The resolved configuration of every node.
    series : dict
        Topic name (relative, as in `seft_msgs_py.wire.topics`) -> `Series`. ``ground_motion`` is
        cut at the last step of ``rig/state``: what was published ahead is not part of the
        test.
    estimates : Estimates or None
        None if the compensation method identified nothing.
    trip : Trip or None
        None if the test ran to its end, or the operator stopped it.
    stopped : bool
        Whether the operator stopped it.
    ramp_step : int or None
        First step whose reference force the supervisor had ramped down; None if it had not.
    missed : int or None
        Steps at which the rig had no new command; None if unknown (the
        recorder was cut off before the rig reported it).
    missed_steps : list of int
        The first of these steps (the rig lists a bounded number).
    overruns : int or None
        Sampling overruns: the rig's own clock was late by more than half a period, and went on
        from there; None if unknown.
    saturation : Saturation
        What the rig reported as saturated.
    simulated : Simulated or None
        Largest true motion of a simulated rig; None if the rig is none, or it is unknown.
    round_trips : dict
        From a sample to its command as the rig measured it, s, by the keys of `ROUND_TRIPS`;
        empty where it did not.
    link : LinkReport or None
        How reference forces arrived over a link, as the force controller reported; None without
        a report.
    events : list of Event
        What the nodes reported, in the order of time; each once until it changes.
    wall_s : float or None
        Wall-clock duration of the test; None if unknown.
    complete : bool
        Whether the rig reported the end of the test in this recording.
    damage : list of str
        What is wrong with the bag, and what is therefore missing.
    checked : bool
        Whether changed samples would have been noticed: the bag has checksums, or there is none.
    environment : dict
        Wall-clock start, git revision, package versions, mode, as recorded.
    facts : dict
        Node -> what it says of itself beside its parameters.
    """

    experiment: Experiment
    series: dict[str, Series]
    estimates: Estimates | None = None
    trip: Trip | None = None
    stopped: bool = False
    ramp_step: int | None = None
    missed: int | None = 0
    missed_steps: list[int] = field(default_factory=list)
    overruns: int | None = 0
    saturation: Saturation = field(default_factory=dict)
    simulated: Simulated | None = None
    round_trips: dict[str, float] = field(default_factory=dict)
    link: LinkReport | None = None
    events: list[Event] = field(default_factory=list)
    wall_s: float | None = None
    complete: bool = True
    damage: list[str] = field(default_factory=list)
    checked: bool = True
    environment: dict[str, Any] = field(default_factory=dict)
    facts: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def last_step(self) -> int | None:
        """Last step before a trip, or a stop, brought the force down; None if neither did."""
        last = [] if self.trip is None else [self.trip.step]
        if self.ramp_step is not None:
            last.append(max(self.ramp_step - 1, 0))
        return min(last, default=None)

    @cached_property
    def states(self) -> Series:
        """The judged samples, as the loop used them, shape (N, 4, n)."""
        states = self.series[RIG_STATE.name]
        return replace(states, values=states.values[:, : len(CHANNELS)])

    @cached_property
    def measured(self) -> Series:
        """The samples as measured, shape (N, 4, n); the judged ones where none was recorded."""
        judged = self.states
        measured = self.series.get(MEASURED.name, judged)
        if np.array_equal(judged.steps, measured.steps):
            return replace(judged, values=measured.values)
        _, at, known = np.intersect1d(judged.steps, measured.steps, True, return_indices=True)
        values = judged.values.copy()
        values[at] = measured.values[known]
        return replace(judged, values=values)


def of_all_rigs(parts: Sequence[Series], rigs: Sequence[RigAxes]) -> Series:
    """Join the series of several rigs: the steps that all have, received when all were."""
    if len(parts) == 1:
        return parts[0]
    steps = reduce(np.intersect1d, (part.steps for part in parts))
    kept = [part.rows(np.searchsorted(part.steps, steps)) for part in parts]
    axes = sum(len(rig.axes) for rig in rigs)
    values = np.empty((len(steps), parts[0].values.shape[1], axes))
    for part, rig in zip(kept, rigs, strict=True):
        values[:, :, list(rig.places)] = part.values
    times = [part.received_ns for part in kept if part.received_ns is not None]
    received = np.max(times, axis=0) if len(times) == len(parts) else None
    return Series(steps, values, received_ns=received)


def require_names(step: int, estimates: Iterable[str], names: Sequence[str]) -> None:
    """Refuse, as WireError, estimates of a step with other names than those of the first."""
    if tuple(estimates) != tuple(names):
        before = ", ".join(names)
        raise WireError(f"estimates of step {step} are {', '.join(estimates)}, but were {before}")
