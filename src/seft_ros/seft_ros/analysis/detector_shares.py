"""How near the detectors of faults came to their thresholds in a test."""

import numpy as np
from seft_msgs_py.wire.topics import REFERENCE_FORCE, RIG_STATE, TARGET
from seft_plant_sim.judge.detector_list import DETECTORS, TRACKING
from seft_plant_sim.judge.detector_step import begin_detectors, detect_all
from seft_plant_sim.judge.detectors import detectors_of
from seft_plant_sim.judge.guard import DRIVE_ROW

from seft_ros.analysis.metrics import common_steps
from seft_ros.bags.recording import Recording
from seft_ros.force_controller.interlock import begin_tracking, track_all, tracking_detector


def detector_shares(recording: Recording) -> dict[str, float] | None:
    """Give the largest value of each detector in a test on any axis, over its threshold, by name.

    None where it is not known: the configuration is not recorded, or no sample.
    """
    experiment, states = recording.experiment, recording.series[RIG_STATE.name]
    rig, controller = (experiment.sections.get(n, {}) for n in ("rig", "force_controller"))
    if "specimen.mass" not in rig or not len(states.steps):
        return None
    axes, dt = experiment.axes, experiment.timebase.dt
    shares = np.zeros(len(DETECTORS))
    measured, drives = recording.measured.values, states.values[:, DRIVE_ROW]
    for one in experiment.rigs:
        parameters, state = detectors_of(rig, axes, dt, one.places)
        own = list(one.places)
        begin_detectors(parameters, state)
        shown, drive = (np.ascontiguousarray(each[..., own]) for each in (measured, drives))
        judged = np.empty_like(parameters.noise)
        detect_all(parameters, state, states.steps, shown, drive, judged)
        shares = np.maximum(shares, state.shares.max(axis=1))
    found = {one.name: share for one, share in zip(DETECTORS, shares.tolist(), strict=True)}
    forces = recording.series[REFERENCE_FORCE.name]
    if controller and forces.values.shape[1] == len(TARGET.quantities):
        steps, at_states, at_forces = common_steps(states.steps, forces.steps)
        watched = tracking_detector(controller, axes, range(len(axes)), dt)
        begin_tracking(watched[1])
        targets = np.ascontiguousarray(forces.values[at_forces, 0])
        track_all(*watched, steps, targets, states.values[at_states])
        found[TRACKING.name] = float(watched[1].shares.max())
    return found
