"""Facts: which there are, where a file has them, and what they were called before."""

import re
from fnmatch import filter as matching

import pytest
from seft_msgs_py.config.facts import (
    CHANNELS,
    EVERY_NODE,
    FACTS,
    SETTINGS,
    fact_of,
    facts,
    place_of,
)
from seft_msgs_py.config.renamed import _PATTERNS, renamed
from seft_msgs_py.wire.topics import NODES

OLD = """
ground_motion: mass -> /**: specimen.mass
reference_force: identified.force_lag_error -> /**: calibration.force_lag_error
reference_force: identified.mass_error -> /**: specimen.mass_error
reference_force: model.springs -> /**: specimen.springs
reference_force: compensation.delay -> /**: actuator.delay
force_controller: sensor_lag -> /**: calibration.*_lag
reference_force: compensation.sensor_lag -> /**: calibration.*_lag
reference_force: compensation.actuator_kind -> /**: actuator.kind
reference_force: tracking.dead_time -> /**: actuator.response.dead_time
force_controller: noise.velocity_source -> /**: sensors.velocity
reference_force: compensation.noise.position -> /**: sensors.displacement_noise
force_controller: noise.force -> /**: sensors.force_noise
force_controller: detectors.specimen_stiffness -> /**: specimen.stiffness
force_controller: detectors.test -> reference_force: mass_ratio
force_controller: detectors.actuator_kind -> /**: actuator.kind
force_controller: detectors.position_range -> /**: sensors.displacement_range
force_controller: detectors.force_range -> /**: sensors.force_range
force_controller: horizon -> reference_force: compensation.horizon
force_controller: voltage_limit -> /**: limits.command
force_controller: watchdog.state_timeout -> rig: watchdog.command_timeout
force_controller: watchdog.ramp_down_time -> reference_force: ramp_down_time
force_controller: watchdog.close_time -> rig: safe.close_time
force_controller: plant.numerator -> /**: actuator.*
rig: sensors.position_range -> /**: sensors.displacement_range
rig: actuator.oil_column_frequency -> /**: actuator.oil_stiffness
rig: actuator.supply_pressure -> /**: actuator.*
rig: actuator.oil_volume -> /**: actuator.*
rig: calibration.position_zero -> /**: calibration.displacement_bias
rig: calibration.force_zero -> /**: calibration.force_bias
rig: calibration.position_lag -> /**: calibration.displacement_lag
supervisor: rehearsal.zeroing -> /**: calibration.zeroing
rig: sensors.position_scale -> rig: simulated.sensors.displacement_scale
rig: sensors.tilt -> rig: simulated.sensors.tilt
rig: specimen.kind -> rig: simulated.specimen.kind
rig: specimen.bouc_wen.beta -> rig: simulated.specimen.bouc_wen.beta
rig: actuator.stroke -> rig: simulated.actuator.stroke
rig: actuator.friction -> rig: simulated.actuator.friction
"""
RENAMES = [line.split(" -> ") for line in OLD.strip().splitlines()]


@pytest.mark.parametrize(("old", "new"), RENAMES)
def test_an_old_name_names_one_that_there_is(old, new):
    assert re.match(r"\S+: [\w.*]+", renamed(*old.split(": ")))[0] == new
    place, name = new.split(": ")
    if not name.startswith("simulated."):  # of the rig's table, see test_truth.py
        assert matching(FACTS if place == EVERY_NODE else SETTINGS, name)
        assert place_of(name, place) == place


def test_each_line_of_the_old_names_is_of_use_and_none_takes_a_present_one():
    first = {next(line for line, _ in _PATTERNS if re.fullmatch(line, old)) for old, _ in RENAMES}
    assert first == {line for line, _ in _PATTERNS}
    present = (*FACTS, *SETTINGS, *(new.split(": ")[1] for _, new in RENAMES), "seed")
    assert not any(renamed(node, name) for node in NODES for name in present)


def test_a_node_has_the_facts_that_it_names_after_rate_and_axes():
    assert [row.name for row in facts()] == ["rate", "axes"]
    limits = [row.name for row in facts("limits.", "specimen.mass")]
    assert limits[:3] == ["rate", "axes", "specimen.mass"]
    assert limits[3:7] == [f"limits.{channel}" for channel in CHANNELS]


def test_a_fact_is_the_default_of_a_truth_of_its_name_or_of_the_calibration():
    assert fact_of("simulated.actuator.flow_gain") == "actuator.flow_gain"
    assert fact_of("simulated.sensors.force_noise") == "sensors.force_noise"
    assert fact_of("simulated.sensors.force_bias") == "calibration.force_bias"
    assert fact_of("simulated.actuator.stroke") == fact_of("actuator.flow_gain") == ""
