"""Table of protection_results.md: the largest force while a test is stopped.

Run it in the project:

    .venv/bin/python docs/stops.py 40

So many stops of each test: half at moments drawn at random, half at those of the fastest motion.
"""

import sys
from copy import deepcopy

import numpy as np
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.judge.known_rig import read_specimen
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

LINEAR = (
    "reference_force:compensation.method:=target_motion",
    "force_controller:method:=velocity_feedforward",
    "reference_force:mass_ratio:=1.0",
    "ground_motion:peak_force:=500.0",
)
TESTS = {
    "`config/demo.yaml`": ("config/demo.yaml",),
    "`config/jhu.yaml`, mass ratio 1, 500 N": ("config/jhu.yaml", *LINEAR),
    "`config/three_storey_frame.yaml`": ("config/three_storey_frame.yaml",),
}


def stops(experiment, moments):
    """Stop a test at each step of some: peak force without and with the plan, and of rest."""
    blocks = build_blocks(experiment)
    rig, force, interlock = blocks.rig, blocks.reference_force, blocks.force_controller
    force.reset(), interlock.reset()
    known, window = blocks.ground_motion.known, 1 + force.preview
    _, stiffness = read_specimen(experiment["rig"], experiment.axes, range(len(experiment.axes)))
    state = rig.reset()
    for step in range(max(moments) + 1):
        points = force.step(known[step : step + window], state[: len(CHANNELS)])
        command = interlock.step(step, points, state)
        if step in moments:
            closed, stopped = deepcopy(rig), deepcopy(rig)
            peaks = closed.stop().peak_force, stopped.stop(interlock.stop(step)).peak_force
            yield *peaks, np.abs(stiffness @ stopped.simulation.sample[0]).max()
        state = rig.step(command)


def main():
    """Print the table."""
    count, rng = int(sys.argv[1]) // 2, np.random.default_rng(1)
    print("| test | moments | the valve closes | along the plan | specimen at rest there |")
    print("|---|---|---|---|---|")
    for name, (config, *words) in TESTS.items():
        experiment = Experiment.load(TABLES, [config], list(map(parse_override, words)))
        recording = simulate_test(experiment, build_blocks(experiment))
        speed = np.abs(recording.states.values[:, 1]).max(axis=1)
        fastest = [
            step
            for step in np.argsort(-speed).tolist()
            if speed[step] == speed[max(0, step - 25) : step + 25].max()
        ]
        chosen = {
            "at random": rng.integers(100, len(speed) - 200, count).tolist(),
            "fastest": fastest[:count],
        }
        for which, moments in chosen.items():
            found = np.array(list(stops(experiment, set(moments))))
            worst = found.max(axis=0) / recording.simulated.force_peak
            print(f"| {name} | {which} | {worst[0]:.2f} | {worst[1]:.2f} | {worst[2]:.2f} |")


if __name__ == "__main__":
    main()
