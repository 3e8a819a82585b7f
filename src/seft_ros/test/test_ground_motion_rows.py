"""One motion in rows of several numbers: read as one, or refused, never as a column of it."""

from functools import partial

import numpy as np
import pytest
from recordings_at_hand import fixed

MOTION = np.round(np.exp(-np.arange(118) / 40) * np.sin(0.3 * np.arange(118)), 5)


def in_rows(values, width=5):
    """Write values in rows."""
    return fixed(values, 10, 5, width)


@pytest.fixture
def read(read):
    """Read a text in g with 0.02 s."""
    return partial(read, unit="g", dt=0.02)


def layout(record):
    return record.channels[0]["layout"]


@pytest.mark.parametrize("width", [2, 3, 5, 8])
def test_columns_without_names_and_time_are_no_motion_until_asked(read, refuses, width):
    count = 118 // width * width
    text = in_rows(MOTION[:count], width)
    refuses(f"has {width} columns, and no time.*--column.*--rows", text)
    record = read(text, rows=True)
    np.testing.assert_allclose(record.accelerations[:, 0], MOTION[:count] * 9.80665)
    assert layout(record) == "one motion in rows"
    record = read(text, columns=[1])
    np.testing.assert_allclose(record.accelerations[:, 0], MOTION[1:count:width] * 9.80665)
    assert layout(record) == "columns"


@pytest.mark.parametrize("width", [4, 5, 8])
def test_a_shorter_last_row_belongs_to_a_motion_in_rows(read, width):
    count = 118 if 118 % width else 117
    record = read(in_rows(MOTION[:count], width))
    np.testing.assert_allclose(record.accelerations[:, 0], MOTION[:count] * 9.80665)
    assert layout(record) == "one motion in rows"


@pytest.mark.parametrize("copies", [0.0, 1.0])
def test_channels_that_are_cut_off_in_their_last_row_are_no_motion_in_rows(refuses, copies):
    others = np.random.default_rng(3).normal(size=(20, 5))
    table = copies * MOTION[:20, np.newaxis] + (1 - copies) * others
    text = in_rows(np.ravel(table)[:-2])
    refuses("line 20: 3 columns, but 5 before; if it is one motion", text)


@pytest.mark.parametrize(
    "header",
    [
        "118 points at equal spacing of 0.02 sec, 5 points in a row\n",
        "118 points at equal spacing of 0.02 sec\n(8F10.5, i.e., 5 points across in a row)\n",
        "NO. OF POINTS:  118  EQUALLY SPACED INTERVALS OF:  0.02  SEC\n\n",
        "% number of points = 118\n",
        "Points: none\nNDATA: 118\n",
        "118 0.02\n",
        "118\n0.02\n",
    ],
)
def test_the_number_of_points_in_the_header_tells_rows(read, refuses, header):
    record = read(header + in_rows(MOTION))
    np.testing.assert_allclose(record.accelerations[:, 0], MOTION * 9.80665)
    assert layout(record) == "one motion in rows"
    refuses("one column, 0", header + in_rows(MOTION), columns=[1])


def test_the_number_of_points_in_the_header_tells_columns(read, refuses):
    text = "NUMBER OF DATA: 20\n" + in_rows(MOTION[:60], 3)
    refuses("has 3 columns", text)
    assert layout(read(text, columns=[2])) == "columns"
    refuses(r"rows is true, but .* 20 points, one in each row", text, rows=True)


@pytest.mark.parametrize("rows", [False, True])
def test_a_number_of_points_that_does_not_fit_is_refused(refuses, rows):
    text = "NPOINTS = 119\n" + in_rows(MOTION)
    refuses("states 119 points, but 118 values follow in 24 rows", text, rows=rows)


def test_a_time_in_the_first_column_is_no_motion_in_rows(read, refuses):
    text = "".join(f"{0.02 * k:.2f} {value:.5f}\n" for k, value in enumerate(MOTION))
    assert layout(read(text)) == "columns"
    refuses(r"column 0 rises from line to line in steps of 0.02", text, rows=True)


def test_rows_of_any_length_are_one_motion_where_asked(read, refuses):
    lines = [MOTION[:3], MOTION[3:10], MOTION[10:11], MOTION[11:40]]
    text = "".join(in_rows(part, 40) for part in lines)
    record = read(text, rows=True)
    np.testing.assert_allclose(record.accelerations[:, 0], MOTION[:40] * 9.80665)
    refuses("line 2: 7 columns, but 3 before", text)


def test_one_long_row_asks_whether_it_is_a_motion(read, refuses):
    refuses("one row of 118 numbers; if they are one motion", in_rows(MOTION, 118))
    assert len(read(in_rows(MOTION, 118), rows=True).accelerations) == 118


def test_a_file_with_the_name_of_peer_but_no_header_reads_as_rows_where_asked(read, refuses):
    refuses(r"no header line gives NPTS and DT, .*--rows", in_rows(MOTION), name="a.AT2")
    assert len(read(in_rows(MOTION), name="a.AT2", rows=True).accelerations) == 118


@pytest.mark.parametrize("mark", ["*** End of data", "/&  -----", "END", "\n# end\n---"])
def test_an_end_mark_is_no_value(read, mark):
    assert len(read(in_rows(MOTION, 1) + mark + "\n").accelerations) == 118
    assert len(read(in_rows(MOTION) + mark + "\n", rows=True).accelerations) == 118
