"""A topic as a bag describes it."""

from contextlib import suppress
from functools import lru_cache
from typing import NamedTuple

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from seft_msgs_py.wire.messages import typestore
from seft_msgs_py.wire.topics import Topic

_QOS = """
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: &forever {{sec: 9223372036, nsec: 854775807}}
  lifespan: *forever
  liveliness: automatic
  liveliness_lease_duration: *forever
  avoid_ros_namespace_conventions: false
"""
_UNKNOWN_HASH = "RIHS01_" + "0" * 64


class BagSource(NamedTuple):
    """A topic as a bag's file describes it."""

    topic: str  # with leading slash
    type: str
    definition: str = ""  # text that defines the type
    encoding: str = "ros2msg"  # of the definition
    serialization: str = "cdr"
    qos: str = ""  # offered, YAML

    def digest(self) -> str:
        """Give the hash of the type, by which ROS 2 tells definitions apart; zeros if unknown."""
        if self.type in typestore().fielddefs:
            return typestore().hash_rihs01(self.type)
        store = get_typestore(Stores.EMPTY)
        with suppress(Exception):  # the definition is foreign text, and its hash dispensable
            store.register(get_types_from_msg(self.definition, self.type))
            return store.hash_rihs01(self.type)
        return _UNKNOWN_HASH


@lru_cache
def source_of(topic: Topic) -> BagSource:
    """Describe a topic of a test, with the quality of service of its publisher."""
    definition, _ = typestore().generate_msgdef(topic.type, ros_version=2)
    durability = "transient_local" if topic.latched else "volatile"
    qos = _QOS.format(depth=topic.depth, durability=durability)
    return BagSource("/" + topic.name.lstrip("/"), topic.type, definition, qos=qos)
