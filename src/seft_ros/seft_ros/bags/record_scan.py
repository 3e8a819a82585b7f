"""The records of a chunk of mcap, one after the other, by machine code."""

from typing import Any

import numpy as np
from seft_plant_sim.compiled import compiled

_DEFINITIONS = (0x03, 0x04, 0x0B)  # opcodes of a type's and a channel's record, and of counts
_MESSAGE = 0x05
IN_RECORD = 9
"""Bytes of opcode and length."""
_IN_MESSAGE = 22  # bytes of channel, sequence number, log time and publish time


@compiled
def scan(data: Any, places: Any) -> int:
    """Go from record to record and fill in their places; give their number, -1 if damaged.

    A place is a row of `seft_ros.bags.message_blocks.PLACES`. The source of what is no message is
    its opcode, negative.
    """
    at, count = 0, 0
    while at < len(data):
        start, opcode = at + IN_RECORD, data[at]
        length = _integer(data, at + 1, 8) if start <= len(data) else -1
        is_message = opcode == _MESSAGE
        head = _IN_MESSAGE if is_message else 0
        if length < head or length > len(data) - start:
            return -1
        if is_message or opcode in _DEFINITIONS:
            places[count, 0] = _integer(data, start + 6, 8) if is_message else 0
            places[count, 1] = _integer(data, start, 2) if is_message else -np.int64(opcode)
            places[count, 2] = start + head
            places[count, 3] = length - head
            if places[count, 0] < 0:  # in some hundred years
                return -1
            count += 1
        at = start + length
    return count


@compiled
def _integer(data: Any, at: int, size: int) -> Any:
    """Read a little-endian integer."""
    value = np.int64(0)
    for k in range(size):
        value |= np.int64(data[at + k]) << np.int64(8 * k)
    return value
