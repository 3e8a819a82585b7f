"""A tournament's tests are those of `seft simulate`, whoever calculates them."""

from pathlib import Path

import numpy as np
import pytest
from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_msgs_py.errors import ExperimentError, InputError
from seft_ros.analysis.summary import summarise
from seft_ros.ensemble import runs as runs_module
from seft_ros.ensemble.entries import Entry, make_tournament
from seft_ros.ensemble.runs import Place, run_tests
from seft_ros.reference_force.compensation_methods import METHODS
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate
from seft_ros.test_run.parameter_tables import TABLES

JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"
SHORT = ("ground_motion:synthetic.duration:=4", "ground_motion:tail:=0.5")
DELAY = ("rig:actuator.kind:=delay", "rig:actuator.delay:=0.01")
KEYS = ("steps", "stable", "trip", "saturated", "displacement", "acceleration", "force")


def load(*words):
    return Experiment.load(TABLES, [JHU], [parse_override(word) for word in (*SHORT, *words)])


def simulated(experiment):
    summary = summarise(simulate(experiment, build_blocks(experiment)))
    return {key: summary[key] for key in KEYS}


def run_all(tournament, place=None, progress=None):
    return run_tests(tournament.tests(), place or Place(), progress, "tournament")


def alike(found, wanted):
    """Tell whether two summaries are equal, but for rounding."""
    if isinstance(wanted, dict):
        return found.keys() == wanted.keys() and all(alike(found[k], wanted[k]) for k in wanted)
    if isinstance(wanted, float):
        return found == pytest.approx(wanted, rel=1e-7, abs=1e-9)
    return found == wanted


def impossible(_):
    raise InputError("there is no model")


def broken(known):
    compensator = METHODS["none"](known)
    compensator.step = lambda *_: 1 / 0
    return compensator


def test_the_first_rig_gives_what_simulate_gives():
    tournament = make_tournament(load(), ["none", "restoring"], [0.5], rigs=1)
    runs = run_all(tournament)
    assert [run.entry for run in runs] == [Entry(0.5, 0, "none"), Entry(0.5, 0, "restoring")]
    for run in runs:
        words = (
            "reference_force:mass_ratio:=0.5",
            f"reference_force:compensation.method:={run.entry.method}",
        )
        assert run.engine == "compiled"
        assert alike(run.summary, simulated(load(*words)))


def test_a_perturbed_rig_is_tested_with_the_configured_model_against_its_own_structure():
    tournament = make_tournament(load(*DELAY), ["none"], [0.5], rigs=3, spread=0.3)
    run = run_all(tournament)[2]
    rig = tournament.rigs[2]
    assert rig["specimen.mass"] != 52.7
    words = (
        *DELAY,
        "reference_force:mass_ratio:=0.5",
        *(
            f"reference_force:model.{name}:={value!r}"
            for name, value in (("mass", 52.7), ("damping", 800.3), ("stiffness", 2.11e5))
        ),
        "ground_motion:mass:=52.7",
        *(
            f"rig:{name}:={rig[name]!r}"
            for name in ("seed", *(row for row in rig if row.startswith("specimen.")))
            if not isinstance(rig[name], str)
        ),
        f"rig:actuator.delay:={rig['actuator.delay']!r}",
        f"rig:actuator.friction:={rig['actuator.friction']!r}",
    )
    assert alike(run.summary, simulated(load(*words)))


class Watching:
    """`none`, which knows the largest force."""

    def __init__(self, known):
        self._none, self.largest = METHODS["none"](known), np.zeros(known.axes)
        self.preview, self.linear = 0, self._none.linear

    def reset(self):
        self.largest[:] = 0.0

    def step(self, ground_motion, state):
        np.maximum(self.largest, state[3], out=self.largest)
        return self._none.step(ground_motion, state)

    def estimates(self):
        return {"largest": self.largest}


def test_a_method_of_ones_own_is_simulated_uncompiled_and_named_so(monkeypatch):
    monkeypatch.setitem(METHODS, "watching", Watching)
    tournament = make_tournament(load(), ["none", "watching"], [0.5])
    told = []
    first, second = run_all(tournament, progress=lambda what, _: told.append(what))
    assert (first.engine, second.engine) == ("compiled", "plain")
    assert told == [
        "mass ratio 0.5, rig 0, none",
        "mass ratio 0.5, rig 0, watching (uncompiled)",
    ]
    plain = simulated(tournament.experiment_of(Entry(0.5, 0, "watching")))
    assert {key: second.summary[key] for key in KEYS} == plain


def test_the_model_stays_the_configured_one_where_it_follows_from_the_rig(tmp_path):
    text = JHU.read_text()
    start, end = text.index("    model:"), text.index("    compensation:")
    (tmp_path / "bare.yaml").write_text(text[:start] + text[end:])
    tournament = make_tournament(Experiment.load(TABLES, [tmp_path / "bare.yaml"]), rigs=4)
    believed = [
        tournament.experiment_of(Entry(0.0, rig, "none"))["reference_force"] for rig in range(4)
    ]
    assert all(section == believed[0] for section in believed)
    assert believed[0]["model.mass"] == 52.7


def test_all_methods_meet_the_same_rigs_on_the_same_motion():
    tournament = make_tournament(load(), mass_ratios=[0.5, 1.0], rigs=3)
    assert tournament.methods == tuple(METHODS)
    for rig in range(3):
        experiments = [
            tournament.experiment_of(Entry(ratio, rig, method))
            for ratio in (0.5, 1.0)
            for method in METHODS
        ]
        for node in ("rig", "ground_motion"):
            assert all(own[node] == experiments[0][node] for own in experiments)
        for own in experiments:
            follows = own["reference_force"]["compensation.method"] == "target_motion"
            control = "velocity_feedforward" if follows else "transfer_function"
            assert own["force_controller"] == experiments[0]["force_controller"] | {
                "method": control
            }
        assert experiments[0]["rig"] == tournament.rigs[rig]


def test_results_do_not_depend_on_the_number_of_workers():
    tournament = make_tournament(load(), ["none", "restoring"], [0.5, 1.5], rigs=2)
    told = []
    runs = run_all(tournament, Place(2), lambda what, done: told.append((what, done)))
    assert runs == run_all(tournament)
    assert [done for _, done in told] == list(range(1, 9))
    assert {what for what, _ in told} == {str(entry) for entry in tournament.entries()}


class Stop:
    """Interrupts after some tests."""

    def __init__(self, tests):
        self.told, self._tests = [], tests

    def __call__(self, what, done):
        self.told.append((what, done))
        if len(self.told) == self._tests:
            raise KeyboardInterrupt


def test_what_was_finished_before_an_interruption_is_not_run_again(tmp_path, monkeypatch):
    tournament = make_tournament(load(), ["none", "restoring"], [0.5, 1.5], rigs=2)
    with pytest.raises(KeyboardInterrupt):
        run_all(tournament, Place(keep=tmp_path), Stop(3))
    (file,) = tmp_path.iterdir()
    assert len(file.read_text().splitlines()) == 3
    with file.open("a") as lines:  # as of a process that was killed
        lines.write('[3, {"steps"')
    ran, run = [], runs_module._run
    monkeypatch.setattr(runs_module, "_run", lambda *words: ran.append(words[0]) or run(*words))
    told = Stop(0)
    assert run_all(tournament, Place(keep=tmp_path), told) == run_all(tournament)
    assert ran[:5] == [str(entry) for entry in tournament.entries()[3:]]
    assert told.told[0] == ("3 tests were finished before", 3)
    assert list(tmp_path.iterdir()) == []


def test_other_inputs_begin_anew(tmp_path):
    record = tmp_path / "motion.csv"
    for number, peak in enumerate((1.0, 1.0, 1.1)):
        record.write_text("".join(f"{peak * (-1) ** (k // 20)}\n" for k in range(200)))
        words = (f"ground_motion:file:={record}", "ground_motion:dt:=0.005")
        tournament = make_tournament(load(*words, "ground_motion:unit:=m/s2"), ["none"], rigs=2)
        with pytest.raises(KeyboardInterrupt):
            run_all(tournament, Place(keep=tmp_path), Stop(1))
        assert len(list(tmp_path.glob("*.jsonl"))) == (1, 1, 2)[number]


def test_a_file_of_finished_tests_that_holds_something_else_is_told(tmp_path):
    tournament = make_tournament(load(), ["none"], rigs=2)
    with pytest.raises(KeyboardInterrupt):
        run_all(tournament, Place(keep=tmp_path), Stop(1))
    (file,) = tmp_path.iterdir()
    file.write_text("some text\n")
    with pytest.raises(InputError, match="holds no finished tests; remove it"):
        run_all(tournament, Place(keep=tmp_path))


def test_finished_tests_that_can_not_be_kept_are_told(tmp_path):
    tournament = make_tournament(load(), ["none"], rigs=2)
    with pytest.raises(InputError, match=r"can't be kept there .*start in a folder"):
        run_all(tournament, Place(keep=tmp_path / "none"))


def test_a_rig_is_the_same_however_many_there_are():
    few, many = (make_tournament(load(), ["none"], rigs=rigs) for rigs in (2, 5))
    assert many.rigs[:2] == few.rigs


def test_a_method_that_can_not_be_set_up_is_left_out_and_the_others_go_on(monkeypatch):
    monkeypatch.setitem(METHODS, "impossible", impossible)
    tournament = make_tournament(load(), ["impossible", "none"], [0.5])
    assert tournament.not_possible == {(0.5, "impossible"): "there is no model"}
    assert tournament.entries() == [Entry(0.5, 0, "none")]
    with pytest.raises(InputError, match="no method is possible: there is no model"):
        make_tournament(load(), ["impossible"])


@pytest.mark.parametrize(
    ("method", "told"), [("nome", "did you mean none"), ("smyth", "must be one of none")]
)
def test_an_unknown_method_is_refused(method, told):
    with pytest.raises(InputError, match=told):
        make_tournament(load(), [method])


@pytest.mark.parametrize("ratio", [-1.0, float("nan"), float("inf")])
def test_a_mass_ratio_out_of_bounds_is_refused(ratio):
    with pytest.raises(InputError, match="mass_ratio is"):
        make_tournament(load(), ["none"], [ratio])


def test_an_experiment_that_makes_no_test_is_refused_before_any_method_is_blamed():
    with pytest.raises(InputError, match="denominator is zero"):
        make_tournament(load("force_controller:denominator:=0"))


def test_a_method_that_breaks_is_told_with_its_test(monkeypatch):
    monkeypatch.setitem(METHODS, "broken", broken)
    tournament = make_tournament(load(), ["none", "broken"], [0.5], rigs=2)
    with pytest.raises(ExperimentError) as caught:
        run_all(tournament)
    assert str(caught.value) == "mass ratio 0.5, rig 0, broken: ZeroDivisionError: division by zero"
