import contextlib
import json
import os
import subprocess
import sys
import threading

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import (
    EVERY_NODE,
    Experiment,
    parameter_text,
    parse_override,
    read_parameter_file,
    split_ros_arguments,
    write_parameter_file,
)
from seft_msgs_py.config.parameter_table import Parameter, Table
from seft_msgs_py.errors import InputError

RIG = Table(
    "rig",
    [
        Parameter("seed", "int", 0, "a seed", minimum=0),
        Parameter("specimen.mass", "floats", None, "mass of it", "kg", positive=True),
        Parameter("limits.force", "float", 9.0, "", default_from="supervisor:limits.force"),
    ],
)
FORCE = Table(
    "reference_force",
    [
        Parameter("mass_ratio", "float", 0.0, "alpha", minimum=0.0),
        Parameter("model.mass", "floats", None, "m", "kg", default_from="rig:specimen.mass"),
        Parameter("method", "string", "seft", "", choices=("eft", "seft")),
        Parameter("seed", "int", 0, "another seed"),
    ],
)
TABLES = (RIG, FORCE)
RIG_HAS_MASS = "rig: {ros__parameters: {specimen: {mass: 52.7}}}\n"


@pytest.fixture
def load(tmp_path):
    """Load an experiment of the text of parameter files, and overrides."""

    def load_texts(*texts, overrides=(), tables=TABLES):
        paths = [tmp_path / f"{index}.yaml" for index in range(len(texts))]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return Experiment.load(tables, paths, [parse_override(text) for text in overrides])

    return load_texts


def refusal(load, *texts, **rest):
    with pytest.raises(InputError) as caught:
        load(*texts, **rest)
    return str(caught.value)


def in_rig(*lines):
    return "rig:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in lines)


def test_a_file_of_the_usual_form_is_read(load):
    experiment = load(
        "/**:\n  ros__parameters:\n    rate: 1000\n    axes: [east, north]\n"
        + in_rig("seed: 3", "specimen:", "  mass: [1, 2.5]")
        + "/reference_force:\n  ros__parameters: {mass_ratio: 1}\n"
    )
    assert experiment.timebase.period_ns == 1_000_000
    assert experiment.axes == ("east", "north")
    assert experiment["rig"] == {
        "rate": 1000.0,
        "axes": ["east", "north"],
        "seed": 3,
        "specimen.mass": [1.0, 2.5],
        "limits.force": 9.0,
    }
    assert experiment["reference_force"]["mass_ratio"] == 1.0
    assert isinstance(experiment["reference_force"]["mass_ratio"], float)


@pytest.mark.parametrize("text", ["2.11e5", "2.11E+5", "211000", "+211000.0", "2.11e+05"])
def test_numbers_are_numbers_however_they_are_written(load, text):
    experiment = load(in_rig(f"specimen.mass: {text}"))
    assert experiment["rig"]["specimen.mass"] == 211000.0
    assert isinstance(experiment["rig"]["specimen.mass"], float)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (in_rig("specimen.mas: 1"), "rig: there is no parameter specimen.mas; did you mean specim"),
        (RIG_HAS_MASS + "/**: {ros__parameters: {sede: 1}}", "no parameter sede; did you mean see"),
        ("rigg: {ros__parameters: {}}", "there is no node rigg; did you mean rig?"),
        (in_rig("seed: x"), 'rig: seed is "x", but must be a whole number'),
        (in_rig("seed:"), "rig seed has no value"),
        (in_rig("specimen.mass: 2024-01-01"), "must be a number"),
        (in_rig("specimen: 3"), "there is no parameter specimen"),
        (RIG_HAS_MASS + "/**: {ros__parameters: {rate: 333}}", "usable rates are 320 and 400 Hz"),
        (RIG_HAS_MASS + "/**: {ros__parameters: {axes: [x, x]}}", "names must differ"),
        (RIG_HAS_MASS + f"/**: {{ros__parameters: {{axes: {[*'ab' * 500]}}}}}", "at most 100"),
        (RIG_HAS_MASS + '/**: {ros__parameters: {axes: [""]}}', "names must differ"),
        (RIG_HAS_MASS + '/**: {ros__parameters: {axes: ["a\\nb"]}}', "must be printable"),
        (RIG_HAS_MASS + '/**: {ros__parameters: {axes: ["\\ud800"]}}', ""),
        ("", "holds no node names"),
        ("[rig]", "holds no node names"),
        ("rig: {seed: 1}", "under rig there must be ros__parameters, and only that"),
        ("rig: {ros__parameters: 3}", "must hold names and values"),
        ("rig:\n  ros__parameters:\n\tseed: 1", "line 3 "),
        ("rig:\n  ros__parameters: {seed: 1", "line 2 "),
        ("rig: {ros__parameters: {}}\nrig: {ros__parameters: {}}", "line 2 found duplicate key"),
        (in_rig("seed: !!python/name:os.system x"), "line 3 could not determine a constructor"),
        (in_rig("seed: *other"), "undefined alias"),
        ("rig: {ros__parameters: &a {b: *a}}", "nested too deep"),
        ("[" * 600 + "]" * 600, "nested too deep"),
        (in_rig("seed: &a [*a]"), "must be a whole number"),
        ("a: " + "[" * 600, "nested too deep"),
        ("rig: {ros__parameters: {}}", "rig: specimen.mass must be given (mass of it, kg)"),
    ],
)
def test_what_makes_no_experiment_is_refused_in_one_line(load, tmp_path, text, told):
    message = refusal(load, text)
    assert told in message


@pytest.mark.parametrize("text", [in_rig("sede: 1"), in_rig("seed: x"), "rigg: {}", "rig: ["])
def test_the_file_at_fault_is_named(load, tmp_path, text):
    assert refusal(load, RIG_HAS_MASS, text).startswith(f"{tmp_path / '1.yaml'}:")


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x01")
    for path, told in (
        (tmp_path / "none.yaml", "No such file"),
        (tmp_path, "Is a directory"),
        (binary, "not a text file"),
    ):
        with pytest.raises(InputError, match=told) as caught:
            read_parameter_file(path)
        assert str(caught.value).startswith(f"{path}:")


def wildcard(text):
    return f"/**: {{ros__parameters: {{{text}}}}}\n"


def test_a_file_that_is_too_large_is_refused_without_a_look_into_it(tmp_path, monkeypatch):
    monkeypatch.setattr("seft_msgs_py.config.experiment._parse_yaml", None)
    path = tmp_path / "large.yaml"
    path.write_text("#" * 1_000_001)
    with pytest.raises(InputError, match=rf"^{path}: is larger than 1 MB"):
        read_parameter_file(path)


@pytest.mark.parametrize("wildcard_first", [True, False])
def test_within_a_file_the_node_itself_wins_over_every_node(load, wildcard_first):
    parts = [wildcard("seed: 4"), in_rig("seed: 5", "specimen.mass: 1")]
    experiment = load("".join(parts if wildcard_first else parts[::-1]))
    assert (experiment["rig"]["seed"], experiment["reference_force"]["seed"]) == (5, 4)


def test_later_files_win_and_overrides_win_over_files(load):
    first, second = in_rig("seed: 1", "specimen.mass: 1"), in_rig("seed: 2")
    assert load(first, second)["rig"]["seed"] == 2
    assert load(second, first)["rig"]["seed"] == 1
    overridden = load(first, second, overrides=["rig:seed:=3"])
    assert overridden["rig"]["seed"] == 3
    assert overridden["rig"]["specimen.mass"] == 1.0
    assert load(first, overrides=["rig:seed:=3", "rig:seed:=4"])["rig"]["seed"] == 4
    assert load(first, overrides=["seed:=6"])["rig"]["seed"] == 6


def test_an_override_without_its_value_is_refused(load):
    told = refusal(load, RIG_HAS_MASS, overrides=["reference_force:mass_ratio:="])
    assert "mass_ratio is empty, but must be a number" in told


def test_a_node_takes_values_from_nodes_it_has_no_table_of(load):
    text = RIG_HAS_MASS + "supervisor: {ros__parameters: {limits: {force: 7}, foreign: 1}}\n"
    assert load(text, tables=[RIG])["rig"]["limits.force"] == 7.0
    assert load(text, tables=[FORCE])["reference_force"]["model.mass"] == 52.7


@pytest.mark.parametrize("name", ["rate: 1000", "axes: [y]"])
def test_nodes_that_differ_in_rate_or_axes_are_refused(load, name):
    text = RIG_HAS_MASS + f"reference_force: {{ros__parameters: {{{name}}}}}\n"
    assert "set it once, under /**" in refusal(load, text)


@pytest.mark.parametrize("node", ["rig", "reference_force"])
def test_a_rate_under_a_node_is_not_lost_to_that_under_every_node(load, node):
    own = f"{node}: {{ros__parameters: {{rate: 1000}}}}\n"
    text = wildcard("rate: 500, specimen: {mass: 1}") + own
    assert "1000.0" in refusal(load, text)
    assert load(text, tables=[RIG])["rig"]["rate"] == (1000.0 if node == "rig" else 500.0)


NAMES = st.lists(
    st.sampled_from(["x", "y", "n", "on", "1", "1e5", "null", "größe", "a b", "~", "- x", "#"]),
    min_size=1,
    max_size=3,
    unique=True,
)
NUMBERS = st.floats(1e-300, 1e300)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(NAMES, NUMBERS, st.lists(NUMBERS, min_size=1, max_size=4), st.integers(0, 2**63 - 1))
def test_what_is_written_is_read_back_with_values_and_types(load, axes, ratio, mass, seed):
    given_values = {
        "rig": {"axes": axes, "specimen.mass": mass, "seed": seed},
        "reference_force": {"axes": axes, "mass_ratio": ratio},
    }
    sections = {
        node: {row.name: row.default for row in table.rows.values()} | given_values[node]
        for node, table in (("rig", RIG), ("reference_force", FORCE))
    }
    sections["reference_force"]["model.mass"] = mass
    experiment = Experiment(sections)
    _, overrides, _ = split_ros_arguments(["--ros-args", *experiment.arguments()])
    for again in (load(parameter_text(sections)), Experiment.load([RIG, FORCE], (), overrides)):
        assert again.sections == experiment.sections
        assert repr(again.sections) == repr(experiment.sections)


def test_an_experiment_hands_on_the_files_and_overrides_that_it_was_read_from(tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(parameter_text({"rig": {"axes": ["x"], "specimen.mass": 2.0}}))
    given = [parse_override("rig:seed:=7")]
    experiment = Experiment.load([RIG], [file], given).changed({"rig": {"seed": 8}})
    words = ["--params-file", str(file), "-p", "rig:seed:=7", "-p", "rig:seed:=8"]
    assert experiment.arguments() == words
    assert experiment["rig"]["seed"] == 8


def test_what_was_read_from_a_pipe_is_handed_on_by_value(tmp_path):
    text = parameter_text({"rig": {"axes": ["x"], "specimen.mass": 2.0}})
    os.mkfifo(pipe := tmp_path / "pipe")
    writer = threading.Thread(target=pipe.write_text, args=[text])
    writer.start()
    experiment = Experiment.load([RIG], [pipe])
    writer.join()
    assert "--params-file" not in experiment.arguments()
    assert "rig:specimen.mass:=2.0" in experiment.arguments()


def test_a_node_checks_its_own_section_and_leaves_the_others_to_their_nodes(tmp_path):
    file = tmp_path / "both.yaml"
    file.write_text(parameter_text({"rig": {"of_a_lab": 1.0}, "reference_force": {"axes": ["x"]}}))
    Experiment.load([RIG, FORCE], [file], [parse_override("rig:specimen.mass:=2.0")], [FORCE.node])
    with pytest.raises(InputError, match="no parameter of_a_lab"):
        Experiment.load([RIG, FORCE], [file], nodes=[RIG.node])


ASK_RCL = """
import json, sys, rclpy
from rclpy.node import Node
rclpy.init(args=["--ros-args", "--params-file", sys.argv[1]])
sections = {}
for name in ("rig", "reference_force"):
    node = Node(
        name,
        automatically_declare_parameters_from_overrides=True,
        start_parameter_services=False,
        enable_rosout=False,
    )
    found = {n: p.value for n, p in node.get_parameters_by_prefix("").items()}
    sections[name] = {n: v if isinstance(v, (str, int, float)) else list(v)
                      for n, v in found.items()}
print(json.dumps(sections))
"""


def test_a_file_is_written_anew_only_where_that_is_asked_for(tmp_path):
    path, sections = tmp_path / "link.yaml", {"reference_force": {"loop_delay": 3}}
    write_parameter_file(path, sections, ["by a test"])
    assert path.read_text().startswith("# by a test\nreference_force:")
    with pytest.raises(InputError, match="exists already"):
        write_parameter_file(path, {})
    sections["reference_force"]["loop_delay"] = 4
    write_parameter_file(path, sections, replace=True)
    assert read_parameter_file(path) == sections
    with pytest.raises(InputError, match="is a folder"):
        write_parameter_file(tmp_path, sections, replace=True)


def test_what_is_written_is_read_by_ros_itself(load, tmp_path):
    pytest.importorskip("rclpy")
    experiment = load(
        wildcard('axes: [x, "y", "on", "12"]') + in_rig("specimen.mass: [5.0e-6, 1.0e+22, 3, 4]")
    )
    path = tmp_path / "written.yaml"
    path.write_text(parameter_text(experiment.sections))
    done = subprocess.run(
        [sys.executable, "-c", ASK_RCL, str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    read = json.loads(done.stdout)
    for node, section in experiment.sections.items():
        assert {name: read[node][name] for name in section} == section
    assert isinstance(read["rig"]["rate"], float)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("rig:seed:=3", ("rig", "seed", 3)),
        ("/rig:seed:=3", ("rig", "seed", 3)),
        ("rate:=500", (EVERY_NODE, "rate", 500)),
        ("/**:rate:=500.0", (EVERY_NODE, "rate", 500.0)),
        ("rig:specimen.mass:=2.11e5", ("rig", "specimen.mass", 211000.0)),
        ("rig:specimen.mass:=[1.0, 2.0]", ("rig", "specimen.mass", [1.0, 2.0])),
        ("recorder:name:=a:=b:c", ("recorder", "name", "a:=b:c")),
        ("recorder:name:=", ("recorder", "name", None)),
        ("recorder:name:=''", ("recorder", "name", "")),
        ('axes:=["x", y]', (EVERY_NODE, "axes", ["x", "y"])),
        ("ground_motion:file:=/a b/kobe.txt", ("ground_motion", "file", "/a b/kobe.txt")),
    ],
)
def test_an_override_is_node_parameter_value(text, expected):
    assert parse_override(text) == expected


@pytest.mark.parametrize(
    "text", ["", "rig", "rig:seed", "rig:seed=3", ":=3", ":seed:=3", "rig::=3"]
)
def test_an_override_of_another_form_is_refused(text):
    with pytest.raises(InputError, match="expected node:parameter:=value"):
        parse_override(text)


def test_an_override_for_an_unknown_node_names_the_nearest():
    with pytest.raises(InputError, match=r"there is no node force_control; did you mean force_con"):
        parse_override("force_control:voltage_limit:=3")


@pytest.mark.parametrize(
    ("argv", "files", "overrides"),
    [
        (["node", "--params-file", "no"], [], []),
        (["--ros-args", "--params-file", "a", "--params-file", "b"], ["a", "b"], []),
        (["--ros-args", "-p", "rig:seed:=1"], [], [("rig", "seed", 1)]),
        (["--ros-args", "--param", "rate:=100"], [], [(EVERY_NODE, "rate", 100)]),
        (["--ros-args", "-r", "__ns:=/lab", "-p", "rate:=1"], [], [(EVERY_NODE, "rate", 1)]),
        (["--ros-args", "--", "-p", "rate:=1"], [], []),
        (["--ros-args", "--", "x", "--ros-args", "-p", "rate:=1"], [], [(EVERY_NODE, "rate", 1)]),
    ],
)
def test_parameters_are_found_among_the_ros_arguments(argv, files, overrides):
    assert split_ros_arguments(argv)[:2] == (files, overrides)


@pytest.mark.parametrize("option", ["-p", "--param", "--params-file"])
def test_a_ros_option_without_its_value_is_refused(option):
    with pytest.raises(InputError, match=f"{option} needs a value"):
        split_ros_arguments(["node", "--ros-args", option])


YAML_WORDS = r"rig /** ros__parameters seed 1 1_ 0x_ 1e5 .nan 2001-01-01 \ud800 { } [ ] ... ~ = ' é"
YAML_MARKS = (
    ': |:\n  |\n|- |, |? |&a |*a|<<: *a|!!int |!!float |!!bool |!!timestamp |!!set |!x |"|\t'
)
YAML_RARE = ["# ", "%YAML 1.1\n", "--- ", "| ", "> ", "\x00", "\ufeff", "\x85"]
YAML_PIECES = st.sampled_from([*YAML_WORDS.split(), *YAML_MARKS.split("|"), *YAML_RARE])


@pytest.mark.filterwarnings("ignore::ruamel.yaml.error.YAMLWarning")
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
@given(st.lists(YAML_PIECES, max_size=15).map("".join) | st.text(max_size=60))
@example("? - a\n: b")
@example("!!float _")
@example("!!timestamp rig\n\nrig")
@example("rig\x85\x85rig: ")
def test_any_text_is_read_or_refused_with_an_input_error(tmp_path, text):
    path = tmp_path / "any.yaml"
    path.write_bytes(text.encode(errors="surrogatepass"))
    with contextlib.suppress(InputError):
        sections = read_parameter_file(path)
        assert all(isinstance(name, str) for section in sections.values() for name in section)
        Experiment.load(TABLES, [path])
    with contextlib.suppress(InputError):
        parse_override(f"rig:seed:={text}")
    with contextlib.suppress(InputError):
        split_ros_arguments(["node", "--ros-args", *text.split()])
