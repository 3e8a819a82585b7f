"""How a topic stands in a bag: its type's definition and hash, its quality of service."""

from typing import Any

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from seft_msgs_py.wire.messages import typestore
from seft_msgs_py.wire.topics import Topic

from seft_ros.recording.salvage import Source

_FOREVER = QosTime(9223372036, 854775807)
_UNKNOWN_HASH = "RIHS01_" + "0" * 64


def add_topic(writer: Writer, topic: Topic) -> Connection:
    """Introduce a topic of a test to a bag, as it is published."""
    return writer.add_connection(
        "/" + topic.name.lstrip("/"),
        topic.type,
        typestore=typestore(),
        offered_qos_profiles=[
            Qos(
                history=QosHistory.KEEP_LAST,
                depth=topic.depth,
                reliability=QosReliability.RELIABLE,
                durability=QosDurability.TRANSIENT_LOCAL
                if topic.latched
                else QosDurability.VOLATILE,
                deadline=_FOREVER,
                lifespan=_FOREVER,
                liveliness=QosLiveliness.AUTOMATIC,
                liveliness_lease_duration=_FOREVER,
                avoid_ros_namespace_conventions=False,
            )
        ],
    )


def add_source(writer: Writer, source: Source) -> Connection:
    """Introduce a topic to a bag as another bag had it, of whatever type."""
    definition = source.definition
    if source.type in typestore().fielddefs:
        digest = typestore().hash_rihs01(source.type)
        definition = definition or typestore().generate_msgdef(source.type, ros_version=2)[0]
    else:
        digest = _hash(source)
    return writer.add_connection(
        source.topic,
        source.type,
        msgdef=definition,
        rihs01=digest,
        serialization_format=source.serialization,
        offered_qos_profiles=_qos(source.qos),
    )


def _hash(source: Source) -> str:
    store = get_typestore(Stores.EMPTY)
    try:
        store.register(get_types_from_msg(source.definition, source.type))
        return store.hash_rihs01(source.type)
    except Exception:  # the definition is foreign text: the message counts, not its hash
        return _UNKNOWN_HASH


def _qos(text: str) -> list[Qos]:
    profile: Any = text
    try:
        return parse_qos(profile)
    except Exception:  # likewise
        return []
