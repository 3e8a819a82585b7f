"""Bags as another recorder writes them, and what rosbags reads of one."""

from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)


def contents(path):
    """Topic, time and bytes of every message of a bag."""
    with Reader(path) as reader:
        return [(c.topic, t, bytes(raw)) for c, t, raw in reader.messages()]


def write_stock_bag(path, messages, storage="mcap", mode=CompressionMode.NONE, ends=()):
    """Write (topic, type, time, bytes) of whatever types, without checksums.

    After the messages whose places are in ``ends`` a chunk of mcap ends.
    """
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        kinds = dict.fromkeys(message[:2] for message in messages)
        known = {(n, kind): writer.add_connection(n, kind, typestore=STORE) for n, kind in kinds}
        for place, (name, kind, time, raw) in enumerate(messages):
            writer.write(known[name, kind], time, raw)
            if place in ends and storage == "mcap":
                writer.storage.close_chunk()
    return path
