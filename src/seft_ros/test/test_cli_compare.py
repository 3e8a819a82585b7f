"""`seft compare` on bags; of what they may be, see test_bags_record_bag_reader.py."""

import dataclasses
import json

import numpy as np
from records_at_hand import noise_record
from seft_ros.bags.record import Series
from seft_ros.bags.record_bag import write_record


def test_two_bags_are_drawn(seft, tmp_path):
    record = noise_record(60)
    write_record(record, tmp_path / "one")
    values = record.series["rig/state"].values.copy()
    values[41, 3, 1] = np.nextafter(values[41, 3, 1], np.inf)
    altered = {**record.series, "rig/state": Series(np.arange(60), values)}
    write_record(dataclasses.replace(record, series=altered), tmp_path / "two")
    status, out, err = seft("compare", "one", "two", "--figure", "tests.png", "--json")
    result = json.loads(out)
    assert (status, err, result["identical"]) == (1, "", False)
    assert [bag["bag"] for bag in result["bags"]] == ["one", "two"]
    assert result["figure"] == "tests.png"
    assert (tmp_path / "tests.png").read_bytes().startswith(b"\x89PNG")
    status, out, _ = seft("compare", "one", "two")
    assert status == 1
    assert "first difference at step 41, rig/state" in out
