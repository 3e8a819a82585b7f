"""Seismological files: K-NET and KiK-net, SAC, miniSEED. ObsPy reads them; it is an extra.

Counts of a digitiser become accelerations by the sensitivity in the station's metadata, which
ObsPy reads too (StationXML, RESP, dataless SEED).
"""

import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from seft_msgs_py.errors import InputError

from seft_ros.ground_motion.readers.columns import Columns
from seft_ros.ground_motion.readers.statements import Statement, other_quantity, read_unit

_SAC_HEADER, _SAC_VERSION, _SAC_VERSIONS = 632, 304, (6, 7)  # bytes, place
_SAC_OTHER = {6: "displacement", 7: "velocity", 50: "voltage"}
_LOWEST, _HIGHEST = 0.1, 0.25  # Hz, of the rate: the band in which a response must be flat
_FLAT = 0.05  # relative to the sensitivity


def read_knet(path: Path, lines: list[str]) -> Columns | None:
    """Read a K-NET or KiK-net record: counts times the scale factor of its header, in cm/s^2.

    Raises
    ------
    InputError
        If ObsPy can't read it, or is not installed; if it is shorter than its header says.
    """
    head = "\n".join(lines[:40]).lstrip()
    if not (re.match(r"Origin Time\s+\d", head) and "Scale Factor" in head):
        return None  # nor is it one as csv
    text = "\n".join(line for line in lines if line.strip())
    trace = _read(path, text.encode("ascii", "replace"), "KNET", "K-NET")[0]
    duration, stated = len(trace) * trace.stats.delta, float(trace.stats.knet.duration)
    if stated - duration >= 1:  # s; it is stated in whole ones
        other = f"{len(trace)} values follow, {duration:g} s: the file is truncated; fetch it again"
        raise InputError(f"{path}: its header says {stated:g} s, but {other}")
    unit = Statement("cm/s2", "Scale Factor in gal")
    values = np.asarray(trace.data, dtype=float) * (100 * trace.stats.calib)
    return _columns(path, [values], [""], "K-NET", trace.stats.delta, unit)


def read_sac(path: Path, data: bytes, response: str) -> Columns | None:
    """Read a SAC record, see `read_miniseed`; its header may say that it is no acceleration."""
    version = data[_SAC_VERSION : _SAC_VERSION + 4]
    orders = {int.from_bytes(version, order) for order in ("little", "big")}
    if len(data) <= _SAC_HEADER or orders.isdisjoint(_SAC_VERSIONS):
        return None
    stream = _read(path, data, "SAC", "SAC")
    other = _SAC_OTHER.get(int(stream[0].stats.sac.get("idep", 0) or 0))
    if other and not response:
        raise other_quantity(path, 1, other)
    return _scaled(path, stream, response, "SAC")


def read_miniseed(path: Path, data: bytes, response: str) -> Columns | None:
    """Read a miniSEED record: a column for each channel.

    Counts are divided by the sensitivity in ``response``, a file of the station's metadata; they
    are refused without. Values that are no counts have the unit that the user gives.

    Raises
    ------
    InputError
        If ObsPy can't read it, or is not installed; if there are counts without their response, or
        it is not that of an accelerometer, flat within 5 % of its sensitivity from 0.1 Hz to a
        quarter of the rate; if there is a gap.
    """
    old = data[:6].decode("latin-1").strip(" \0")
    is_old = (old.isdigit() or not old) and data[6:7] in b"DRQM" and data[7:8] in b" \0"
    if len(data) <= 48 or not (data.startswith(b"MS\x03") or is_old):  # of version 3, or 2
        return None
    return _scaled(path, _read(path, data, "MSEED", "miniSEED"), response, "miniSEED")


def _read(path: Path, data: bytes, kind: str, called: str) -> Any:
    """Read a stream by ObsPy, contiguous pieces joined."""
    obspy = _obspy(path, called)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a header's oddities; what can't be read is an error
        try:
            stream = obspy.read(io.BytesIO(data), format=kind)
            stream.merge(method=-1)
        except Exception as error:  # ObsPy raises any kind
            why = f"ObsPy can't read it as {called}: {_reason(error)}; fetch it again"
            raise InputError(f"{path}: {why}") from None
    if not len(stream) or any(not len(trace) for trace in stream):
        raise InputError(f"{path}: holds no samples; fetch it again")
    return stream


def _reason(error: Exception) -> str:
    """Give what ObsPy says, in one short line."""
    return (" ".join(str(error).split()) or type(error).__name__)[:200]


def _obspy(path: Path, called: str) -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import obspy
    except ImportError:
        mend = "install it beside seft: pip install 'src/seft_ros[motions]'"
        raise InputError(f"{path}: is a {called} record, which ObsPy reads; {mend}") from None
    return obspy


def _scaled(path: Path, stream: Any, response: str, called: str) -> Columns:
    ids = [trace.id for trace in stream]
    kinds = {(float(trace.stats.delta), len(trace)) for trace in stream}
    if len(set(ids)) < len(ids):
        raise InputError(f"{path}: channel {ids[0]} has a gap; cut the record off there")
    if len(kinds) > 1:
        differ = "its channels differ in length or sampling period; save each as a file"
        raise InputError(f"{path}: {differ}")
    try:
        values = [np.asarray(trace.data, dtype=float) for trace in stream]
    except (TypeError, ValueError):
        raise InputError(f"{path}: holds text, no samples; give a record") from None
    unit = None
    if response:
        values = [v / _sensitivity(path, t, response) for v, t in zip(values, stream, strict=True)]
        unit = Statement("m/s2", f"the response in {response}")
    elif any((each == np.rint(each)).all() and each.any() for each in values):
        raise InputError(
            f"{path}: holds counts of a digitiser; set ground_motion response (--response) to the "
            "station's metadata (StationXML), or convert it to accelerations"
        )
    return _columns(path, values, ids, called, stream[0].stats.delta, unit)


def _sensitivity(path: Path, trace: Any, response: str) -> float:
    """Give the counts for 1 m/s^2 that a station's metadata state, if its response is flat."""
    f = np.geomspace(_LOWEST, max(_HIGHEST / trace.stats.delta, _LOWEST), 50)
    obspy, share = _obspy(path, "seismological"), np.ones_like(f)
    try:
        stated = obspy.read_inventory(response).get_response(trace.id, trace.stats.starttime)
        found = stated.instrument_sensitivity
        unit, size = read_unit(found.input_units or ""), float(found.value)
        if stated.response_stages and unit == "m/s2":
            share = np.abs(stated.get_evalresp_response_for_frequencies(f, output="ACC") / size)
    except Exception as error:  # ObsPy raises any kind
        raise InputError(
            f"{path}: {response} gives no sensitivity of channel {trace.id}: {_reason(error)}; "
            "give the metadata of that station and time"
        ) from None
    if unit != "m/s2" or not np.isfinite(size) or size == 0:
        raise InputError(
            f"{path}: {response} says that channel {trace.id} measures {found.input_units}, "
            f"{size:g} counts for 1; give the record of an accelerometer, in m/s2"
        )
    worst = int(np.abs(share - 1).argmax())
    if not abs(share[worst] - 1) <= _FLAT:
        raise InputError(
            f"{path}: {response} says that the response of channel {trace.id} is "
            f"{share[worst]:.3g} times its sensitivity at {f[worst]:.3g} Hz; remove it by ObsPy "
            "(remove_response, output ACC), save the accelerations, and give their unit"
        )
    return size


def _columns(
    path: Path,
    values: Sequence[np.ndarray[Any, Any]],
    names: Sequence[str],
    layout: str,
    delta: float,
    unit: Statement[str] | None,
) -> Columns:
    table, lines = np.stack(values, axis=1), list(range(1, len(values[0]) + 1))
    called = tuple(names) if any(names) else ()
    dt = Statement(float(f"{delta:.7g}"), "its header")
    return Columns(path, table, lines, layout, called, own_dt=dt, own_unit=unit, quantities=False)
