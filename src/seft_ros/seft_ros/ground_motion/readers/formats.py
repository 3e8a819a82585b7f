"""The formats of recorded motions, in the order in which a file is tried."""

from pathlib import Path

from seft_ros.ground_motion.readers.column_file import read_column_file
from seft_ros.ground_motion.readers.columns import Columns
from seft_ros.ground_motion.readers.cosmos import is_cosmos, read_cosmos
from seft_ros.ground_motion.readers.csmip import is_csmip, read_csmip
from seft_ros.ground_motion.readers.geonet import is_geonet, read_geonet
from seft_ros.ground_motion.readers.peer import check_name, is_peer, read_peer
from seft_ros.ground_motion.readers.record_text import read_bytes, to_lines
from seft_ros.ground_motion.readers.seismological import (
    is_knet,
    is_miniseed,
    is_sac,
    read_knet,
    read_miniseed,
    read_sac,
)
from seft_ros.ground_motion.readers.smc import is_smc, read_smc

TEXT_FORMATS = (
    (is_cosmos, read_cosmos),
    (is_smc, read_smc),
    (is_geonet, read_geonet),
    (is_csmip, read_csmip),
    (is_peer, read_peer),
)
"""What tells a format, and its reader, by path and lines; any other text is a `column_file`."""

SEISMOLOGICAL_FORMATS = ((is_sac, read_sac), (is_miniseed, read_miniseed))
"""The same for binary files, by their bytes."""


def read_file(path: Path, rows: bool = False, response: str = "") -> Columns:
    """Read a record in any format.

    Parameters
    ----------
    path : Path
        The file.
    rows : bool
        Text that is in no agency's format is one motion in rows.
    response : str
        File of the station's metadata, for SAC and miniSEED; empty: none.

    Raises
    ------
    InputError
        If the file can't be read, or is no record.
    """
    data = read_bytes(path)
    if is_knet(data):
        return read_knet(path, data)
    for matches, read in SEISMOLOGICAL_FORMATS:
        if matches(data):
            return read(path, data, response)
    lines = to_lines(path, data)
    for is_format, read_format in TEXT_FORMATS:
        if is_format(path, lines):
            return read_format(path, lines)
    if not rows:
        check_name(path)
    return read_column_file(path, lines, rows)
