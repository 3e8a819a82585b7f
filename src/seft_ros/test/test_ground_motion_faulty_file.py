"""Files that must not read: each fault is reported in one line, with the place."""

import contextlib
import re
from functools import partial

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError
from seft_ros.ground_motion.record_file import read_record

AT2 = "TITLE\nSTATION\nACCELERATION TIME HISTORY IN UNITS OF G\n"


@pytest.fixture
def read(read):
    """Read the first column in g with 0.01 s."""
    return partial(read, columns=[0], unit="g", dt=0.01)


@pytest.mark.parametrize(
    ("content", "place", "what"),
    [
        ("1\n\n2\n% note\n-inf\n4\n", "line 5", "-inf, not a finite number"),
        ("1 2\n3 4\n5\n", "line 3", "1 columns, but 2 before; if it is one motion in rows"),
        ("1,2\n3,4\n5,", "line 3", "the record is cut off there: fetch it again"),
        ("1,2\n3,\n5,6\n", "line 2", "1 columns, but 2 before"),
        ("1,2\n,3\n5,6\n", "line 2", "a field is empty"),
        ("% c\n1 2\n3 abc\n5 6\n", "line 3", '"abc" is no number'),
        ("1 2\n3 1_0\n", "line 2", '"1_0" is no number'),
        ("1\n2\nEnd\n3\n", "line 3", '"End" is no number'),
        ("1 2O\n3 4\n5 6\n", "line 1", '"2O" is no number'),
        ("0,005\n0,010\n", "line 1", "decimal points, not commas"),
        ("t;a\n0;0,5\n1;0,6\n", "line 2", "decimal points, not commas"),
        ('"' + "x," * 70000 + "\n", "", "no line of numbers"),
        ("1\n", "", "one sample"),
        ("", "", "empty"),
        (b"1 2\n3 \xff4\n", "line 2", '"\xff4" is no number'),
        (b"\x50\x4b\x03\x04\n\x00\x01", "line 2", "byte 0x00 is no text"),
        (AT2 + "NPTS= 7, DT= .01\n 1. 2. 3. 4. 5.\n 6.\n", "line 4", "6 values follow: the file"),
        (AT2 + "NPTS= 7, DT= .01 SEC\n", "line 4", "0 values follow: the file is trunc"),
        (AT2 + "3 0.01 NPTS, DT\n 1. 2. 3. 4. 5.\n", "line 4", "5 values follow: too many"),
        (AT2 + "NPTS= 3, DT= .01 SEC\n 1. 2.\n abc\n", "line 6", '"abc" is no number'),
        (AT2 + "NPTS= 3, DT= .01 SEC\n 1. NaN\n 2.\n", "line 5", "nan, not a finite number"),
        (AT2 + "NPTS= 2, DT= 0 SEC\n 1. 2.\n", "line 4", "both must be positive"),
        (AT2 + "NPTS= 2\nDT= .02 SEC\n 1. 2.\n", "line 5", "says 0.02 s"),
        (AT2 + "NPTS= 2, DT= 5 MSEC\n 1. 2.\n", "line 4", "period of 5 s"),
        ("0 1 .1 2\n.2 3 .3 4\n.4 5 .5 6\n", "", "each row holds 2 pairs of time and value"),
    ],
)  # fmt: skip
def test_a_fault_in_a_file_is_reported_with_its_line(refuses, content, place, what):
    assert place in refuses(re.escape(what), content)


def test_a_fault_in_a_column_that_is_not_chosen_does_not_matter(read):
    assert read("1 2\n3 nan\n").accelerations.shape == (2, 1)


@pytest.mark.parametrize(("name", "message"), [("nowhere", "no such file"), ("", "Is a directory")])
def test_a_missing_file_and_a_folder_are_distinguished(tmp_path, name, message):
    with pytest.raises(InputError, match=f"{tmp_path / name}.*{message}"):
        read_record(tmp_path / name, [0], "g", 0.01)


def test_a_column_out_of_range_is_reported_how_many_there_are(refuses):
    refuses(r"column is \[2\], but", "1 2\n3 4\n", columns=[2])
    refuses("2 columns, 0 to 1", "1 2\n3 4\n", columns=[0, 2])
    refuses("2 columns, 0 to 1", "1 2\n3 4\n", columns=[-2])
    refuses("one column, 0", "NPTS= 2, DT= .01 SEC\n 1. 2.\n", columns=[1])


def test_a_file_without_sampling_period_or_unit_asks_for_it(refuses):
    refuses("set ground_motion dt", "1\n2\n", dt=0.0)
    message = r"largest is 2.5; set ground_motion unit \(--unit\) to g, m/s2, cm/s2"
    refuses(message, "1\n-2.5\n", unit="")


@pytest.mark.parametrize("times", ["0\n0.01\n0.01\n0.03", "0.03\n0.02\n0.01\n0", "0\n0\n0\n0"])
def test_times_that_do_not_rise_evenly_are_refused(refuses, times):
    text = "time,a\n" + times.replace("\n", ",1\n") + ",1\n"
    refuses("resample the record evenly", text, columns=[1])


def test_a_time_that_is_no_number_is_reported_with_its_line(refuses):
    refuses("line 3", "time,a\n0,1\nnan,1\n0.02,1\n", columns=[1])


def test_a_nameless_column_of_times_is_not_taken_for_accelerations(read, refuses):
    text = "".join(f"{k * 0.01:.2f} {np.sin(k):.6f}\n" for k in range(50))
    refuses("is the time", text)
    assert read(text, columns=[1], dt=0.0).dt == 0.01
    refuses("dt is 0.02 s, but", text, columns=[1], dt=0.02)
    refuses("line 31: time goes from", text.replace("0.30 ", "0.305 "), columns=[1])
    even = "t,a\n0,1\n1.0,1\n2.009,1\n3.0,1\n4,2\n"  # within 1 % of a step
    assert read(even, columns=[1], dt=0.0).dt == 1.0
    refuses("2.011", even.replace("09", "11"), columns=[1])


def test_a_column_that_counts_the_lines_is_not_taken_for_accelerations(read, refuses):
    text = "".join(f"{k} {np.sin(k):.6f}\n" for k in range(50))
    refuses("rises from line to line in steps of 1", text)
    record = read(text, columns=[-1], unit="m/s2")
    assert record.accelerations[3, 0] == pytest.approx(np.sin(3), 1e-5)


LINES = st.lists(st.text(alphabet="01.-+eE,; \t%nafNPTS=DT", max_size=12), min_size=1, max_size=6)


@settings(max_examples=200)
@given(st.binary(max_size=200) | LINES.map(lambda lines: "\n".join(lines).encode()))
@example(b"1,2\n3,4;5")
@example(b"NPTS= 99999999999999999999, DT= 1e-999\n1")
@example(b"\xef\xbb\xbf%\n")
def test_any_bytes_are_a_record_or_one_line_of_refusal(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("bytes") / "motion.txt"
    path.write_bytes(content)
    with contextlib.suppress(InputError):
        assert np.isfinite(read_record(path, [0], "g", 0.01).accelerations).all()
