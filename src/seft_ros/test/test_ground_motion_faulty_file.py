"""Files that must not read: each fault is told in one line, with the place."""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from seft_msgs_py.errors import InputError
from seft_ros.ground_motion.record_file import read_record

AT2 = "TITLE\nSTATION\nACCELERATION TIME HISTORY IN UNITS OF G\n"


def refusal(path: Path, columns=(0,), unit="g", dt=0.01) -> str:
    with pytest.raises(InputError) as caught:
        read_record(path, list(columns), unit, dt)
    text = str(caught.value)
    assert str(path) in text
    return text


def write(folder: Path, content: str | bytes) -> Path:
    path = folder / "motion.txt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    ("content", "place", "what"),
    [
        ("1 2\n3 nan\n", "", ""),  # column 1 is not chosen
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
def test_a_fault_in_a_file_is_told_with_its_line(tmp_path, content, place, what):
    path = write(tmp_path, content)
    if not what:
        assert read_record(path, [0], "g", 0.01).accelerations.shape == (2, 1)
        return
    text = refusal(path)
    assert what in text
    assert place in text


def test_a_missing_file_and_a_folder_are_told_apart(tmp_path):
    assert "no such file" in refusal(tmp_path / "nowhere.at2")
    assert "Is a directory" in refusal(tmp_path)


def test_an_at2_name_without_a_header_is_refused(tmp_path):
    path = tmp_path / "plain.AT2"
    path.write_text("1.0\n2.0\n")
    assert "no header line gives NPTS" in refusal(path)


def test_a_column_out_of_range_is_told_how_many_there_are(tmp_path):
    path = write(tmp_path, "1 2\n3 4\n")
    assert "column is [2], but" in refusal(path, [2])
    assert "2 columns, 0 to 1" in refusal(path, [0, 2])
    assert "2 columns, 0 to 1" in refusal(path, [-2])
    path = write(tmp_path, "NPTS= 2, DT= .01 SEC\n 1. 2.\n")
    assert "one column, 0" in refusal(path, [1])


def test_a_file_without_sampling_period_asks_for_dt(tmp_path):
    path = write(tmp_path, "1\n2\n")
    assert "set ground_motion dt" in refusal(path, dt=0.0)


def test_a_file_that_does_not_say_its_unit_asks_for_it(tmp_path):
    path = write(tmp_path, "1\n-2.5\n")
    told = refusal(path, unit="")
    assert "largest is 2.5; set ground_motion unit (--unit) to g, m/s2, cm/s2" in told


@pytest.mark.parametrize("times", ["0\n0.01\n0.01\n0.03", "0.03\n0.02\n0.01\n0", "0\n0\n0\n0"])
def test_times_that_do_not_rise_evenly_are_refused(tmp_path, times):
    path = write(tmp_path, "time,a\n" + times.replace("\n", ",1\n") + ",1\n")
    assert "resample the record evenly" in refusal(path, [1])


def test_a_time_that_is_no_number_is_told_with_its_line(tmp_path):
    assert "line 3" in refusal(write(tmp_path, "time,a\n0,1\nnan,1\n0.02,1\n"), [1])


def test_a_nameless_column_of_times_is_not_taken_for_accelerations(tmp_path):
    path = write(tmp_path, "".join(f"{k * 0.01:.2f} {np.sin(k):.6f}\n" for k in range(50)))
    assert "is the time" in refusal(path, [0])
    assert read_record(path, [1], "g").dt == 0.01
    assert "dt is 0.02 s, but" in refusal(path, [1], dt=0.02)
    uneven = path.read_text().replace("0.30 ", "0.305 ")
    assert "line 31: time goes from" in refusal(write(tmp_path, uneven), [1])
    even = write(tmp_path, "t,a\n0,1\n1.0,1\n2.009,1\n3.0,1\n4,2\n")  # within 1 % of a step
    assert read_record(even, [1], "g").dt == 1.0
    assert "2.011" in refusal(write(tmp_path, even.read_text().replace("09", "11")), [1])


def test_a_column_that_counts_the_lines_is_not_taken_for_accelerations(tmp_path):
    path = write(tmp_path, "".join(f"{k} {np.sin(k):.6f}\n" for k in range(50)))
    assert "rises from line to line in steps of 1" in refusal(path, [0])
    assert read_record(path, [-1], "m/s2", 0.01).accelerations[3, 0] == pytest.approx(
        np.sin(3), 1e-5
    )


LINES = st.lists(st.text(alphabet="01.-+eE,; \t%nafNPTS=DT", max_size=12), min_size=1, max_size=6)


@settings(max_examples=200)
@given(st.binary(max_size=200) | LINES.map(lambda lines: "\n".join(lines).encode()))
@example(b"1,2\n3,4;5")
@example(b"NPTS= 99999999999999999999, DT= 1e-999\n1")
@example(b"\xef\xbb\xbf%\n")
def test_any_bytes_are_a_record_or_one_line_of_refusal(tmp_path_factory, content):
    path = write(tmp_path_factory.mktemp("bytes"), content)
    with contextlib.suppress(InputError):
        assert np.isfinite(read_record(path, [0], "g", 0.01).accelerations).all()
