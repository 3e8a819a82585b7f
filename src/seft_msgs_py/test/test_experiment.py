import contextlib
import json
import subprocess
import sys

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from seft_msgs_py.config.experiment import (
    Experiment,
    parameter_text,
    parse_override,
    read_parameter_file,
    split_ros_arguments,
    write_parameter_file,
)
from seft_msgs_py.config.facts import EVERY_NODE, facts, place_of
from seft_msgs_py.config.parameter_table import Parameter, Table
from seft_msgs_py.errors import InputError

RIG = Table(
    "rig",
    [
        *facts("specimen.mass", "limits.force"),
        Parameter("seed", "int", 0, "a seed", minimum=0),
        Parameter("safe.close_time", "float", 0.02, "a time", "s"),
        Parameter("simulated.specimen.mass", "floats", None, "true mass", "kg"),
        Parameter("simulated.specimen.damping", "floats", 3.0, "true damping"),
    ],
)
FORCE = Table(
    "reference_force",
    [
        *facts("specimen.mass"),
        Parameter("mass_ratio", "float", 0.0, "alpha", minimum=0.0),
        Parameter("safe.close_time", "float", 0.02, "a time", "s"),
        Parameter("method", "string", "seft", "", choices=("eft", "seft")),
        Parameter("seed", "int", 0, "another seed"),
    ],
)
TABLES = (RIG, FORCE)


def everywhere(text):
    return f"/**: {{ros__parameters: {{{text}}}}}\n"


HAS_MASS = everywhere("specimen.mass: 52.7")


@pytest.fixture
def load(tmp_path):
    """Load an experiment of the text of parameter files, and overrides."""

    def load_texts(*texts, overrides=(), tables=TABLES):
        paths = [tmp_path / f"{index}.yaml" for index in range(len(texts))]
        for path, text in zip(paths, texts, strict=True):
            path.write_text(text)
        return Experiment.load(tables, paths, [parse_override(text) for text in overrides])

    return load_texts


def refusal(load, *texts, **others):
    with pytest.raises(InputError) as caught:
        load(*texts, **others)
    return str(caught.value)


def in_rig(*lines):
    return "rig:\n  ros__parameters:\n" + "".join(f"    {line}\n" for line in lines)


def test_a_file_of_the_usual_form_is_read(load):
    experiment = load(
        "/**:\n  ros__parameters:\n    rate: 1000\n    axes: [east, north]\n"
        "    specimen:\n      mass: [1, 2.5]\n"
        + in_rig("seed: 3", "safe:", "  close_time: 1")
        + "/reference_force:\n  ros__parameters: {mass_ratio: 1}\n"
    )
    assert experiment.timebase.stamp_ns(1) == 1_000_000
    assert experiment.axes == ("east", "north")
    assert experiment["rig"] == {
        "rate": 1000.0,
        "axes": ["east", "north"],
        "seed": 3,
        "specimen.mass": [1.0, 2.5],
        "limits.force": 22200.0,
        "safe.close_time": 1.0,
        "simulated.specimen.mass": [1.0, 2.5],
        "simulated.specimen.damping": 3.0,
    }
    assert experiment["reference_force"]["mass_ratio"] == 1.0
    assert isinstance(experiment["reference_force"]["mass_ratio"], float)


@pytest.mark.parametrize("text", ["2.11e5", "2.11E+5", "211000", "+211000.0", "2.11e+05"])
def test_numbers_are_numbers_however_they_are_written(load, text):
    experiment = load(everywhere(f"specimen.mass: {text}"))
    assert experiment["rig"]["specimen.mass"] == 211000.0
    assert isinstance(experiment["rig"]["specimen.mass"], float)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (in_rig("specimen.mas: 1"), "rig: there is no parameter specimen.mas; did you mean specim"),
        (everywhere("sede: 1"), "/**: there is no parameter sede; did you mean seed?"),
        (everywhere("specimen.mas: 1"), "no parameter specimen.mas; did you mean specimen.mass?"),
        ("rigg: {ros__parameters: {}}", "there is no node rigg; did you mean rig?"),
        (in_rig("seed: x"), 'rig: seed is "x", but must be a whole number'),
        (in_rig("seed:"), "rig seed has no value"),
        (everywhere("specimen.mass: 2024-01-01"), "must be a number"),
        (everywhere("specimen: 3"), "there is no parameter specimen"),
        (everywhere("specimen.mass: 1, axes: [x, x]"), "names must differ"),
        (everywhere(f"specimen.mass: 1, axes: {[*'ab' * 500]}"), "at most 100"),
        (everywhere('specimen.mass: 1, axes: [""]'), "names must differ"),
        (everywhere('specimen.mass: 1, axes: ["a\\nb"]'), "must be printable"),
        (everywhere('specimen.mass: 1, axes: ["\\ud800"]'), ""),
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
        ("rig: {ros__parameters: {}}", "/**: specimen.mass must be given (mass: one number, a dia"),
    ],
)
def test_what_makes_no_experiment_is_refused_in_one_line(load, tmp_path, text, said):
    message = refusal(load, text)
    assert said in message


@pytest.mark.parametrize("text", [in_rig("sede: 1"), in_rig("seed: x"), "rigg: {}", "rig: ["])
def test_the_file_at_fault_is_named(load, tmp_path, text):
    assert refusal(load, HAS_MASS, text).startswith(f"{tmp_path / '1.yaml'}:")


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x01")
    missing = tmp_path / "none.yaml", "No such file"
    for path, said in missing, (tmp_path, "Is a directory"), (binary, "not a text file"):
        with pytest.raises(InputError, match=said) as caught:
            read_parameter_file(path)
        assert str(caught.value).startswith(f"{path}:")


def test_a_file_that_is_too_large_is_refused_without_a_look_into_it(tmp_path, monkeypatch):
    monkeypatch.setattr("seft_msgs_py.config.experiment._parse_yaml", None)
    path = tmp_path / "large.yaml"
    path.write_text("#" * 1_000_001)
    with pytest.raises(InputError, match=rf"^{path}: is larger than 1 MB"):
        read_parameter_file(path)


@pytest.mark.parametrize("everywhere_first", [True, False])
def test_within_a_file_the_node_itself_wins_over_every_node(load, everywhere_first):
    parts = [everywhere("seed: 4, specimen.mass: 1"), in_rig("seed: 5")]
    experiment = load("".join(parts if everywhere_first else parts[::-1]))
    assert (experiment["rig"]["seed"], experiment["reference_force"]["seed"]) == (5, 4)


def test_later_files_win_and_overrides_win_over_files(load):
    first, second = HAS_MASS + in_rig("seed: 1"), in_rig("seed: 2")
    assert load(first, second)["rig"]["seed"] == 2
    assert load(second, first)["rig"]["seed"] == 1
    overridden = load(first, second, overrides=["rig:seed:=3"])
    assert overridden["rig"]["seed"] == 3
    assert overridden["rig"]["specimen.mass"] == 52.7
    assert load(first, overrides=["rig:seed:=3", "rig:seed:=4"])["rig"]["seed"] == 4
    assert load(first, overrides=["seed:=6"])["rig"]["seed"] == 6


def test_an_override_without_its_value_is_refused(load):
    said = refusal(load, HAS_MASS, overrides=["reference_force:mass_ratio:="])
    assert "mass_ratio is empty, but must be a number" in said


@pytest.mark.parametrize(
    ("node", "given_values", "said"),
    [
        ("rig", "rate: 500", "under /**"),
        ("reference_force", "axes: [y]", "under /**"),
        ("reference_force", "specimen.mass: 1", "under /**"),
        (
            "rig",
            "specimen.mass: 1",
            "under /**; what the simulated rig truly has is rig: simulated.specimen.mass",
        ),
        ("reference_force", "safe.close_time: 1", "under rig"),
    ],
)
def test_what_several_nodes_use_is_set_once(load, node, given_values, said):
    name, value = given_values.split(": ")
    said = f": {node}: {name} is set once, {said}"
    text = f"{node}: {{ros__parameters: {{{given_values}}}}}"
    assert refusal(load, HAS_MASS, text).endswith(f"1.yaml{said}")
    assert refusal(load, HAS_MASS, overrides=[f"{node}:{name}:={value}"]) == f"-p{said}"


@pytest.mark.parametrize("place", ["rig", "/**"])
def test_a_node_uses_a_setting_of_another_one(load, place):
    experiment = load(HAS_MASS, overrides=[f"{place}:safe.close_time:=0.5"])
    assert [experiment[table.node]["safe.close_time"] for table in TABLES] == [0.5, 0.5]
    with pytest.raises(InputError, match="is set once, under rig"):
        experiment.changed({"reference_force": {"safe.close_time": 1.0}})
    changed = experiment.changed({"rig": {"safe.close_time": 1.0}})
    assert [changed[table.node]["safe.close_time"] for table in TABLES] == [1.0, 1.0]


def truth_of(experiment):
    return [experiment["rig"][f"simulated.specimen.{name}"] for name in ("mass", "damping")]


def test_the_truth_is_what_is_known_where_it_is_not_given(load):
    known = load(everywhere("specimen: {mass: 5, damping: 6}"))
    assert truth_of(known) == [5.0, 6.0]
    assert truth_of(load(HAS_MASS)) == [52.7, 3.0]  # the default of a fact is no truth
    other = load(HAS_MASS + in_rig("simulated.specimen.mass: 50"), overrides=["specimen.mass:=9"])
    assert truth_of(other)[0] == 50.0
    assert other["reference_force"]["specimen.mass"] == 9.0


def test_a_changed_fact_is_known_to_all_and_true_if_the_truth_is_not_given(load):
    for pinned, expected in (({}, 9.0), ({"simulated.specimen.mass": 50.0}, 50.0)):
        experiment = load(HAS_MASS).changed({"rig": pinned})
        changed = experiment.changed({"/**": {"specimen.mass": 9}})
        assert [changed[table.node]["specimen.mass"] for table in TABLES] == [9.0, 9.0]
        assert truth_of(changed)[0] == expected
        assert experiment["rig"]["specimen.mass"] == 52.7
        bare = Experiment(experiment.sections).changed({"/**": {"specimen.mass": 9.0}})
        assert bare["reference_force"]["specimen.mass"] == bare["rig"]["specimen.mass"] == 9.0
        assert truth_of(bare) == truth_of(experiment)
    with pytest.raises(InputError, match=r'specimen.mass is "x", but must be a number'):
        experiment.changed({"/**": {"specimen.mass": "x"}})


def test_sections_that_differ_in_a_fact_are_refused(load):
    sections = load(HAS_MASS).sections
    sections["rig"]["specimen.mass"] = 5.0
    with pytest.raises(InputError, match=r"specimen.mass is 52.7, but rig has 5.0; set it once"):
        Experiment(sections)


@pytest.mark.parametrize(
    "text",
    [
        in_rig("safe.close_time: 1", "safe: {close_time: 2}"),
        in_rig("safe: {close_time: 1}", "safe.close_time: 2"),
        in_rig("safe.close_time: 1") + in_rig("safe: {close_time: 2}").replace("rig", "/rig"),
    ],
)
def test_a_name_that_is_given_twice_in_a_file_is_refused(load, tmp_path, text):
    path = tmp_path / "0.yaml"
    assert refusal(load, HAS_MASS + text) == f"{path}: rig safe.close_time is given twice"


def test_a_node_may_have_sections_with_and_without_a_slash(load):
    text = HAS_MASS + in_rig("seed: 2") + in_rig("safe.close_time: 1").replace("rig", "/rig")
    assert [load(text)["rig"][name] for name in ("seed", "safe.close_time")] == [2, 1.0]


@pytest.mark.parametrize("place", ["/**", "rig"])
def test_what_ros_gives_each_node_is_left_to_it_but_for_its_clock(load, place):
    of_ros = "use_sim_time: false, start_type_description_service: false"
    of_ros += ", qos_overrides./rig/state.publisher.depth: 9"
    text = f"{place}: {{ros__parameters: {{specimen.mass: 1, {of_ros}}}}}"
    text = text if place == "/**" else HAS_MASS + text.replace("specimen.mass: 1, ", "")
    assert load(text)["rig"].keys() == RIG.rows.keys()
    said = refusal(load, text.replace("use_sim_time: false", "use_sim_time: true"))
    assert f"{place}: use_sim_time is true, but nodes of seft follow the samples of the" in said


NAME = st.sampled_from(["x", "y", "n", "on", "1", "1e5", "null", "größe", "a b", "~", "- x", "#"])
NAMES = st.lists(NAME, min_size=1, max_size=3, unique=True)
NUMBERS = st.floats(1e-30, 1e30)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(NAMES, NUMBERS, st.lists(NUMBERS, min_size=3, max_size=3), st.integers(0, 2**63 - 1))
def test_what_is_written_is_read_back_with_values_and_types(load, axes, ratio, mass, seed):
    given_values = {
        "/**": {"axes": axes, "specimen.mass": mass[: len(axes)]},
        "rig": {"seed": seed, "simulated.specimen.mass": 1.5},
        "reference_force": {"mass_ratio": ratio},
    }
    experiment = load(parameter_text(given_values))
    assert experiment["rig"]["specimen.mass"] == experiment["reference_force"]["specimen.mass"]
    for known in (experiment, Experiment(experiment.sections)):
        files, overrides, _ = split_ros_arguments(["--ros-args", *known.arguments()])
        again = Experiment.load(TABLES, files, overrides)
        assert again.sections == experiment.sections
        assert repr(again.sections) == repr(experiment.sections)


def test_an_experiment_hands_on_the_files_and_overrides_that_it_was_read_from(tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(parameter_text({"/**": {"axes": ["x"], "specimen.mass": 2.0}}))
    given = [parse_override("rig:seed:=7")]
    changes = {"rig": {"seed": 8}, "/**": {"specimen.mass": 3.0}}
    experiment = Experiment.load(TABLES, [file], given).changed(changes)
    words = ["--params-file", str(file), "-p", "rig:seed:=7", "-p", "rig:seed:=8"]
    assert experiment.arguments() == [*words, "-p", "/**:specimen.mass:=3.0"]
    assert experiment["rig"]["seed"] == 8
    files, overrides, _ = split_ros_arguments(["--ros-args", *experiment.arguments()])
    assert Experiment.load(TABLES, files, overrides).sections == experiment.sections


def test_a_node_checks_its_own_section_and_leaves_the_others_to_their_nodes(tmp_path):
    file = tmp_path / "both.yaml"
    file.write_text(HAS_MASS + in_rig("of_a_lab: 1.0", "safe.close_time: 7"))
    for tables in (TABLES, [FORCE]):
        experiment = Experiment.load(tables, [file], nodes=[FORCE.node])
        assert list(experiment.sections) == ["reference_force"]
        assert experiment["reference_force"]["safe.close_time"] == 7.0  # which it uses, too
    with pytest.raises(InputError, match="no parameter of_a_lab"):
        Experiment.load(TABLES, [file], nodes=[RIG.node])


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
    mass = "specimen.mass: [5.0e-6, 1.0e+22, 3, 4]"
    experiment = load(everywhere(f'axes: [x, "y", "on", "12"], {mass}, seed: 2'))
    path = tmp_path / "written.yaml"
    path.write_text(parameter_text(experiment.by_place()))
    done = subprocess.run(
        [sys.executable, "-c", ASK_RCL, str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    read = json.loads(done.stdout)
    for node, section in experiment.sections.items():
        own = {name for name in section if place_of(name, node) in (EVERY_NODE, node)}
        assert {name: read[node][name] for name in own} == {name: section[name] for name in own}
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
