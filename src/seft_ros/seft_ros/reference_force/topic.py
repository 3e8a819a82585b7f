"""What the topic reference_force carries in a test."""

from collections.abc import Mapping
from typing import Any

from seft_msgs_py.wire.topics import REFERENCE_FORCE, TARGET, LoopTopic

from seft_ros.reference_force.compensation.names import TARGET_MOTION


def reference_force_topic(section: Mapping[str, Any]) -> LoopTopic:
    """Give the topic as the reference force's section of an experiment makes it.

    Whoever does not know that section reads it as `REFERENCE_FORCE`: the force of a target, too.
    """
    is_target = section.get("compensation.method") == TARGET_MOTION
    return TARGET if is_target else REFERENCE_FORCE
