"""Histories of a test as a table: what is in each column, and what a lost sample leaves."""

import csv
import dataclasses

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.whole_structure import ReferenceResponse
from seft_ros.analysis.report_numbers import histories
from seft_ros.bags.recording import Recording, Series
from seft_ros.drawing.style import check_table, write_table
from seft_ros.ground_motion.record_file import read_record

COUNT = 20
STEPS = np.arange(COUNT)


def make_recording(axes=("x", "y")):
    """Make a recording whose values tell topic, quantity, axis and step."""

    def series(number, quantities):
        q, n = np.arange(quantities)[:, np.newaxis], np.arange(len(axes))
        values = 100.0 * number + 10 * q + n + STEPS[:, np.newaxis, np.newaxis] / 100
        return Series(STEPS, values)

    names = {"ground_motion": 1, "rig/state": 4, "reference_force": 3, "valve_command": 1}
    common = {"rate": 500.0, "axes": list(axes)}
    parts = {name: series(k, q) for k, (name, q) in enumerate(names.items(), start=1)}
    return Recording(Experiment({"rig": common, "reference_force": common}), parts)


def exact(count):
    names = (field.name for field in dataclasses.fields(ReferenceResponse))
    arrays = {name: np.full((count, 2), float(k)) for k, name in enumerate(names)}
    return ReferenceResponse(**arrays)


def test_each_column_has_its_quantity_axis_and_unit_in_its_name():
    names, table = histories(make_recording(), exact(COUNT))
    columns = dict(zip(names, table.T, strict=True))
    assert len(columns) == len(names) == 1 + 2 * 10
    np.testing.assert_allclose(columns["time (s)"], STEPS * 0.002)
    for name, expected in {
        "x ground acceleration (m/s^2)": 100,
        "y ground acceleration (m/s^2)": 101,
        "y displacement (m)": 201,
        "x velocity (m/s)": 210,
        "x acceleration (m/s^2)": 220,
        "y force (N)": 231,
        "x reference force (N)": 320,  # after the target's motion
        "y valve command (V)": 401,
    }.items():
        np.testing.assert_allclose(columns[name], expected + STEPS / 100)
    assert (columns["x exact displacement (m)"] == 0).all()
    assert (columns["y exact acceleration (m/s^2)"] == 2).all()
    assert (columns["y exact force (N)"] == 3).all()


def test_one_axis_needs_no_name_and_without_a_reference_there_is_no_exact_response():
    names, _ = histories(make_recording(("x",)), None)
    assert names == [
        "time (s)",
        "ground acceleration (m/s^2)",
        *("displacement (m)", "velocity (m/s)", "acceleration (m/s^2)", "force (N)"),
        *("reference force (N)", "valve command (V)"),
    ]


def test_a_lost_sample_leaves_an_empty_field_in_its_row(tmp_path):
    recording = make_recording()
    kept = recording.series["valve_command"].of_steps(np.delete(STEPS, 7))
    recording = dataclasses.replace(recording, series={**recording.series, "valve_command": kept})
    path = tmp_path / "histories.csv"
    names, table = histories(recording, exact(COUNT - 2))
    write_table(path, names, table)
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == COUNT
    assert [k for k, row in enumerate(rows) if row["x valve command (V)"] == ""] == [7]
    assert float(rows[8]["x valve command (V)"]) == 400.08
    missing = [k for k, row in enumerate(rows) if row["x exact force (N)"] == ""]
    assert missing == [COUNT - 2, COUNT - 1]


def test_the_ground_motion_of_a_table_is_read_as_a_record(tmp_path):
    path = tmp_path / "histories.csv"
    wave = np.sin(STEPS)
    series = {"ground_motion": Series(STEPS, wave[:, np.newaxis, np.newaxis])}
    test = make_recording(("x",))
    test = dataclasses.replace(test, series=test.series | series)
    write_table(path, *histories(test, None))
    recording = read_record(path, [-1])
    assert recording.channels[0]["column"] == 'column 1 "ground acceleration (m/s^2)"'
    assert (recording.unit, recording.dt) == ("m/s2", 0.002)
    np.testing.assert_array_equal(recording.accelerations[:, 0], wave)


def test_a_table_that_can_not_be_written_is_refused(tmp_path):
    assert check_table(tmp_path / "a").name == "a.csv"
    with pytest.raises(InputError, match=r"tables end in \.csv"):
        check_table(tmp_path / "a.png")
    with pytest.raises(InputError, match="the table can't be written"):
        write_table(tmp_path, ["a"], np.zeros((1, 1)))
