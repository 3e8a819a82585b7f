"""Several rigs through offline loop, bag and back."""

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from recordings_at_hand import assert_same_samples
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import rigs_of
from seft_ros.bags.recording import Series, of_all_rigs
from seft_ros.bags.recording_bag import read_bag, write_recording
from seft_ros.force_controller.methods import force_control

SHORT = ("ground_motion:synthetic.duration:=1.0", "ground_motion:tail:=0.1")
TWO = "/**:axes:=[west/x, east/x]"


def plan(*overrides):
    return load(*SHORT, *overrides)


def test_one_axis_of_a_rig_with_a_name_has_the_bits_of_the_one_without():
    assert_same_samples(simulated(plan("/**:axes:=[west/x]")), simulated(plan()))


def test_a_bag_gives_back_what_all_rigs_did(tmp_path):
    recording = simulated(plan(TWO))
    write_recording(recording, tmp_path / "bag")
    found = read_bag(tmp_path / "bag")
    assert_same_samples(found, recording)
    assert found.complete
    assert (found.missed, found.overruns, found.trip) == (0, 0, None)
    assert found.experiment.rigs == rigs_of(["west/x", "east/x"])


def test_steps_that_a_rig_lacks_are_nobody_s():
    west = Series(
        np.array([0, 1, 3]), np.arange(3.0)[:, None, None], received_ns=np.array([5, 6, 9])
    )
    east = Series(np.array([1, 2, 3]), -np.ones((3, 1, 1)), received_ns=np.array([7, 8, 8]))
    both = of_all_rigs([west, east], rigs_of(["west/x", "east/x"]))
    assert both.steps.tolist() == [1, 3]
    np.testing.assert_array_equal(both.values[:, 0], [[1.0, -1.0], [2.0, -1.0]])
    assert both.received_ns.tolist() == [7, 9]


def test_a_gain_mixes_no_rigs():
    test = plan(TWO, "force_controller:gain:=[1.0, 0.1, 0.0, 1.0]")
    section = test["force_controller"]
    with pytest.raises(InputError, match="mixes axes of different rigs"):
        force_control(section, test.axes, test.timebase, test.rigs[0])


def test_each_rig_has_the_controller_of_its_axes():
    test = plan(
        TWO,
        "force_controller:per_axis:=true",
        "force_controller:numerator:=[37.0, 74.0]",
        "force_controller:denominator:=[1.0, 17.0, 4000.0, 1.0, 17.0, 4000.0]",
    )
    section, state = test["force_controller"], np.zeros((4, 1))
    west, east = (force_control(section, test.axes, test.timebase, rig) for rig in test.rigs)
    once, twice = (one.step(np.array([1.0]), state) for one in (west, east))
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-12)
