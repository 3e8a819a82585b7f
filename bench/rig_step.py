"""Time of one step of the simulated rig: in a compiled loop, and called from Python.

The floor is a compiled loop of the linear rig's matrix alone, in the same run. With its guard the
rig also judges the sample.
"""

import sys
import time
from pathlib import Path

import numpy as np
from seft_msgs_py.config.experiment import Experiment
from seft_plant_sim.compiled import compiled, multiply
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import RIG_TABLE
from seft_plant_sim.simulated.rig import SimulatedRig
from seft_plant_sim.simulated.rig_step import rig_step

CONFIG = Path(__file__).parent.parent / "config" / "demo.yaml"
STEPS = 4000
ROUNDS = 20
WANTED = {"linear": 5e6, "nonlinear": 2.5e6}  # steps/s in a compiled loop
WANTED_CALL = 4e-6  # s from Python, of the nonlinear rig

YIELDS = ("rig", "simulated.specimen.yield_displacement", 0.002)
FILTERED = [
    *(
        ("rig", f"simulated.sensors.{c}_filter", 200.0)
        for c in ("displacement", "acceleration", "force")
    ),
    ("/**", "sensors.velocity", "derived"),
]
CASES = {
    "linear": [("/**", "actuator.kind", "servo_hydraulic_linear")],
    "nonlinear": [],
    "nonlinear, bilinear": [("rig", "simulated.specimen.kind", "bilinear"), YIELDS],
    "nonlinear, Bouc-Wen": [("rig", "simulated.specimen.kind", "bouc_wen"), YIELDS],
    "nonlinear, pinching": [("rig", "simulated.specimen.kind", "pinching"), YIELDS],
    "nonlinear, filtered": FILTERED,
    "nonlinear, 3 axes": [("/**", "axes", ["x", "y", "z"])],
    "nonlinear, 10 axes": [("/**", "axes", [f"x{i}" for i in range(10)])],
}


@compiled
def run(parameters, state, commands, noise, samples):
    """Take all steps of a rig."""
    for step in range(len(noise)):
        rig_step(parameters, state, step, commands[step], noise[step], samples[step])


@compiled
def run_floor(matrix, state, result, steps):
    """Take as many products of a matrix and a vector."""
    for _ in range(steps):
        multiply(matrix, state, result)


def shortest(function, *arguments) -> float:
    """Seconds of a call, of all calls the least disturbed one."""
    function(*arguments)
    times = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        function(*arguments)
        times.append(time.perf_counter() - start)
    return min(times)


def call_all(rig: Rig, commands: np.ndarray) -> None:
    """Take all steps of a rig from Python."""
    rig.reset()
    for command in commands:
        rig.step(command)


def call_hardware(rig: SimulatedRig, commands: np.ndarray) -> None:
    """Take all steps of its hardware alone."""
    rig.reset()
    rig.read()
    for command in commands:
        rig.write(command)
        rig.read()


def main() -> int:
    speeds, calls, guarded, floor = {}, {}, {}, 0.0
    for case, overrides in CASES.items():
        experiment = Experiment.load([RIG_TABLE], [CONFIG], overrides, nodes=["rig"])
        whole = Rig(experiment["rig"], experiment.axes, experiment.timebase)
        rig = whole.simulation
        turn = 2 * np.pi * experiment.timebase.dt * np.arange(STEPS)[:, np.newaxis]
        commands = 2.0 * np.sin(5.0 * turn) + 1.4 * np.sin(
            2.3 * turn + np.arange(len(experiment.axes))
        )
        samples = np.empty((STEPS, *rig.sample.shape))
        arrays = rig.parameters, rig.state, commands, rig.sensors.noise_block(0, STEPS), samples
        speeds[case] = STEPS / shortest(run, *arrays)
        calls[case] = shortest(call_hardware, rig, commands) / STEPS
        guarded[case] = shortest(call_all, whole, commands) / STEPS
        if case == "linear":
            predict, work = rig.parameters.dynamics.predict[1], rig.state.motion.work
            floor = STEPS / shortest(run_floor, predict, work, rig.state.motion.state, STEPS)
    print(
        f"{'step of the rig':24s} {'in a loop':>14s} {'floor over it':>14s} {'from Python':>12s} "
        f"{'with its guard':>15s}"
    )
    for case, speed in speeds.items():
        ratio, call, judged = floor / speed, calls[case] * 1e6, guarded[case] * 1e6
        print(f"{case:24s} {speed:10,.0f} 1/s {ratio:8.1f} times {call:9.1f} us {judged:12.1f} us")
    print(f"wanted: {WANTED} steps/s; one call within {WANTED_CALL * 1e6:.0f} us")
    fast = all(speeds[case] >= wanted for case, wanted in WANTED.items())
    return 0 if fast and calls["nonlinear"] <= WANTED_CALL else 1


if __name__ == "__main__":
    sys.exit(main())
