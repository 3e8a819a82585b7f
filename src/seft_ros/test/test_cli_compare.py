"""`seft compare` on bags; of what they may be, see test_bags_record_bag_reader.py."""

import dataclasses
import json

import numpy as np
from recordings_at_hand import noise_recording
from seft_ros.bags.recording import Series
from seft_ros.bags.recording_bag import write_recording


def test_two_bags_are_drawn(seft, tmp_path):
    recording = noise_recording(60)
    write_recording(recording, tmp_path / "one")
    values = recording.series["rig/state"].values.copy()
    values[41, 3, 1] = np.nextafter(values[41, 3, 1], np.inf)
    altered = {**recording.series, "rig/state": Series(np.arange(60), values)}
    write_recording(dataclasses.replace(recording, series=altered), tmp_path / "two")
    status, out, err = seft("compare", "one", "two", "--figure", "tests.png", "--json")
    result = json.loads(out)
    assert (status, err, result["identical"]) == (1, "", False)
    assert [bag["bag"] for bag in result["bags"]] == ["one", "two"]
    assert result["figure"] == "tests.png"
    assert (tmp_path / "tests.png").read_bytes().startswith(b"\x89PNG")
    status, out, _ = seft("compare", "one", "two")
    assert status == 1
    assert "first difference at step 41, rig/state" in out
