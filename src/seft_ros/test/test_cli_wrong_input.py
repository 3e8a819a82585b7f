"""Wrong input is reported in one line on stderr, with exit status 2; results are the only
stdout."""

import json
import os
import pkgutil
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from experiments_at_hand import JHU
from seft_ros.cli.main import APP

SHORT = ("-p", "ground_motion:synthetic.duration:=4", "-p", "ground_motion:tail:=1")
TRUE = "rig:simulated."


@pytest.fixture
def record(tmp_path):
    """Words that make an experiment read a file of this name and text."""

    def write(name, text, **parameters):
        (tmp_path / name).write_text(text)
        words = [f"file:={tmp_path / name}", *(f"{k}:={v}" for k, v in parameters.items())]
        return [word for text in words for word in ("-p", f"ground_motion:{text}")]

    return write


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["simulat", JHU], "simulat"),
        (["simulate"], "CONFIG"),
        (["simulate", JHU, "--josn"], "--josn"),
        (["simulate", JHU, "-p"], "-p"),
        (["simulate", "none.yaml"], "none.yaml: No such file"),
        (["simulate", JHU, "-p", 'ground_motion:file:="two\\nlines"'], "two lines"),
        (["simulate", JHU, *SHORT, "--out", "."], "exists already"),
        (["run", JHU, "--external", "rigg"], "did you mean rig?"),
        (["run", JHU, "--external", "recorder"], "--external recorder: must be one of"),
        (["report", "none"], "none"),
        (["compare", "none", "other"], "none"),
        (["compare", "one", "one", "--figure", "none/figure.png"], "no folder none"),
        (["compare", "one", "one", "--figure", "figure.xyz"], "figures end in"),
        (["preflight", JHU, "--external", "rig", "-p", "actuator.flow_gain:=0"], "seft identify"),
        (["identify", JHU, "--duration", "5"], "needs 13.3333 s"),
        (["identify", JHU, "--external", "force_controller"], "--external"),
        (["identify", JHU, "--max-displacement", "0"], "--max-displacement is 0 m, but must"),
        (["identify", JHU, "--travel", "1e-4"], "that of the multisine test: give --specimen, too"),
        (["identify", JHU, "--specimen", "--travel", "0.05"], "limits.displacement"),
        (["link", "--out", "x.yaml"], "--out needs CONFIG"),
        (["link", "--duration", "0"], "must be positive"),
        (["run", JHU, "-p", "loop_delay:=-1"], "--external force_controller"),
        (["new", "driver", "../rig"], "use lower-case letters"),
        (["new", "driver", "json"], "another package has this name"),
        (["new", "bridge", "my_rig"], "can't make a new bridge; seft new driver NAME makes a"),
        (["study", JHU, *SHORT, "--method", "nome"], "did you mean none?"),
        (["study", JHU, *SHORT, "--out", "none/page.html"], "no folder none"),
        (["study", JHU, *SHORT, "--spread", "2"], "--spread"),
        (["replay", "bag", "-p", "rig:seed:=3"], "-p needs one --node, whose parameters it"),
        (["motion"], "name a record, or an experiment by --config"),
        (["motion", "none.AT2", "-p", "rate:=100"], "name it by --config"),
        (["parameters", "rigg", "seed"], "did you mean rig?"),
        (["simulate", JHU, "-p", "rig:limits.force:=9"], "limits.force is set once, under /**"),
        (["simulate", JHU, "-p", f"{TRUE}sensors.force_bias:=3000"], "rig: force is 3e+03 N at"),
        (["run", JHU, *SHORT, "-p", "rig:faults:=force set 3 at 90"], "ends at 3 s, before"),
    ],
)
def test_a_wrong_command_line_is_refused_before_all_writing(refused, tmp_path, words, message):
    assert message in refused(*words)
    assert list(tmp_path.iterdir()) == []


def test_a_test_that_trips_ends_with_status_1_and_says_so(seft, tmp_path):
    words = ("-p", "reference_force:mass_ratio:=1.5", "-p", "limits.acceleration:=30")
    unwatched = ("-p", "reference_force:instability.ratio:=0.0")  # a limit is to trip it
    status, out, err = seft("simulate", JHU, *words, *unwatched, "--json")
    summary = json.loads(out)
    assert status == 1
    assert summary["stable"] is False
    assert set(summary["trip"]) == {"reason", "step", "time_s"}
    assert summary["trip"]["step"] == summary["steps"] - 1
    assert "acceleration" in err.splitlines()[-1]
    assert "beyond the limit of 30" in err.splitlines()[-1]
    assert "unstable" not in err  # a limit is no instability
    assert list(tmp_path.iterdir()) == []  # nothing is written without --out


def test_out_names_the_folder_of_the_bag_which_reports_the_same(seft_json, tmp_path):
    simulated = seft_json("simulate", JHU, *SHORT, "--out", "bag", "--no-figure")
    assert (simulated["stable"], simulated["trip"]) == (True, None)
    assert simulated["rate_hz"] == 500.0
    assert simulated["steps"] == 1501  # 4 s twice as fast, 1 s of tail
    assert simulated["duration_s"] == pytest.approx(3.002)
    reported = seft_json("report", "bag", "--csv", "histories")
    del reported["page"], simulated["events"], reported["events"]  # a bag has them
    assert {key for key in simulated if simulated[key] != reported.get(key)} == set()
    assert 0.0 < reported["simulated"]["displacement_peak"] < 0.02
    lines = (tmp_path / "histories.csv").read_text().splitlines()
    assert len(lines) == 1 + reported["steps"]


def test_motion_prints_one_json_object_and_draws_where_asked(seft_json, record, tmp_path):
    record("tent.txt", "0\n2\n0\n-4\n0\n")
    words = ("motion", "tent.txt", "--unit", "m/s2", "--dt", "0.01", "--rate", "100")
    assert seft_json(*words)["peak_acceleration"] == [4.0]
    assert [path.name for path in tmp_path.iterdir()] == ["tent.txt"]
    seft_json(*words, "--figure", "tent")
    assert (tmp_path / "tent.png").stat().st_size > 1000
    seft_json(*words, "--csv", "spectrum.csv")
    spectrum = np.loadtxt(tmp_path / "spectrum.csv", delimiter=",", skiprows=1)
    assert spectrum.shape == (150, 2)
    assert (tmp_path / "spectrum.csv").read_text().startswith("period (s),motion pseudo-acc")


def test_simulate_and_motion_tell_the_same_of_a_ground_motion(seft, seft_json, record):
    text = "".join(f"{0.01 * k:.2f},{100 * np.sin(np.pi * k / 10):.6f}\n" for k in range(101))
    words = record("own.csv", text, unit="cm/s2", peak_force=105.4, time_scale=0.5, tail=0.5)
    simulated = seft_json("simulate", JHU, *words)["ground_motion"]
    assert (simulated["scale_factor"], simulated["duration_s"]) == pytest.approx((2.0, 0.5))
    shown = seft_json("motion", "--config", JHU, *words)
    assert {name: shown[name] for name in simulated} == simulated
    message = " ".join(seft("simulate", JHU, *words)[1].split())
    assert "own.csv in cm/s2, dt 0.01 s" in message
    assert "read: columns, column 1, 101 samples; unit" in message
    assert all(part in message for part in ("its scale: factor 2 ", "scale 0.5", "PGA 2 m/s²"))


def test_the_version_is_a_result(seft):
    status, out, err = seft("--version")
    assert (status, err) == (0, "")
    assert re.fullmatch(r"seft \d+\.\d+\.\d+\n", out)


@pytest.mark.parametrize("command", APP.registered_commands, ids=lambda c: c.callback.__name__)
def test_examples_can_be_copied_from_a_terminal_of_80_columns(seft, monkeypatch, command):
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = seft(command.callback.__name__, "--help")
    assert status == 0
    whole = [line.strip() for line in out.splitlines() if len(line) <= 80]
    text = command.callback.__doc__.partition("Example")[2]
    examples = [line.strip() for line in text.splitlines() if line.startswith("        ")]
    assert examples
    for example in examples:
        assert example.startswith(("seft ", "ROS_DOMAIN_ID=", "ros2 "))
        assert example in whole


def test_the_process_ends_with_status_2_in_one_line_and_has_loaded_no_large_library():
    large = {"numba", "scipy", "matplotlib", "bokeh", "rclpy"}
    code = "import sys; from seft_ros.cli.main import main; status = main()\n"
    code += f"print(*{large} & set(sys.modules)); sys.exit(status)"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", code, "simulate", "none.yaml"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "\n", 1)


@pytest.mark.parametrize(
    ("where", "message"),
    [
        ("seft_ros.test_run.offline.simulate_test", "nothing was written"),
        ("seft_ros.drawing.style.save_figure", "bag is whole"),
    ],
)
def test_an_interruption_says_what_stands(seft, monkeypatch, where, message):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(where, interrupt)
    status, out, err = seft("simulate", JHU, *SHORT, "--out", "bag")
    assert (status, out, err.splitlines()[-1]) == (1, "", f"seft: interrupted; {message}")


@pytest.mark.parametrize("when", ["seft_ros.bags.bag_writer.os.pwrite", "report_numbers"])
def test_a_bag_that_is_deleted_under_its_command_is_reported(seft, monkeypatch, tmp_path, when):
    where = when if "." in when else "seft_ros.analysis.report_numbers.report_numbers"
    module, _, name = where.rpartition(".")
    original = getattr(pkgutil.resolve_name(module), name)

    def delete_before(*words):
        shutil.rmtree(tmp_path / "bag", ignore_errors=True)
        return original(*words)

    monkeypatch.setattr(where, delete_before)
    status, _, err = seft("simulate", JHU, *SHORT, "--out", "bag")
    assert status == 1
    assert re.search(r"seft: bag: the bag was deleted( when it was whole)?$", err.splitlines()[-1])
    assert "Traceback" not in err
