"""Write a record as a bag of the same form as a recorded one."""

import time
from collections.abc import Iterable
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt
from seft_msgs_py.wire.messages import EstimatesCodec, encode_diagnostics, encode_string
from seft_msgs_py.wire.outcome import FINISHED, RIG, TRIPPED, rig_status
from seft_msgs_py.wire.topics import (
    DESCRIPTION,
    DIAGNOSTICS,
    ESTIMATES,
    GROUND_MOTION,
    NANOSECONDS_PER_SECOND,
    RIG_STATE,
    RIG_TOPICS,
    STEP_TOPICS,
    VALVE_COMMAND,
    RigAxes,
)
from seft_msgs_py.wire.trajectory import TrajectoryCodec

from seft_ros.bags.bag_reader import UNDECODABLE
from seft_ros.bags.bag_writer import BagWriter
from seft_ros.bags.description import write_description
from seft_ros.bags.record import Record, consecutive_runs
from seft_ros.reference_force.reference_force_parameters import reference_force_topic

CHUNK_STEPS = 100
NOT_FINITE = "not_finite"
"""Key of the environment: number of samples that are NaN or infinite, and fit in no message."""

Floats = npt.NDArray[np.float64]
Chunk = tuple[int, Floats]  # first step, values (p, n)


def write_record(
    record: Record,
    path: str | Path,
    storage: str = "mcap",
    ground_motion: Iterable[Chunk] | None = None,
) -> None:
    """Write a bag that `read_bag` reads as this record.

    The messages are those of a test over DDS, in the order of time: the description, then
    each step's rig state, reference force, valve command and estimates, with ground motion one
    message ahead, and the end. The log time of step k is the wall-clock start plus k periods.
    The future motion of a target is not in a record, and therefore not in the bag.
    Samples that are not finite are left out, as no node sends them, and counted in the
    environment.

    Parameters
    ----------
    record : Record
        A test; series may have gaps.
    path : path
        Folder to be made.
    storage : str
        ``mcap`` or ``sqlite3``.
    ground_motion : iterable of (first step, ndarray), optional
        Messages of ground motion, each of shape (p, n), m/s^2; they may go beyond the
        record's end. Default: the record's, in messages of `CHUNK_STEPS`.

    Raises
    ------
    InputError
        If the path exists or can't be written.
    ExperimentError
        If the disk is full.
    """
    timebase, axes = record.experiment.timebase, record.experiment.axes
    start_ns, rigs = _start_ns(record), record.experiment.rigs
    whole = RigAxes.whole(axes)
    forces = reference_force_topic(record.experiment.sections.get("reference_force", {}))
    codecs = {
        topic.name: [
            (rig.places, TrajectoryCodec(topic.of(rig), rig.axes, timebase))
            for rig in (rigs if topic in RIG_TOPICS else [whole])
        ]
        for topic in (GROUND_MOTION, RIG_STATE, forces, VALVE_COMMAND)
    }
    ((_, motion_codec),) = codecs[GROUND_MOTION.name]
    estimates_codec = EstimatesCodec(axes, timebase)
    if ground_motion is None:
        motion = consecutive_runs(record.series[GROUND_MOTION.name], CHUNK_STEPS)
    else:
        motion = [(first, np.ascontiguousarray(v)[:, np.newaxis, :]) for first, v in ground_motion]
    events, not_finite = _events(record)
    environment = {k: v for k, v in record.environment.items() if k != UNDECODABLE}
    if not_finite:
        environment[NOT_FINITE] = not_finite
    with BagWriter(path, storage) as bag:
        for text in write_description(record.experiment.sections, environment, record.facts):
            bag.write(DESCRIPTION, encode_string(text), start_ns)
        sent, time_ns = 0, start_ns
        for step, which, index in events.tolist():
            time_ns = start_ns + timebase.stamp_ns(step)
            while sent < len(motion) and motion[max(0, sent - 1)][0] <= step:
                bag.write(GROUND_MOTION, motion_codec.encode_points(*motion[sent]), time_ns)
                sent += 1
            topic = STEP_TOPICS[which]
            if topic is ESTIMATES and record.estimates:
                named = zip(record.estimates.names, record.estimates.values[index], strict=True)
                bag.write(topic, estimates_codec.encode(step, dict(named)), time_ns)
                continue
            values = record.series[topic.name].values[index]
            for places, codec in codecs[topic.name]:
                raw = codec.encode(step, np.ascontiguousarray(values[:, places]))
                bag.write(codec.topic, raw, time_ns)
        if record.complete and record.missed is not None:
            sampled = record.series[RIG_STATE.name].steps
            status = rig_status(
                TRIPPED if record.trip else FINISHED,
                int(sampled[-1]) + 1 if len(sampled) else 0,
                record.missed,
                record.missed_steps,
                record.wall_s,
                record.trip,
                overruns=record.overruns or 0,
                saturation=record.saturation,
                round_trips=record.round_trips,
                held_steps=record.held_steps,
            )
            # totals of all rigs are reported by the first
            statuses = [replace(status, name=rig.node(RIG)) for rig in rigs]
            quiet = {"missed": "0", "missed_steps": "", "overruns": "0", "saturated": "{}"}
            statuses[1:] = [replace(s, values={**s.values, **quiet}) for s in statuses[1:]]
            bag.write(DIAGNOSTICS, encode_diagnostics(time_ns, statuses), time_ns)


def _events(record: Record) -> tuple[npt.NDArray[np.int64], int]:
    """List the samples to be written, in their order, and count those that are left out.

    Returns
    -------
    events : ndarray of int64
        Shape (M, 3): step, index of the topic in `STEP_TOPICS`, index of the sample.
    not_finite : int
        Samples left out.
    """
    parts, not_finite = [], 0
    for which, topic in enumerate(STEP_TOPICS):
        series = record.estimates if topic is ESTIMATES else record.series[topic.name]
        if topic is GROUND_MOTION or series is None:
            continue
        (kept,) = np.nonzero(np.isfinite(series.values).all(axis=(1, 2)))
        not_finite += len(series.steps) - len(kept)
        parts.append(np.stack([series.steps[kept], np.full_like(kept, which), kept], axis=1))
    events = np.concatenate(parts)
    return events[np.lexsort((events[:, 1], events[:, 0]))], not_finite


def _start_ns(record: Record) -> int:
    """Wall-clock start of the test; now, where it is not known."""
    try:
        start = datetime.fromisoformat(record.environment["start"])
    except (KeyError, TypeError, ValueError):
        return time.time_ns()
    seconds = int(start.replace(microsecond=0).timestamp())
    return seconds * NANOSECONDS_PER_SECOND + start.microsecond * 1000
