"""Whatever a bag's files hold, reading and recovering it raise nothing but the project's errors."""

import contextlib
import shutil

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import SeftError
from seft_msgs_py.wire.messages import encode_diagnostics, encode_string
from seft_msgs_py.wire.outcome import Outcome, rig_status
from seft_msgs_py.wire.topics import DESCRIPTION, DIAGNOSTICS, RIG_STATE
from seft_msgs_py.wire.trajectory import TrajectoryCodec
from seft_ros.bags.bag_files import recover
from seft_ros.bags.bag_writer import BagWriter
from seft_ros.bags.record import read_description, write_description
from seft_ros.bags.record_bag import read_bag
from seft_ros.test_run.parameter_tables import TABLES

EXPERIMENT = Experiment.load(TABLES, ["config/jhu.yaml"], [])
EXAMPLES = 15
few = settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck))


# rosbags leaves files open where what it opens is no bag
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.fixture(scope="module", params=["mcap", "sqlite3"])
def whole(request, tmp_path_factory):
    """A small bag."""
    path = tmp_path_factory.mktemp("whole") / "bag"
    codec = TrajectoryCodec(RIG_STATE, EXPERIMENT.axes, EXPERIMENT.timebase)
    with BagWriter(path, request.param) as bag:
        for text in write_description(EXPERIMENT.sections, {}):
            bag.write(DESCRIPTION, encode_string(text), 1)
        for step in range(5):
            bag.write(RIG_STATE, codec.encode(step, np.ones((4, 1))), 2 + step)
        status = rig_status(Outcome("finished", 5, 0, [], 1.0))
        bag.write(DIAGNOSTICS, encode_diagnostics(0, [status]), 9)
    return path


def damage(data, file):
    raw = bytearray(file.read_bytes())
    spots = st.integers(0, len(raw) - 1)
    for at in data.draw(st.lists(spots, min_size=1, max_size=8), "changed"):
        raw[at] = data.draw(st.integers(0, 255), "byte")
    end = data.draw(st.just(len(raw)) | spots, "end")
    file.write_bytes(bytes(raw[:end]))


@few
@given(data=st.data())
def test_damaged_bags(whole, tmp_path_factory, data):
    path = tmp_path_factory.mktemp("bags") / "bag"
    shutil.copytree(whole, path)
    damage(data, data.draw(st.sampled_from(sorted(path.iterdir())), "file"))
    for use in (read_bag, recover, read_bag):
        with contextlib.suppress(SeftError):
            use(path)
    shutil.rmtree(path)


@few
@given(data=st.data())
def test_damaged_metadata(whole, tmp_path_factory, data):
    path = tmp_path_factory.mktemp("bags") / "bag"
    shutil.copytree(whole, path)
    file = path / "metadata.yaml"
    lines = file.read_text().splitlines()
    at = data.draw(st.integers(0, len(lines) - 1), "line")
    key = lines[at].split(":")[0]
    lines[at] = data.draw(
        st.sampled_from(["", f"{key}: -1", f"{key}: []", f"{key}: x", f"{key}: {{}}", f"{key}:"]),
        "instead",
    )
    file.write_text("\n".join(lines))
    for use in (read_bag, recover):
        with contextlib.suppress(SeftError):
            use(path)
    shutil.rmtree(path)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=8,
)


@few
@given(
    section=st.dictionaries(st.sampled_from(["rate", "axes", "pace", "x"]), JSON),
    texts=st.lists(st.text(max_size=20), max_size=3),
)
def test_descriptions(section, texts):
    described = write_description(EXPERIMENT.sections, {})
    with contextlib.suppress(ValueError):  # of numbers that are none
        described += write_description({"rig": {**EXPERIMENT["rig"], **section}}, {})
    with contextlib.suppress(SeftError):
        read_description([*described, *texts])[0].experiment()
