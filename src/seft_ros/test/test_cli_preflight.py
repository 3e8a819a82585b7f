"""`seft preflight`, and `seft run`, which does it first."""

import pytest
from experiments_at_hand import JHU
from seft_msgs_py.config.experiment import read_parameter_file
from seft_msgs_py.errors import ExperimentError
from seft_ros.design import stability_map

DEMO = JHU.with_name("demo.yaml")
WITHIN = ("-p", "ground_motion:peak_force:=500.0")  # of the sensors, at any mass ratio here
DELAY = ("-p", "actuator.kind:=delay", "-p", "actuator.delay:=0.01", *WITHIN)
RATIO = "reference_force:mass_ratio:="
UNKNOWN = ("--external", "rig", "-p", "actuator.flow_gain:=0.0")
KEYS = {
    *("verdict", "reasons", "basis", "promise", "plant", "compensation", "mass_ratio"),
    *("critical_mass_ratio", "crossing_hz", "dead_time_s", "critical_delay_s"),
    *("critical_added_delay_s", "delay_crossing_hz", "gain", "sure_delay_s", "robust_gain"),
    *("local_stiffness", "local_stiffness_followed", "assumed_delay_error_s"),
    *("false_damping_ratio", "frequency_error", "modes", "spectral_radius", "growth_rate"),
    *("dominant_hz", "states", "expected_peaks", "proposed_limits", "warnings"),
    *("unfit", "yielding_error"),
}


FAR = "warning: limits are "


def test_ten_milliseconds_end_at_the_known_mass_ratio(seft_json):
    found = seft_json("preflight", JHU, *DELAY, "-p", f"{RATIO}0.5")
    assert set(found) == KEYS
    assert (found["verdict"], found["basis"]) == ("stable", "exact")
    assert found["critical_mass_ratio"] == pytest.approx(0.94, abs=0.02)
    assert found["dead_time_s"] == 0.010
    added = found["critical_delay_s"] - found["dead_time_s"]
    assert found["critical_added_delay_s"] == pytest.approx(added) and added > 0
    unused = ("local_stiffness_followed", "assumed_delay_error_s", "sure_delay_s", "robust_gain")
    assert [found[name] for name in unused] == [None] * 4
    assert found["local_stiffness"]["planned"] == 1.0
    assert found["false_damping_ratio"] > 0


@pytest.mark.parametrize(
    ("ratio", "verdict", "expected"), [(0.9, "marginal", 0), (1.0, "unstable", 1)]
)
def test_the_exit_status_is_the_verdicts(seft_json, ratio, verdict, expected):
    found = seft_json("preflight", JHU, *DELAY, "-p", f"{RATIO}{ratio}", status=expected)
    assert found["verdict"] == verdict
    assert found["reasons"]
    assert (found["spectral_radius"] > 1) is (verdict == "unstable")


def test_for_people_there_is_a_table_and_every_reason_in_a_line(seft):
    status, out, err = seft("preflight", JHU, *DELAY, "-p", f"{RATIO}0.9")
    assert status == 0
    for words in ("marginal", "mass ratio", "dead time", "damping ratio", "Exact eigenvalues"):
        assert words in out
    assert err.startswith("seft: marginal: mass ratio: unstable at 0.9331, needed > 1.08")
    assert all(line.startswith("seft: marginal: ") for line in err.splitlines())


def test_a_peak_beyond_limit_or_rig_is_reported_and_refused_by_run(
    seft, seft_json, refused, flown, tmp_path
):
    beyond = (
        *("-p", "limits.displacement:=0.005"),
        *("-p", "rig:simulated.actuator.stroke:=0.006"),
        *("-p", "rig:simulated.actuator.flow_gain:=0.03"),
    )
    found = seft_json("preflight", DEMO, *beyond, "--write", "limits.yaml")
    assert (found["verdict"], found["unfit"]) == ("stable", [])
    quantities = [warning.split(" on axis x is ")[0] for warning in found["warnings"]]
    assert quantities == ["expected displacement"] * 2 + ["expected flow of the valve"]
    assert found["proposed_limits"]["displacement"] < 0.006
    assert read_parameter_file(tmp_path / "limits.yaml")["/**"] == {
        f"limits.{name}": limit for name, limit in found["proposed_limits"].items()
    }
    err = seft("preflight", DEMO, *beyond)[2]
    assert err.splitlines() == [f"warning: {warning}" for warning in found["warnings"]]
    err = refused("run", DEMO, *beyond)
    assert flown == []
    assert all(warning.split(";")[0] in err for warning in found["warnings"])
    remedy = "lower ground_motion: peak_force, or run it all the same with --accept-unstable"
    assert err.endswith(f"; {remedy}\n")
    status, _, err = seft("run", DEMO, *beyond, "--accept-unstable")
    assert (status, len(flown)) == (1, 1)
    assert err.splitlines()[0].endswith("; lower ground_motion: peak_force; accepted")


def test_a_specimen_in_other_units_is_refused(refused, flown):
    soft = ("-p", "specimen.stiffness:=177.653")
    for command in ("preflight", "run"):
        err = refused(command, JHU, *soft)
        assert flown == []
        assert "stiffness 177.653 N/m and mass 52.7 kg give a natural frequency of 0.292 Hz" in err
        assert "a stiffness of 177653 N/m (kN/m?) would give 9.24 Hz and fit" in err


def test_a_test_that_uses_little_of_a_sensor_is_refused(seft, seft_json, refused, flown):
    weak = ("-p", "ground_motion:peak_force:=100.0")
    found = seft_json("preflight", JHU, *weak, status=1)
    (reason,) = found["unfit"]
    assert found["verdict"] == "stable"
    assert "displacement 0.000698 of 0.1 m (0.698 %), force 100 of 22200 N (0.45 %)" in reason
    assert seft("preflight", JHU, *weak)[2].splitlines()[-1] == f"seft: {reason}"
    err = refused("run", JHU, *weak)
    assert flown == []
    assert err.startswith(f"seft: {reason}, or run it all the same with --accept-unstable")
    own = ("-p", "sensors.acceleration_range:=20", "--accept-unstable")
    assert "acceleration 22.2 of 20 m/s^2 (111 %)" in seft("run", JHU, *own)[2]
    assert len(flown) == 1


def test_the_figure_is_drawn_of_both_maps(seft_json, tmp_path, monkeypatch):
    monkeypatch.setattr(stability_map, "_FINEST", 15)
    assert seft_json("preflight", JHU, *DELAY, "--figure", "map")["figure"] == "map.png"
    assert (tmp_path / "map.png").stat().st_size > 20_000


@pytest.fixture
def flown(monkeypatch):
    """Tests that `seft run` would have started."""
    started = []

    def start(experiment, *_, **__):
        started.append(experiment)
        raise ExperimentError("started")

    monkeypatch.setattr("seft_ros.cli.shared.dds_test", start)
    return started


def test_run_refuses_an_unstable_plan_unless_it_is_accepted(seft, refused, tmp_path, flown):
    err = refused("run", JHU, "-p", f"{RATIO}2.0")
    assert flown == []
    assert "unstable test: oscillates at" in err
    assert "critical mass ratio is 1.33" in err
    assert "--accept-unstable" in err
    assert list(tmp_path.iterdir()) == []
    status, _, err = seft("run", JHU, "-p", f"{RATIO}2.0", "--accept-unstable")
    assert (status, len(flown)) == (1, 1)
    assert err.splitlines()[0].endswith("accepted")


def test_run_starts_a_stable_plan_without_a_word(seft, flown):
    status, _, err = seft("run", JHU, *WITHIN, "-p", f"{RATIO}0.5")
    assert (status, len(flown)) == (1, 1)
    assert [line for line in err.splitlines() if FAR not in line] == ["seft: started"]


def test_run_says_where_no_preflight_can_be_done(seft, flown):
    status, _, err = seft("run", JHU, *UNKNOWN)
    assert (status, len(flown)) == (1, 1)
    first, second = (line for line in err.splitlines() if FAR not in line)
    assert first.startswith("seft: preflight could not be done: ")
    assert second == "seft: started"


def test_run_assesses_an_external_rig_by_what_is_known_of_it(refused, flown):
    """All but an integrator, under a gain far too high."""
    high = ("force_controller:numerator:=1.0", "-p", "force_controller:denominator:=1.0")
    assert "unstable test" in refused("run", JHU, "--external", "rig", "-p", *high)
    assert flown == []
