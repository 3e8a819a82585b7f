"""A good driver of a rig passes the conformance test, and a bad one fails what it is bad at."""

import json
import os

import numpy as np
import pytest
from graph_tools import JHU, ROOT, wait_for
from seft_msgs_py.node.process import is_running
from seft_msgs_py.wire.messages import Status
from seft_ros.cli.rig_commands import TEMPLATES
from seft_ros.conformance.driver import Trial
from seft_ros.conformance.motion_checks import STOP_TIME_NAME, check_safe_command

THOROUGH = pytest.mark.thorough
TEMPLATE = TEMPLATES / "rig_driver"
PATIENT = (
    *("-p", "rate:=250.0"),
    *("-p", "rig:watchdog.command_timeout:=1.0"),
)
"""What a machine that does much else holds, as a rule."""
LONE = ("-p", "rig:watchdog.supervisor_timeout:=2.0")


@pytest.fixture
def start_driver(start, domain):
    """Start a driver, good or bad, of the template's, and wait until it is there."""

    def launch(module):
        paths = (ROOT / "tests", TEMPLATE, os.environ.get("PYTHONPATH", ""))
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))}
        words = ("--ros-args", "--params-file", TEMPLATE / "config" / "rig.yaml", *PATIENT, *LONE)
        process = start(module, *words, env=environment)
        wait_for(lambda: process.poll() is not None or is_running(domain, "/rig"), "the driver")
        assert process.poll() is None, process.communicate()
        return process

    return launch


def failed(result):
    return {check["check"] for check in result["checks"] if check["verdict"] == "failed"}


def shown(result):
    return [f"{c['verdict']}  {c['check']}: {c['result']}" for c in result["checks"]]


LATE = {"period", "late states", "answer applied"}
"""Checks that a driver may fail on a machine that does much else: it then misses commands."""


def check_conforms(seft, *words):
    """See that a good driver passes, in all that does not depend on this machine's other work."""
    done = seft("conform", JHU, *words, "--json")
    result = json.loads(done.stdout)
    assert failed(result) <= LATE, shown(result)
    if not failed(result):
        assert (done.returncode, result["conforms"], result["not_run"]) == (0, True, 0)


@THOROUGH
def test_the_simulated_rig_conforms(seft):
    check_conforms(seft, "--start-rig", *PATIENT, *LONE)


@THOROUGH
def test_the_template_conforms(seft, start_driver):
    start_driver("rig_driver.driver_node")
    check_conforms(seft, *PATIENT, "--yes")


@THOROUGH
def test_a_bad_driver_fails_what_it_is_bad_at(seft, start_driver):
    """Of wrong units and signs, and of a watchdog that does not act, see test_conformance.py."""
    start_driver("bad_drivers")
    done = seft("conform", JHU, *PATIENT, "--yes", "--json", status=1)
    result = json.loads(done.stdout)
    refusals = {"command stale", "command of the future"}
    checks = refusals | {"stands still", "trip is latched"}
    assert checks <= failed(result), shown(result)
    remedies = {c["check"]: c["remedy"] for c in result["checks"] if c["verdict"] == "failed"}
    assert all(remedies.values())


def test_a_rig_that_goes_on_after_a_trip_is_in_no_safe_command():
    rests = Status("rig", 2, "", values={"phase": "tripped", STOP_TIME_NAME: "0.1"})
    samples = [(step, np.zeros((4, 1)), np.zeros(1), 0.004 * step) for step in range(20)]
    trial = Trial(statuses=[(0.1, rests)], read=samples)
    farther = trial.samples._replace(values=np.full((20, 4, 1), 0.01))
    verdicts = [check_safe_command(trial, then).verdict for then in (trial.samples, farther)]
    assert verdicts == ["passed", "failed"]


def test_a_rig_that_is_not_simulated_is_not_moved_unasked(seft):
    done = seft("conform", JHU, status=2)
    assert "the rig will be moved (0.2 V, stopped at 5 mm): say --yes" in done.stderr
