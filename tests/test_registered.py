"""Method, controller and restoring force of somebody else's package take part like ours."""

import json
import os
import subprocess
import sys

import pytest
from graph_tools import JHU

THEIRS = '''
from dataclasses import dataclass

import numpy as np
from seft_plant_sim.simulated.springs import HystereticSpring


class Bare:
    """The paper's equation."""

    def __init__(self, knowledge):
        self._known = knowledge

    def step(self, ground_motion, state):
        known = self._known
        return -known.total_mass @ ground_motion[0] - known.computed_mass @ state[2]


class Damped:
    """Force error through a low pass."""

    def __init__(self, knowledge, gain):
        self._gain, self._axes = gain, knowledge.axes
        self._keep = np.exp(-2 * np.pi * 10.0 * knowledge.dt)
        self.reset()

    def reset(self):
        self._low = np.zeros(self._axes)

    def step(self, reference_force, state):
        drive, error = self._low, reference_force - state[3]
        self._low = self._keep * self._low + (1 - self._keep) * self._gain * error
        return drive


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
THEIR_WORDS = (
    *("-p", "force_controller:method:=damped", "-p", "force_controller:settings:=gain=0.004"),
    *("-p", "rig:simulated.specimen.kind:=pinching"),
    *("-p", "rig:simulated.specimen.yield_displacement:=0.004"),
    *("-p", "rig:simulated.specimen.settings:=rounding=3.0"),
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
def results(tmp_path_factory):
    """What `seft` tells with an installed package that registers all kinds, in one process."""
    folder = tmp_path_factory.mktemp("installed")
    described = folder / "their_lab-1.0.dist-info"
    described.mkdir()
    (folder / "theirs.py").write_text(THEIRS)
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: their-lab\nVersion: 1.0\n")
    (described / "entry_points.txt").write_text(REGISTERED)
    commands = {
        "simulated": ("simulate", JHU, *SHORT, *THEIR_WORDS, "--json"),
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


def test_a_controller_and_a_spring_with_their_settings_are_simulated(results):
    """In nodes: test_local_drawn.py; what can't be made: seft_msgs_py's test_registered.py."""
    assert json.loads(results["simulated"][1])["stable"] is True


def test_a_method_of_step_alone_is_simulated_by_preflight_and_before_a_run(results):
    status, out, err = results["bare"]
    assert status == 0
    assert "bare has no linear(), so the margins of its stability are not known" in err
    assert "displacement error" in out
    status, out, err = results["refused"]
    assert (status, out) == (2, "")  # with --json its stdout has one object alone
    assert "the test is unstable in simulation" in err
