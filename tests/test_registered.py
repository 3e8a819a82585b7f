"""Method, controller and restoring force of somebody else's package take part like ours."""

import json
import os
import subprocess
import sys

import pytest
from graph_tools import JHU

THEIRS = '''"""A compensation method, a controller and a spring."""

from dataclasses import dataclass

import numpy as np
from seft_plant_sim.springs import HystereticSpring
from seft_ros.force_controller.force_control import LinearControl


class Bare:
    """The paper's equation, and a count that a new test must begin anew."""

    def __init__(self, knowledge):
        self._known, self._steps = knowledge, 0

    def step(self, ground_motion, state):
        self._steps += 1
        known = self._known
        inertia = known.total_mass @ ground_motion[0] + known.computed_mass @ state[2]
        return -inertia * min(self._steps / 500, 1.0)


class Damped:
    """Force error through a low pass, and the piston's velocity, which the flow must make up."""

    def __init__(self, knowledge, gain, by_velocity=0.0):
        self._gain, self._by_velocity, self._axes = gain, by_velocity, knowledge.axes
        self._keep = np.exp(-2 * np.pi * 10.0 * knowledge.dt)
        self.reset()

    def reset(self):
        self._low = np.zeros(self._axes)

    def step(self, reference_force, state):
        drive = self._low + self._by_velocity * state[1]
        error = reference_force - state[3]
        self._low = self._keep * self._low + (1 - self._keep) * self._gain * error
        return drive

    def linear(self):
        one, none = np.eye(self._axes), np.zeros((self._axes, self._axes))
        by_error = (1 - self._keep) * self._gain * one
        return LinearControl(
            a=self._keep * one,
            b=np.hstack([by_error, none, none, none, -by_error]),
            c=one,
            d=np.hstack([none, none, self._by_velocity * one, none, none]),
        )


@dataclass(frozen=True)
class Pinching(HystereticSpring):
    """Yields the later, the further it has gone."""

    rounding: float = 2.0

    def rate(self, z, velocity, work):
        share = min(abs(z) / self.yield_displacement, 1.0)
        return velocity * (1.0 - share**self.rounding) if z * velocity > 0 else velocity
'''
REGISTERED = """\
[seft.compensation]
bare = theirs:Bare
[seft.force_control]
damped = theirs:Damped
[seft.restoring_force]
pinching = theirs:Pinching
"""
SHORT = ("-p", "ground_motion:synthetic.duration:=3.0", "-p", "reference_force:mass_ratio:=0.1")
CONTROLLER = (
    *("-p", "force_controller:method:=damped"),
    *("-p", "force_controller:settings:=gain=0.004 by_velocity=1.5"),
)
SPRING = (
    *("-p", "rig:specimen.kind:=pinching", "-p", "rig:specimen.yield_displacement:=0.004"),
    *("-p", "rig:specimen.settings:=rounding=3.0"),
)


COMMANDS = """
import json, sys
from pathlib import Path
from commands_at_hand import run_seft
commands = json.load(sys.stdin)
json.dump({name: run_seft(Path(), *words) for name, words in commands.items()}, sys.stdout)
"""


def with_method(name, ratio):
    method = ("-p", f"reference_force:compensation.method:={name}")
    return (JHU, *SHORT[:2], *method, "-p", f"reference_force:mass_ratio:={ratio}")


@pytest.fixture(scope="module")
def told(tmp_path_factory):
    """What `seft` tells with an installed package that registers all kinds, in one process."""
    folder = tmp_path_factory.mktemp("installed")
    described = folder / "their_lab-1.0.dist-info"
    described.mkdir()
    (folder / "theirs.py").write_text(THEIRS)
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: their-lab\nVersion: 1.0\n")
    (described / "entry_points.txt").write_text(REGISTERED)
    commands = {
        "ours": ("preflight", JHU, *SHORT, "--json"),
        "theirs": ("preflight", JHU, *SHORT, *CONTROLLER, "--json"),
        "simulated": ("simulate", JHU, *SHORT, *CONTROLLER, *SPRING, "--json"),
        "bare": ("preflight", *with_method("bare", 0.4)),
        "refused": ("run", *with_method("bare", 3.0), "--out", "refused"),
    }
    done = subprocess.run(
        [sys.executable, "-c", COMMANDS],
        input=json.dumps(commands, default=str),
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)])},
        **{"cwd": folder, "text": True, "check": True, "stdout": subprocess.PIPE},
    )
    return json.loads(done.stdout)


def test_what_is_registered_with_its_settings_is_simulated_and_known_to_preflight(told):
    """In nodes: test_local_drawn.py; what can't be made: seft_msgs_py's test_registered.py."""
    ours, theirs, simulated = (
        json.loads(told[name][1]) for name in ("ours", "theirs", "simulated")
    )
    assert theirs["critical_mass_ratio"] < 0.5 * ours["critical_mass_ratio"]
    assert simulated["stable"] is True


def test_a_method_of_step_alone_is_simulated_by_preflight_and_before_a_run(told):
    status, out, err = told["bare"]
    assert status == 0
    assert "bare has no linear(), so the margins of its stability are not known" in err
    assert "done: displacement error" in out
    status, _, err = told["refused"]
    assert status == 2
    assert "the test is unstable in simulation" in err
