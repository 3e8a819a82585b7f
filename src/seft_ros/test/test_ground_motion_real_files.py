"""Real records, where they stand beside the project; see the README there for the numbers."""

from pathlib import Path

import numpy as np
import pytest
from seft_ros.ground_motion.record_file import read_record

DATA = Path(__file__).parents[3].parent / "shared" / "data"
G = 9.80665

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
