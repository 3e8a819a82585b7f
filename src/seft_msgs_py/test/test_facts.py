"""Facts: which there are, and where a file has them."""

from seft_msgs_py.config.facts import CHANNELS, fact_of, facts


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
