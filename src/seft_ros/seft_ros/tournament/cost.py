"""What a step of a compensation method costs."""

import timeit
from statistics import median

import numpy as np
from seft_plant_sim.reference.whole_structure import reference_response

from seft_ros.experiment.blocks import build_blocks
from seft_ros.tournament.entries import Entry, Tournament

STEPS = 500
REPEATS = 7


def step_cost(tournament: Tournament, mass_ratio: float, method: str) -> float:
    """Time of a step of the reference force alone, in s: the median of some passes.

    It is shown the response of a perfect test on the configured rig, beginning with the
    strongest shaking, so that methods which identify have something to identify. A first pass
    warms up and does not count.
    """
    experiment = tournament.experiment_of(Entry(mass_ratio, 0, method))
    blocks = build_blocks(experiment)
    motion = blocks.ground_motion
    strongest = int(np.abs(motion.samples).max(axis=1).argmax())
    start = max(0, min(strongest - STEPS // 4, motion.steps - STEPS))
    stop = min(start + STEPS, motion.steps)
    exact = reference_response(experiment, motion.samples[:stop])
    states = np.stack(
        [exact.displacement, exact.velocity, exact.acceleration, exact.force], axis=1
    )[start:stop]
    preview = 1 + blocks.reference_force.preview
    windows = [motion.known[step : step + preview] for step in range(start, stop)]
    step = blocks.reference_force.step

    def one_pass() -> None:
        blocks.reference_force.reset()
        for window, state in zip(windows, states, strict=True):
            step(window, state)

    one_pass()
    return median(timeit.repeat(one_pass, number=1, repeat=REPEATS)) / len(states)
