"""Whatever a parameter file or a command line holds, errors are the project's own."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import (
    Experiment,
    parse_override,
    read_parameter_file,
    split_ros_arguments,
)
from seft_msgs_py.config.parameter_table import Parameter, Table
from seft_msgs_py.errors import InputError

TABLE = Table(
    "rig",
    [
        Parameter("mass", "floats", 1.0, "", positive=True),
        Parameter("kind", "string", "a", "", choices=("a", "b")),
        Parameter("count", "int", 0, ""),
        Parameter("names", "strings", ["x"], ""),
        Parameter("on", "bool", True, ""),
    ],
)
GOOD = """/**:
  ros__parameters:
    rate: 500.0
    axes: [x]
rig:
  ros__parameters:
    mass: [1.0, 2.0]
    kind: b
    count: 3
    "on": true
"""
few = settings(max_examples=80, suppress_health_check=list(HealthCheck))
PIECES = st.sampled_from(
    [
        *GOOD.split(),
        "&a",
        "*a",
        "!!python/object",
        "!t",
        "<<:",
        "- ",
        "? ",
        "|",
        ">",
        "\t",
        "\x00",
        ": ",
        "{",
        "}",
        "[",
        "]",
        "'",
        '"',
        "#",
        "---",
        "...",
        ".inf",
        ".nan",
        "1e999",
        "0x",
        "2001-01-01",
        "~",
        "9" * 400,
        "%YAML 9.9",
        "\u2028",
        "\ud800".encode("utf-16", "surrogatepass").decode("latin-1"),
    ]
)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("parameters") / "file.yaml"


def load(file, raw):
    file.write_bytes(raw)
    for read in (read_parameter_file, lambda path: Experiment.load([TABLE], [path])):
        try:
            read(file)
        except InputError as error:
            assert "\n" not in str(error)


@few
@given(raw=st.binary(max_size=80))
def test_random_bytes(file, raw):
    load(file, raw)


@few
@given(data=st.data())
def test_damaged_files(file, data):
    raw = bytearray(GOOD.encode())
    for at in data.draw(st.lists(st.integers(0, len(raw) - 1), min_size=1, max_size=5)):
        raw[at] = data.draw(st.integers(0, 255))
    load(file, bytes(raw[: data.draw(st.integers(0, len(raw)) | st.just(len(raw)))]))


@few
@given(pieces=st.lists(PIECES, max_size=12), between=st.sampled_from([" ", "\n", "\n  ", ""]))
def test_pieces_of_yaml(file, pieces, between):
    load(file, between.join(pieces).encode(errors="surrogatepass"))


@few
@given(
    text=st.text(max_size=30)
    | st.lists(PIECES, max_size=5).map("".join).map("rig:mass:={}".format)
    | st.text(max_size=12).map("rig:count:={}".format)
)
def test_overrides(text):
    try:
        Experiment.load([TABLE], [], [parse_override(text)])
    except InputError as error:
        assert "\n" not in str(error)


WORDS = st.sampled_from(
    [
        "--ros-args",
        "--",
        "-p",
        "--param",
        "-r",
        "__node:=x",
        "--params-file",
        "rig:mass:=1",
        "--log-level",
    ]
)


@few
@given(words=st.lists(WORDS | st.text(max_size=8), max_size=8))
def test_ros_arguments(words):
    try:
        split_ros_arguments(["program", *words])
    except InputError as error:
        assert "\n" not in str(error)
