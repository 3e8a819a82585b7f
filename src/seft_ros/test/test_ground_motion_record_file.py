"""Records that must be read: real files, both AT2 dialects, columns and csv."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError
from seft_ros.ground_motion.record_file import read_record

G = 9.80665
HEADER = "PEER NGA STRONG MOTION DATABASE RECORD\nSOMEWHERE 01/02/03, STATION, 090\n"
UNITS_OF_G = "ACCELERATION TIME HISTORY IN UNITS OF G\n"
SEVEN = "  .1E+00  -.2E+00   .3E+00  -.4E+00   .5E+00\n -.6E+00   .7E+00\n"


def write(folder: Path, text: str, name: str = "motion.txt") -> Path:
    path = folder / name
    path.write_bytes(text.encode())
    return path


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
def test_at2_reads_in_both_header_dialects_and_with_its_short_last_line(tmp_path, line, name):
    record = read_record(write(tmp_path, HEADER + UNITS_OF_G + line + "\n" + SEVEN, name), [0], "g")
    assert record.dt == 0.01
    expected = np.array([[0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]]).T * G
    np.testing.assert_allclose(record.accelerations, expected, rtol=1e-15)


def test_at2_reads_without_a_line_end_after_the_last_value_and_with_windows_line_ends(tmp_path):
    text = (HEADER + UNITS_OF_G + "NPTS= 7, DT= .01 SEC\n" + SEVEN).rstrip().replace("\n", "\r\n")
    record = read_record(write(tmp_path, text, "a.at2"), [0, 0], "g")
    assert record.accelerations.shape == (7, 2)
    np.testing.assert_allclose(record.accelerations[-1], 0.7 * G)


def test_fortran_numbers_that_run_together_are_taken_apart(tmp_path):
    body = "-.123E-02-.456E-03+.5E+00\n 1.5D+00-2.5D-01 3.-4.\n"
    path = write(tmp_path, HEADER + UNITS_OF_G + "NPTS= 7, DT= .01 SEC\n" + body)
    values = read_record(path, [0], "g").accelerations[:, 0] / G
    np.testing.assert_allclose(values, [-1.23e-3, -4.56e-4, 0.5, 1.5, -0.25, 3.0, -4.0], rtol=1e-14)


@settings(deadline=None)
@given(st.lists(st.floats(-1, 1).filter(lambda x: x == 0 or abs(x) > 1e-9), min_size=2))
def test_fixed_width_columns_read_as_what_was_written_run_together_or_not(tmp_path_factory, values):
    rows = [values[i : i + 5] for i in range(0, len(values), 5)]
    body = "\n".join("".join(f"{value:13.6E}" for value in row) for row in rows)
    text = f"{UNITS_OF_G}NPTS= {len(values)}, DT= .02 SEC\n{body}"
    path = write(tmp_path_factory.mktemp("at2"), text)
    read = read_record(path, [0], "m/s2" if "G\n" not in text else "g").accelerations[:, 0] / G
    np.testing.assert_allclose(read, values, rtol=1e-6, atol=0)


@pytest.mark.parametrize(
    ("header", "unit", "size"),
    [
        ("ACCELERATION TIME SERIES IN UNITS OF g (9.81)", "g", G),
        ("ACCELERATION TIME HISTORY IN UNITS OF G. FILTER POINTS: HP=0.2 Hz LP=30.0 Hz", "g", G),
        ("Acceleration, units: cm/s/s", "cm/s2", 0.01),
        ("ACCELERATION IN UNITS OF CM/SEC/SEC", "cm/s2", 0.01),
        ("Acceleration (units of cm/sec^2)", "cm/s2", 0.01),
        ("ACCELERATION UNITS: GAL", "cm/s2", 0.01),
        ("acceleration in units of m/s**2", "m/s2", 1.0),
        ("acceleration", "cm/s2", 0.01),
    ],
)
def test_the_unit_of_an_at2_header_is_understood_in_its_spellings(tmp_path, header, unit, size):
    path = write(tmp_path, f"{header}\nNPTS= 2, DT= .01 SEC\n 1.0 2.0\n")
    np.testing.assert_allclose(read_record(path, [0], unit).accelerations[:, 0], [size, 2 * size])
    others = {"g", "m/s2", "cm/s2"} - {unit} if "nits" in header.lower() else set()
    for other in others:
        with pytest.raises(InputError, match=f"unit is {other}, but .* says {unit}; set unit"):
            read_record(path, [0], other)


@pytest.mark.parametrize(("unit", "size"), [("g", G), ("m/s2", 1.0), ("cm/s2", 0.01)])
def test_each_unit_is_converted_to_metres_per_second_squared(tmp_path, unit, size):
    path = write(tmp_path, "1\n-2.5\n")
    np.testing.assert_allclose(
        read_record(path, [0], unit, 0.01).accelerations, [[size], [-2.5 * size]], rtol=1e-15
    )


def test_columns_are_chosen_in_the_order_asked_for(tmp_path):
    path = write(tmp_path, "1 2 3\n4 5 6\n")
    record = read_record(path, [2, 0], "m/s2", 0.02)
    np.testing.assert_array_equal(record.accelerations, [[3, 1], [6, 4]])
    assert record.dt == 0.02
    assert record.source == str(path)


@pytest.mark.parametrize("mark", ["%", "#", "//", "!", ";"])
def test_comment_lines_and_blank_lines_may_stand_anywhere(tmp_path, mark):
    text = f"{mark} 1 2\n  {mark} more\n\n1\t2\n{mark} between\n\n3\t4\n{mark} end\n\n"
    record = read_record(write(tmp_path, text), [1], "m/s2", 0.01)
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
def test_headers_separators_and_line_ends_are_told_by_the_content(tmp_path, text):
    record = read_record(write(tmp_path, text, "a.csv"), [0, 1], "m/s2", 0.01)
    np.testing.assert_array_equal(record.accelerations, [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("header", "separator", "factor"),
    [
        ("time,acc", ",", 1),
        ("Time (s),Acc (g)", ",", 1),
        ("t [s];a [g]", ";", 1),
        ("t\ta", "\t", 1),
        ("Time (s)\tAcc (g)", "\t", 1),
        ("TIME   ACCELERATION", "  ", 1),
        ("# time acc", " ", 1),
        ("% time, acc", " ", 1),
        ("time_s,a", ",", 1),
        ('"Time (sec)","a"', ",", 1),
        ("t (ms),a", ",", 1000),
    ],
)
def test_a_column_whose_name_says_time_gives_the_sampling_period(
    tmp_path, header, separator, factor
):
    rows = [f"{0.005 * k * factor:.6g}{separator}{0.1 * k}" for k in range(4)]
    path = write(tmp_path, "\n".join([header, *rows]))
    record = read_record(path, [1], "g")
    assert record.dt == 0.005
    assert read_record(path, [1], "g", 0.005).dt == 0.005
    np.testing.assert_allclose(record.accelerations[:, 0], [0, 0.1 * G, 0.2 * G, 0.3 * G])
    with pytest.raises(InputError, match=r"dt is 0\.00502 s, but .* says 0\.005 s"):
        read_record(path, [1], "g", 0.00502)
    with pytest.raises(InputError, match=r"column is 0, but .* is the time \(line 1\)"):
        read_record(path, [0], "g")


def test_a_given_dt_may_be_finer_than_the_rounded_one_of_the_file(tmp_path):
    path = write(tmp_path, "NPTS= 2, DT= .0039 SEC\n 1.0 2.0\n")
    assert read_record(path, [0], "g", 0.003903).dt == 0.003903
    with pytest.raises(InputError, match=r"dt is 0\.00390625 s"):
        read_record(path, [0], "g", 0.00390625)


def test_times_may_be_uneven_by_less_than_one_percent_of_the_step(tmp_path):
    even = write(tmp_path, "t,a\n0,1\n1.0,1\n2.009,1\n3.0,1\n4,2\n")
    assert read_record(even, [1], "g").dt == 1.0
    uneven = write(tmp_path, "t,a\n0,1\n1.0,1\n2.011,1\n3.0,1\n4,2\n")
    with pytest.raises(InputError, match=r"line 4: time goes from 1 to 2\.011"):
        read_record(uneven, [1], "g")


def test_a_long_file_reads_whole(tmp_path):
    lines = [f"{k * 0.005:.3f},{k % 7}" for k in range(100_000)]
    record = read_record(write(tmp_path, "time,acc\n" + "\n".join(lines)), [1], "m/s2")
    np.testing.assert_array_equal(record.accelerations[:, 0], np.arange(100_000) % 7)
    assert record.dt == 0.005


DATA = Path(__file__).parents[3].parent / "shared" / "data"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="no real records beside the project")


@pytest.mark.parametrize(
    ("name", "columns", "unit", "dt", "steps", "peaks"),
    [
        ("kobe_jma_1995.txt", [0, 1], "cm/s2", 0.005, 6000, [0.841, 0.631]),
        ("elcentro_1940.txt", [0, 1], "cm/s2", 0.005, 6000, [0.313, 0.215]),
        ("kobe_nishi_akashi_090.AT2", [0], "g", 0.0, 4096, [0.503]),
    ],
)
def test_real_records_read_with_the_peaks_their_networks_state(
    name, columns, unit, dt, steps, peaks
):
    record = read_record(DATA / name, columns, unit, dt)
    assert record.accelerations.shape == (steps, len(columns))
    np.testing.assert_allclose(np.abs(record.accelerations).max(axis=0) / G, peaks, atol=6e-4)
    assert record.dt == (dt or 0.01)
    assert record.accelerations[-1].any()  # the last line is there
