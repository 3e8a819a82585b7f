"""Records that must be read: real files, both AT2 dialects, columns and csv."""

from pathlib import Path

import numpy as np
import pytest
from recordings_at_hand import fixed
from seft_ros.ground_motion.record_file import read_record

G = 9.80665
HEADER = "PEER NGA STRONG MOTION DATABASE RECORD\nSOMEWHERE 01/02/03, STATION, 090\n"
UNITS_OF_G = "ACCELERATION TIME HISTORY IN UNITS OF G\n"
SEVEN = "  .1E+00  -.2E+00   .3E+00  -.4E+00   .5E+00\n -.6E+00   .7E+00\n"


@pytest.mark.parametrize(
    "line",
    [
        "7    0.0100    NPTS, DT",
        "NPTS=  7, DT= .01000 SEC",
        "NPTS=      7, DT=   .0100 SEC,",
        "npts=7,dt=.01sec",
        "NPTS = 7 , DT = 1.0E-02 SEC",
        "NPTS  7  DT  0.01",
        "  7 .0100 npts dt",
        "7, 0.0100, NPTS, DT",
    ],
)
@pytest.mark.parametrize("name", ["a.AT2", "a.txt"])
def test_at2_reads_in_both_header_dialects_and_with_its_short_last_line(read, line, name):
    record = read(HEADER + UNITS_OF_G + line + "\n" + SEVEN, unit="g", name=name)
    assert record.dt == 0.01
    expected = np.array([[0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]]).T * G
    np.testing.assert_allclose(record.accelerations, expected, rtol=1e-15)


def test_at2_reads_without_a_line_end_after_the_last_value_and_with_windows_line_ends(read):
    text = (HEADER + UNITS_OF_G + "NPTS= 7, DT= .01 SEC\n" + SEVEN).rstrip().replace("\n", "\r\n")
    record = read(text, [0, 0], "g", name="a.at2")
    assert record.accelerations.shape == (7, 2)
    np.testing.assert_allclose(record.accelerations[-1], 0.7 * G)


def test_fortran_numbers_that_run_together_are_taken_apart(read):
    body = "-.123E-02-.456E-03+.5E+00\n 1.5D+00-2.5D-01 3.-4.\n"
    record = read(HEADER + UNITS_OF_G + "NPTS= 7, DT= .01 SEC\n" + body, unit="g")
    values = record.accelerations[:, 0] / G
    np.testing.assert_allclose(values, [-1.23e-3, -4.56e-4, 0.5, 1.5, -0.25, 3.0, -4.0], rtol=1e-14)


def test_columns_are_chosen_in_the_order_asked_for(read):
    record = read("1 2 3\n4 5 6\n", [2, 0], "m/s2", 0.02, name="own.txt")
    np.testing.assert_array_equal(record.accelerations, [[3, 1], [6, 4]])
    assert record.dt == 0.02
    assert record.source == "own.txt"


@pytest.mark.parametrize("mark", ["%", "#", "//", "!", ";"])
def test_comment_lines_and_blank_lines_may_stand_anywhere(read, mark):
    text = f"{mark} 1 2\n  {mark} more\n\n1\t2\n{mark} between\n\n3\t4\n{mark} end\n\n"
    record = read(text, [1], "m/s2", 0.01)
    np.testing.assert_array_equal(record.accelerations, [[2], [4]])


@pytest.mark.parametrize(
    "text",
    [
        "Kobe 1995 JMA\nsecond line of text\n1 2\n3 4\n",
        "a,b\n1,2\n3,4\n",
        "a;b\n1;2\n3;4\n",
        "1, 2\n3 ,4\n",
        "1;2;\n3;4;\n",
        "\ufeffa,b\r\n1,2\r\n3,4\r\n",
        "a\tb\r1\t2\r3\t4\r",
        '"first a","second a"\n1.0e0,2\n3,+4.\n',
        "1 2\n3 4\n\x1a",
    ],
)
def test_headers_separators_and_line_ends_are_known_by_the_content(read, text):
    record = read(text, [0, 1], "m/s2", 0.01, name="a.csv")
    np.testing.assert_array_equal(record.accelerations, [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("header", "separator", "factor"),
    [
        ("time,acc", ",", 1),
        ("t [s];a [g]", ";", 1),
        ("t\ta", "\t", 1),
        ("# time acc", " ", 1),
        ('"Time (sec)","a"', ",", 1),
        ("t (ms),a", ",", 1000),
    ],
)
def test_a_column_whose_name_says_time_gives_the_period(read, refuses, header, separator, factor):
    rows = [f"{0.005 * k * factor:.6g}{separator}{0.1 * k}" for k in range(4)]
    text = "\n".join([header, *rows])
    record = read(text, [1], "g")
    assert record.dt == 0.005
    assert read(text, [1], "g", 0.005).dt == 0.005
    np.testing.assert_allclose(record.accelerations[:, 0], [0, 0.1 * G, 0.2 * G, 0.3 * G])
    refuses(r"dt is 0\.00502 s, but .* says 0\.005 s", text, [1], "g", 0.00502)
    refuses(r"column is 0, but .* is the time \(line 1\)", text, [0], "g")


REALS = [-999.0] * 100
REALS[33], REALS[61] = 0.02, 5.0  # s of the instrument, ms of these values


def cosmos(quantity="acceleration", values=(1.0, -2.5, 3.25), count=3, unit="cm/sec2(04)"):
    """Make a channel of a COSMOS file."""
    return "\n".join([
        f"Corrected {quantity}    (Format v01.20 with 1 text lines)",
        "  10 Integer-header values follow on  1 lines, Format= (10I8)",
        "".join(f"{k:8d}" for k in range(10)),
        " 100 Real-header values follow on  17 lines, Format= (6F13.6)",
        fixed(REALS, 13, 6, 6).removesuffix("\n"),
        '   1 Comment line(s) follow, each starting with a "|":',
        "| Sensor: an accelerometer",
        f"  {count} {quantity} pts, approx   1 secs, units={unit},Format=(8F10.5)",
        "".join(f"{value:10.5f}" for value in values),
        f"End-of-data for Chan  1 {quantity}",
    ]) + "\n"  # fmt: skip


def test_cosmos_reads_with_each_channel_of_acceleration_as_a_column(read):
    second = cosmos(values=(123.45678, -999.12345, 1e3))  # these run together
    text = cosmos() + cosmos("velocity") + second + cosmos("displacement", unit="cm(06)")
    record = read(text, [0, 1], name="CE47380.V2c")
    assert (record.dt, record.unit) == (0.005, "cm/s2")
    expected = [[0.01, 1.2345678], [-0.025, -9.9912345], [0.0325, 10.0]]
    np.testing.assert_allclose(record.accelerations, expected, rtol=1e-6)


def smc(count=3, rate=200.0):
    """Make an SMC file."""
    integers, reals = [-32768] * 48, [1.7e38] * 50
    integers[15], integers[16], reals[1] = 2, count, rate
    return "\n".join([
        "2 CORRECTED ACCELEROGRAM",
        *["*"] * 10,
        *("".join(f"{value:10d}" for value in integers[at : at + 8]) for at in range(0, 48, 8)),
        *("".join(f"{value:15.7E}" for value in reals[at : at + 5]) for at in range(0, 50, 5)),
        "|",
        "| a comment",
        " 1.5057E+0-2.2223E+0-1.9234E+1",
    ]) + "\n"  # fmt: skip


def test_smc_reads_in_cm_per_second_squared_at_the_rate_of_its_header(read):
    record = read(smc(), name="0111a.smc")
    assert (record.dt, record.unit) == (0.005, "cm/s2")
    np.testing.assert_allclose(record.accelerations[:, 0], [0.015057, -0.022223, -0.19234])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (cosmos(count=4), "says 4 values, but 3 values follow: the file is truncated"),
        (cosmos("velocity", unit="cm/sec(05)"), "holds a velocity"),
        (cosmos(unit="counts (50)"), "counts is no acceleration unit"),
        (smc(count=4), "line 13 says 4 values, but 3 values follow"),
        (smc(rate=0.0), "gives no count of values and no rate"),
        (smc()[:300], "gives no count of values and no rate"),
    ],
)
def test_a_file_of_an_agency_that_holds_no_whole_record_is_refused(refuses, text, message):
    refuses(message, text, [0])


def test_a_given_dt_may_be_finer_than_the_rounded_one_of_the_file(read, refuses):
    text = "NPTS= 2, DT= .0039 SEC\n 1.0 2.0\n"
    assert read(text, [0], "g", 0.003903).dt == 0.003903
    refuses(r"dt is 0\.00390625 s", text, [0], "g", 0.00390625)


DATA = Path(__file__).parents[3].parent / "shared" / "data"


@pytest.mark.skipif(not DATA.is_dir(), reason="no real records beside the project")
@pytest.mark.parametrize(
    ("name", "columns", "unit", "dt", "steps", "peaks"),
    [
        ("kobe_jma_1995.txt", [0, 1], "cm/s2", 0.005, 6000, [0.841, 0.631]),
        ("elcentro_1940.txt", [0, 1], "cm/s2", 0.005, 6000, [0.313, 0.215]),
        ("kobe_nishi_akashi_090.AT2", [0], "g", 0.0, 4096, [0.503]),
    ],
)
def test_real_records_have_the_peaks_their_networks_state(name, columns, unit, dt, steps, peaks):
    record = read_record(DATA / name, columns, unit, dt)
    assert record.accelerations.shape == (steps, len(columns))
    np.testing.assert_allclose(np.abs(record.accelerations).max(axis=0) / G, peaks, atol=6e-4)
    assert record.dt == (dt or 0.01)
    assert record.accelerations[-1].any()  # the last line is there
