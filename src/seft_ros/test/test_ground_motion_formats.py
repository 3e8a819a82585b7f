"""Formats of agencies: CSMIP, GeoNet, ESM, and what ObsPy reads; PEER, COSMOS and SMC elsewhere."""

import re
import sys

import numpy as np
import pytest
from recordings_at_hand import fixed

COUNT = 23
WAVE = np.round(100 * np.sin(0.4 * np.arange(COUNT)), 1)
OTHER = WAVE + 1000


def check(record, values, unit, size, dt, layout):
    np.testing.assert_allclose(record.accelerations.T, np.atleast_2d(values) * size, rtol=1e-12)
    assert (record.unit, record.dt) == (unit, dt)
    assert record.channels[0]["layout"] == layout


def volume_2(values, dialect="in cm/sec2. (8f10.3)", others=True):
    """Make a CSMIP channel of volume 2."""
    one = "Corrected accelerogram   Chan  1:  H1\n    1  100    1    3\n  .0101833  .6400000\n"
    one += f"{len(values):6d} points of accel data equally spaced at  .010 sec, {dialect}\n"
    one += fixed(values, 10, 3, 8)
    for quantity, unit in (("veloc", "cm/sec."), ("displ", "cm.")) if others else ():
        one += f"{COUNT:6d} points of {quantity} data equally spaced at  .010 sec, in {unit}\n"
        one += fixed(OTHER, 10, 3, 8)
    return one + "/&  ----------  End of data for channel  1  ----------\n"


@pytest.mark.parametrize("dialect", ["in cm/sec2. (8f10.3)", "(UNITS: CM/SEC/SEC)", "in cm/sec2."])
@pytest.mark.parametrize("others", [True, False])
def test_csmip_of_volume_2_reads_with_each_channel_as_a_column(read, dialect, others):
    text = volume_2(WAVE, dialect, others) + volume_2(2 * WAVE, dialect, others)
    check(read(text, [0, 1]), [WAVE, 2 * WAVE], "cm/s2", 0.01, 0.01, "CSMIP")
    check(read(text), WAVE, "cm/s2", 0.01, 0.01, "CSMIP")


def test_channels_may_differ_in_length_but_not_where_both_are_used(read, refuses):
    text = volume_2(WAVE) + volume_2(WAVE[:-3])
    check(read(text, [1]), WAVE[:-3], "cm/s2", 0.01, 0.01, "CSMIP")
    refuses("differ in length", text, [0, 1])


def test_csmip_of_volume_1_reads_in_g(read):
    head = "Uncorrected Accelerogram Data\nNo. of Points =  23  Record Length = .11 sec\n"
    line = "    23 Accelerogram points at 200 pts/sec in units of g .      Format: (8f9.6)\n"
    text = head + line + fixed(WAVE / 1000, 9, 6, 8)
    check(read(text), WAVE / 1000, "g", 9.80665, 0.005, "CSMIP")


def pairs(times):
    """Make a CSMIP channel of volume 1 with pairs of time and acceleration."""
    head = ["UNCORRECTED ACCELEROGRAM DATA", *["*"] * 9, "NO. OF POINTS =   23  RECORD LENGTH"]
    head += ["UNITS OF UNCOR ACCEL ARE SEC AND G/10.     MAX  =  -.100 G", "RMS ACCEL  =  .006 G."]
    head += ["    1    1    1    3"] * 7 + ["      .039      .561"] * 7
    table = np.stack([times, WAVE / 100], axis=1)
    return "\n".join(head) + "\n" + fixed(np.ravel(table), 7, 3, 10)


def test_csmip_with_pairs_of_time_and_acceleration_reads_if_the_times_are_even(read, refuses):
    record = read(pairs(100 + 0.005 * np.arange(COUNT)))
    check(record, WAVE / 1000, "g", 9.80665, 0.005, "CSMIP")
    times = 0.005 * np.arange(COUNT)
    times[7:] += 0.002
    refuses(r"time goes from 0.03 to 0.037.*resample", pairs(times))


def geonet(values, component, others=True):
    """Make a GeoNet component of volume 2, in mm/s^2."""
    head = ["Corrected accelerogram 20161113_110256_HSES_20 GNS Science", *["*"] * 8]
    head += [f"Number of points{len(values):6d}    Duration 0.44 sec"]
    head += ["Instrument corrected data at 0.020 sec intervals", "Band-pass filter"]
    head += [f"Component {component}  Longitudinal"]
    head += ["Acceleration:  peak   -100.0 mm/s/s at  48.14 sec     rms    292.2 mm/s/s"]
    head += ["Velocity:      peak  -298.49 mm/s", "Displacement:  peak   99.407 mm"]
    head += ["    2016      11"] * 4 + ["   200.0    0.70"] * 6
    others_text = fixed(OTHER, 8, 1, 10) * 2 if others else ""
    return "\n".join(head) + "\n" + fixed(values, 8, 2, 10) + others_text


@pytest.mark.parametrize("others", [True, False])
def test_geonet_reads_in_mm_with_each_component_as_a_column(read, refuses, others):
    values = WAVE
    text = geonet(values, "N10E", others) + geonet(-values, "N80W", others)
    check(read(text, [0, 1]), [values, -values], "mm/s2", 0.001, 0.02, "GeoNet")
    assert read(text, [1]).channels[0]["column"] == 'column 1 "N80W"'
    refuses(r"unit is m/s2, but .* says mm/s2", text, unit="m/s2")
    short = text.replace("    2016      11\n", "", 1)
    refuses(r"\d rows of values follow, but 23 points are 3 rows", short)


def test_geonet_of_volume_1_reads_in_the_unit_of_its_raw_readings(read):
    raw = "Raw readings in units of 1.00 mm/s/s  at intervals of 0.005 s"
    text = geonet(WAVE, "N10E", others=False)
    text = text.replace("Instrument corrected data at 0.020 sec intervals", raw)
    check(read(text), WAVE, "mm/s2", 0.001, 0.005, "GeoNet")


ESM = (
    "EVENT_NAME: GREECE\nEVENT_DATE_YYYYMMDD: 20190728\nMAGNITUDE_W: \nVS30_M/S: \n"
    "SAMPLING_INTERVAL_S: 0.005000\nNDATA: 23\nDURATION_S: 0.11\nUNITS: cm/s^2\nFULL_SCALE_G: \n"
    "PGA_CM/S^2: -99.99\nLOW_CUT_FREQUENCY_HZ: 0.100\nDATA_TYPE: ACCELERATION\nUSER5: \n"
)


def test_esm_reads_with_what_its_header_states(read, refuses):
    text = ESM + fixed(WAVE, 10, 3, 1)
    check(read(text), WAVE, "cm/s2", 0.01, 0.005, "columns")
    refuses("holds a velocity", text.replace("TYPE: ACCELERATION", "TYPE: VELOCITY"))
    refuses("states 23 points, but 22 values", ESM + fixed(WAVE[1:], 10, 3, 1))


@pytest.mark.parametrize("mark", ["*** End Data ***\n", "\n\n", "--- 23 values ---\n"])
def test_what_follows_the_last_of_the_values_of_peer_is_no_value(read, refuses, mark):
    text = "ACCELERATION IN UNITS OF G\nNPTS= 23, DT= .02000 SEC\n" + fixed(WAVE, 12, 3, 8) + mark
    check(read(text), WAVE, "g", 9.80665, 0.02, "PEER AT2")
    refuses("23 values, but 24 values follow: too many", text.replace(mark, "  1.0\n" + mark))


KNET = "\n".join([
    "Origin Time       2020/01/01 00:00:00", "Lat.              0.0", "Long.             0.0",
    "Depth. (km)       10", "Mag.              5.0", "Station Code      XXX001",
    "Station Lat.      0.0000", "Station Long.     0.0000", "Station Height(m) 1",
    "Record Time       2020/01/01 00:00:15", "Sampling Freq(Hz) 200Hz", "Duration Time(s)  1",
    "Dir.              E-W", "Scale Factor      2000(gal)/8388608", "Max. Acc. (gal)   3.338",
    "Last Correction   2020/01/01 00:00:15", "Memo.             ",
]) + "\n"  # fmt: skip


def test_knet_reads_as_counts_times_the_scale_factor_in_gal(read, refuses):
    pytest.importorskip("obspy")
    counts = np.r_[-14:-3, 0, 4:15] * 1000
    text = KNET + fixed(counts, 9, 0, 8)
    check(read(text), counts * 2000 / 8388608, "cm/s2", 0.01, 0.005, "K-NET")
    check(read(text, unit="gal", dt=0.005), counts * 2000 / 8388608, "cm/s2", 0.01, 0.005, "K-NET")
    refuses(r"unit is g, but .* says cm/s2", text, unit="g")
    for other in (b"\n" + text.encode(), text.encode("utf-16"), text.replace("\n", "\r").encode()):
        check(read(other), counts * 2000 / 8388608, "cm/s2", 0.01, 0.005, "K-NET")
    head = re.sub(r"(?<=[a-z)e.]) {2,}", ",", KNET.replace("3.338", "100.0"))
    times = "".join(f"{0.005 * k:.3f},{v:.1f},0\n" for k, v in enumerate(WAVE))
    check(read(f"{head}Time(s),NS(gal),UD(gal)\n{times}"), WAVE, "cm/s2", 0.01, 0.005, "columns")
    refuses("states the factor 2000, but no line the unit", head + times, [1], unit="gal")
    short = text.replace("Time(s)  1", "Time(s)  3")
    refuses(r"says 3 s, but 23 values follow, .* truncated", short)


def test_the_offset_of_a_digitiser_is_refused_and_taken_off_on_request(read, refuses):
    pytest.importorskip("obspy")
    counts = np.round(14000 * np.sin(np.pi / 20 * np.arange(40))) + 1e6
    text = KNET + fixed(counts, 9, 0, 8)
    refuses(r"line 15 states a peak of 0.03338 m/s2, as without an offset of .*--correct off", text)
    record = read(text, corrected=True)
    np.testing.assert_allclose(record.accelerations[:, 0], counts * 20 / 8388608)
    silent = text.replace("3.338", "0.000")
    refuses(r"has an offset of 2.38\d m/s2, .*--correct offset", silent)
    wrong = text.replace("3.338", "33.38")
    refuses(r"states a peak of 0.3338 m/s2, of another --column", wrong, corrected=True)


@pytest.mark.parametrize("content", [KNET + "1 2\n", b"000001D " + bytes(100)])
def test_without_obspy_its_formats_are_refused_with_its_installation(refuses, content, monkeypatch):
    monkeypatch.setitem(sys.modules, "obspy", None)
    refuses(r"which ObsPy reads; .* 'src/seft_ros\[motions\]'", content)


def seismogram(folder, kind, values, **header):
    """Write a stream of traces by ObsPy; gives its bytes."""
    obspy = pytest.importorskip("obspy")
    station = {"network": "XX", "station": "PSD", "starttime": obspy.UTCDateTime(2020, 1, 1)}
    traces = [
        obspy.Trace(np.array(each), {**station, "channel": f"HN{name}", "delta": 0.005, **header})
        for name, each in zip("ENZ", values, strict=False)
    ]
    path = folder / "seismogram"
    obspy.Stream(traces).write(str(path), format=kind)
    return path.read_bytes()


def metadata(folder, unit="M/S**2", value=2000.0, corner=None):
    """Write the metadata of the station; a response with a high-pass if there is a corner, Hz."""
    obspy = pytest.importorskip("obspy")
    from obspy.core.inventory import Channel, InstrumentSensitivity, Network, Response, Station

    gain = InstrumentSensitivity(value, 10.0, unit, "COUNTS")
    response = Response(instrument_sensitivity=gain)
    if corner is not None:
        poles = {"zeros": [0.0], "poles": [-2 * np.pi * corner]}
        response = Response.from_paz(**poles, stage_gain=value, stage_gain_frequency=10.0)
        response.response_stages[0].input_units = unit
        response.instrument_sensitivity = gain
    channels = [Channel(f"HN{name}", "", 0, 0, 0, 0, response=response) for name in "EN"]
    station = Station("PSD", 0, 0, 0, channels=channels)
    path = folder / "station.xml"
    inventory = obspy.Inventory([Network("XX", stations=[station])], source="test")
    inventory.write(str(path), format="STATIONXML")
    return str(path)


@pytest.mark.parametrize(("kind", "layout"), [("SAC", "SAC"), ("MSEED", "miniSEED")])
def test_what_sac_and_miniseed_hold_has_the_unit_that_is_given(
    read, refuses, tmp_path, kind, layout
):
    data = seismogram(tmp_path, kind, [np.float32(WAVE)])
    check(read(data, unit="gal"), np.float64(np.float32(WAVE)), "cm/s2", 0.01, 0.005, layout)
    refuses("does not say the unit", data)
    refuses(r"dt is 0.01 s, but .* says 0.005 s \(its header\)", data, unit="gal", dt=0.01)


@pytest.mark.parametrize("kind", ["SAC", "MSEED"])
def test_counts_need_the_response_of_an_accelerometer(read, refuses, tmp_path, kind):
    counts = np.int32(WAVE * 1000)
    data = seismogram(tmp_path, kind, [np.float32(counts) if kind == "SAC" else counts])
    refuses(r"holds counts of a digitiser; set .*--response", data, unit="g")
    record = read(data, response=metadata(tmp_path))
    np.testing.assert_allclose(record.accelerations[:, 0], counts / 2000)
    assert "the response in" in record.channels[0]["unit_from"]
    refuses(r"unit is g, but .* says m/s2", data, response=metadata(tmp_path), unit="g")
    refuses(r"measures M/S, .*accelerometer", data, response=metadata(tmp_path, "M/S"))
    flat = read(data, response=metadata(tmp_path, corner=0.01))
    np.testing.assert_array_equal(flat.accelerations, record.accelerations)
    steep, none = metadata(tmp_path, corner=1.0), str(tmp_path / "none.xml")
    refuses(r"is 0.1 times its sensitivity at 0.1 Hz; remove it", data, response=steep)
    refuses(r"gives no sensitivity of channel XX.PSD..HNE", data, response=none)


def test_miniseed_has_a_column_for_each_channel_and_no_gaps(read, refuses, tmp_path):
    counts = [np.int32(WAVE * 1000), np.int32(WAVE * 2000)]
    data = seismogram(tmp_path, "MSEED", counts)
    record = read(data, [1], response=metadata(tmp_path))
    np.testing.assert_allclose(record.accelerations[:, 0], counts[1] / 2000)
    assert record.channels[0]["column"] == 'column 1 "XX.PSD..HNN"'
    obspy = pytest.importorskip("obspy")
    later = seismogram(tmp_path, "MSEED", counts[:1], starttime=obspy.UTCDateTime(2020, 1, 2))
    both = seismogram(tmp_path, "MSEED", counts[:1]) + later
    refuses(r"channel XX.PSD..HNE has a gap", both, response=metadata(tmp_path))


@pytest.mark.parametrize(("code", "quantity"), [(6, "displacement"), (7, "velocity")])
def test_sac_that_says_it_is_no_acceleration_is_refused(refuses, tmp_path, code, quantity):
    data = seismogram(tmp_path, "SAC", [np.float32(WAVE)], sac={"idep": code})
    refuses(f"holds a {quantity}", data, unit="g")


def test_miniseed_of_text_is_refused(refuses, tmp_path):
    data = seismogram(tmp_path, "MSEED", [np.frombuffer(b"some words", dtype="|S1")])
    refuses("holds text, no samples", data, unit="g")


def test_a_damaged_seismological_file_is_refused_in_one_line(refuses, tmp_path):
    data = seismogram(tmp_path, "MSEED", [np.int32(WAVE)])
    refuses("ObsPy can't read it as miniSEED", data[:60], unit="g")
