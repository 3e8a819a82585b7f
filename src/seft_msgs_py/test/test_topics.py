from collections import Counter

import pytest
from seft_msgs_py.wire.topics import (
    GROUND_MOTION,
    JOINT_TRAJECTORY,
    JUDGED,
    LOOP_TOPICS,
    NODES,
    QUANTITIES,
    REFERENCE_FORCE,
    RIG_STATE,
    TOPICS,
    VALVE_COMMAND,
)

TRANSIENT_LOCAL = {"ground_motion", "experiment/state", "experiment/description"}


def test_the_topics_are_those_of_the_contract():
    assert {topic.name: topic.publisher for topic in TOPICS} == {
        "ground_motion": "ground_motion",
        "rig/state": "rig",
        "rig/judged": "force_controller",
        "reference_force": "reference_force",
        "valve_command": "force_controller",
        "reference_force/estimates": "reference_force",
        "experiment/state": "supervisor",
        "experiment/description": "",
        "diagnostics": "",
        "/clock": "rig",
    }


@pytest.mark.parametrize(
    ("topic", "quantities", "units"),
    [
        (GROUND_MOTION, ("accelerations",), ("m/s^2",)),
        (RIG_STATE, QUANTITIES, ("m", "m/s", "m/s^2", "N")),
        (JUDGED, QUANTITIES, ("m", "m/s", "m/s^2", "N")),
        (REFERENCE_FORCE, ("effort",), ("N",)),
        (VALVE_COMMAND, ("effort",), ("V",)),
    ],
)
def test_a_loop_topic_carries_its_quantities_in_si_units(topic, quantities, units):
    assert topic.type == JOINT_TRAJECTORY
    assert (topic.quantities, topic.units) == (quantities, units)


def test_names_are_relative_so_that_a_test_fits_in_a_namespace():
    assert [topic.name for topic in TOPICS if topic.name.startswith("/")] == ["/clock"]
    assert max(Counter(topic.name for topic in TOPICS).values()) == 1


def test_publishers_and_subscribers_are_nodes():
    for topic in TOPICS:
        assert {topic.publisher, *topic.subscribers} <= {*NODES, ""}
        assert topic.publisher not in topic.subscribers


def test_who_comes_late_gets_the_state_the_descriptions_and_the_motion():
    assert {topic.name for topic in TOPICS if topic.latched} == TRANSIENT_LOCAL


def test_loop_topics_keep_enough_for_a_recorder_that_stalls():
    for topic in LOOP_TOPICS:
        if topic is not GROUND_MOTION:  # whose messages are chunks
            assert topic.depth >= 1000


def test_all_but_the_clock_is_recorded():
    assert [topic.name for topic in TOPICS if not topic.recorded] == ["/clock"]


def test_quantities_stand_in_the_order_of_the_message():
    points = pytest.importorskip("trajectory_msgs.msg").JointTrajectoryPoint
    fields = list(points.get_fields_and_field_types())
    assert fields == [*QUANTITIES, "time_from_start"]


def test_types_exist():
    pytest.importorskip("rclpy")
    from seft_msgs_py.node.rclpy_interface import message_class

    for topic in TOPICS:
        assert message_class(topic).__name__ == topic.type.split("/")[-1]
