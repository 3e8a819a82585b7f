"""Identification over DDS: the same numbers as offline, on a rig that someone else has started."""

import pytest
from graph_tools import JHU, STALLS_ALLOWED
from seft_ros.test_run.processes import MODULES

SHORT = ("--duration", "6", "--band", "1", "100", "--amplitude", "0.2")


def numbers(printed):
    return {key: value for key, value in printed.items() if key != "files"}


@pytest.mark.thorough
def test_both_tests_on_an_external_rig_give_the_numbers_of_the_offline_loop(seft_json, start):
    """Its parameters are its own: what the experiment says of a rig does not count."""
    patient = ("-p", "rig:pace:=lockstep", *STALLS_ALLOWED)
    start(MODULES["rig"], "--ros-args", "--params-file", JHU, *patient)
    words = ("identify", JHU, *SHORT, *STALLS_ALLOWED)
    elsewhere = ("-p", "rig:simulated.specimen.mass:=20.0", "-p", "rig:pace:=realtime")
    words_of_external = (*words, *elsewhere, "--external", "rig", "--out", "external")
    external = seft_json(*words_of_external)
    assert numbers(external) == numbers(seft_json(*words, "--out", "offline"))
    for name in ("open_loop", "closed_loop"):
        bags = (f"external/{name}", f"offline/{name}")
        assert seft_json("compare", *bags)["identical"] is True
    again = seft_json(*words_of_external)
    assert again == external | {"reused": ["open_loop", "closed_loop"]}
