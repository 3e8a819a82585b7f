"""How well the actuators followed their intended forces, and the specimen its target.

Signals are of shape (N, n) or (N,). Undefined results (of a command that is zero throughout, of too
few samples, of values that are not finite) are NaN. Signals of different shapes are a ValueError.
"""

from dataclasses import dataclass

import numpy as np
from seft_msgs_py.arrays import Floats, Ints
from seft_msgs_py.wire.topics import GROUND_MOTION, REFERENCE_FORCE, RIG_STATE, TARGET
from seft_plant_sim.whole_structure import whole_structure

from seft_ros.analysis import metrics
from seft_ros.analysis.equivalent_motion import EquivalentMotion, assumed_structure
from seft_ros.bags.recording import Recording, every_step

SENT_AS_MEANT = ("none", "restoring", "target_motion")
"""Compensation methods whose reference force is that of its own step; others send it ahead."""

_DISPLACEMENT, _FORCE = (RIG_STATE.quantities.index(name) for name in ("positions", "effort"))


@dataclass(frozen=True)
class Tracked:
    """Signals at every step from the first to the last that both topics have.

    Attributes
    ----------
    steps : ndarray of int64
        Shape (N,), consecutive.
    counted : ndarray of int64
        Indices of those that both topics have, increasing.
    command, force : ndarray
        Intended and measured force, N, shape (N, n); lost samples are interpolated.
    derived : bool
        Whether the intended force is derived from measurements, and not the one sent.
    """

    steps: Ints
    counted: Ints
    command: Floats
    force: Floats
    derived: bool


def tracked_of(recording: Recording) -> Tracked:
    """Pair the intended with the measured force.

    The intended force is the reference force of the same step; where the compensation method
    sends that ahead of time, it is f* = -M_e a_g + S r, from measurements (docs/theory.md, "The
    algebraic loop solved"). With the test's own ground motion a_eq this is
    f* = f + M_e (a_eq - a_g), whatever is computed.
    """
    commands, motion = (recording.series[topic.name] for topic in (REFERENCE_FORCE, GROUND_MOTION))
    states = recording.states
    steps, _, _ = metrics.common_steps(commands.steps, states.steps)
    every = np.arange(steps[0], steps[-1] + 1) if len(steps) else steps
    counted = steps - every[:1]
    measured = every_step(states, every)
    force = measured[:, _FORCE]
    section = recording.experiment.sections.get("reference_force", {})
    assumed = assumed_structure(recording.experiment)
    ahead = section.get("compensation.method", "none") not in SENT_AS_MEANT
    command = every_step(commands, every)[:, -1]  # effort, with a target's motion or not
    derived = bool(ahead and assumed and len(motion.steps) and len(every))
    if derived and assumed:
        equivalent = EquivalentMotion(whole_structure(assumed), recording.experiment.timebase.dt)
        with np.errstate(over="ignore", invalid="ignore"):  # of a test that went unstable
            difference = equivalent.advance(measured) - every_step(motion, every)[:, 0]
            command = force + difference @ equivalent.mass.T
    return Tracked(every, counted, command, force, derived)


def tracking_of(recording: Recording) -> dict[str, dict[str, float]]:
    """Measure the tracking of each axis.

    The intended force is that of `tracked_of`. Where it is the reference force of the same step,
    even an ideal actuator is one period late: the rig measures at step k what commands before it
    did. Samples between the first and the last step that both topics have count; lost ones are
    left out of errors, and interpolated for the delay.

    Returns
    -------
    dict
        Axis -> ``delay_s`` (best-fit pure delay, positive where the measured force m lags the
        intended one c), ``nrmse``, RMS(m - c) / RMS(c), and ``peak_error``, max|m - c| / max|c|.
    """
    signals, dt = tracked_of(recording), recording.experiment.timebase.dt
    found = {}
    with np.errstate(invalid="ignore", over="ignore"):  # of a test that went unstable
        for column, axis in enumerate(recording.experiment.axes):
            c, m = (y[:, column] for y in (signals.command, signals.force))
            error = (m - c)[signals.counted]
            found[axis] = {
                "delay_s": metrics.best_fit_delay(m, c, dt),
                "nrmse": metrics.nrmse(m[signals.counted], c[signals.counted]),
                "peak_error": metrics.ratio(metrics.peak(error), metrics.peak(c[signals.counted])),
            }
    return found


def tracking_error_of(recording: Recording) -> dict[str, float] | None:
    """Compare the displacement of a test with its target; None: the reference force has none.

    Returns
    -------
    dict
        ``rms`` and ``peak`` of x - x_target, m, over all axes, and ``nrmse``, that RMS over the
        RMS of x.
    """
    targets, states = recording.series[REFERENCE_FORCE.name], recording.states
    if targets.values.shape[1] < len(TARGET.quantities):
        return None
    _, at_targets, at_states = metrics.common_steps(targets.steps, states.steps)
    wanted, x = targets.values[at_targets, 0], states.values[at_states, _DISPLACEMENT]
    with np.errstate(invalid="ignore", over="ignore"):
        error = wanted - x
        rms = float(np.sqrt(np.mean(np.square(error)))) if error.size else np.nan
    return {"rms": rms, "peak": metrics.peak(error), "nrmse": metrics.nrmse(wanted, x)}
