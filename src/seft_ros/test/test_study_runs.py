"""A study's tests are those of `seft simulate`, whoever calculates them."""

import math
from dataclasses import replace

import experiments_at_hand
import pytest
from experiments_at_hand import simulated
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import ExperimentError, InputError
from seft_ros.analysis.summary import summarise
from seft_ros.reference_force.compensation_methods import COMPENSATION_METHODS
from seft_ros.reference_force.compensator import LinearCompensator
from seft_ros.reference_force.reference_force_parameters import REFERENCE_FORCE_TABLE
from seft_ros.study import study_runs
from seft_ros.study.drawn_tests import StudyTest, design_study, draw_tests
from seft_ros.study.study_results import summarise_study, worst_folder, write_worst_tests
from seft_ros.study.study_runs import FinishedTests, run_study
from seft_ros.test_run.parameter_tables import TABLES

SHORT = ("ground_motion:synthetic.duration:=2", "ground_motion:tail:=0.5")


def load(*words):
    return experiments_at_hand.load(*SHORT, *words)


@pytest.fixture
def add_method(monkeypatch):
    """Have one more compensation method of some name."""

    def add(name, make):
        rows, row = REFERENCE_FORCE_TABLE.rows, REFERENCE_FORCE_TABLE.rows["compensation.method"]
        monkeypatch.setitem(rows, row.name, replace(row, choices=(*row.choices, name)))
        monkeypatch.setitem(COMPENSATION_METHODS, name, make)

    return add


def planned(*words, methods=("none", "restoring"), ratios=(0.5,), tests=2, **draws):
    experiment = load(*words)
    return design_study(experiment, draw_tests(experiment, tests, **draws), methods, ratios)


def keeping(design, folder, progress=lambda *_: None):
    return run_study(design, progress, finished=FinishedTests(design, folder))


class Adapting(LinearCompensator):
    """A method that the compiled loop does not know."""


def adapting(known):
    return Adapting(COMPENSATION_METHODS["none"](known).linear())


def impossible(_):
    raise InputError("there is no model")


def broken(known):
    compensator = COMPENSATION_METHODS["none"](known)
    compensator.step = lambda *_: 1 / 0
    return compensator


def test_the_file_of_a_worst_test_repeats_it(tmp_path, monkeypatch):
    record = tmp_path / "motion.csv"
    record.write_text("".join(f"{(-1) ** (k // 20)}\n" for k in range(400)))
    monkeypatch.chdir(tmp_path)
    words = ("file:=motion.csv", "dt:=0.005", "unit:=m/s2")
    experiment = load(*(f"ground_motion:{word}" for word in words))
    design = design_study(experiment, draw_tests(experiment, 8, spread=0.3), ["restoring"], [0.5])
    runs = run_study(design)
    summary = summarise_study(design, runs)
    write_worst_tests(design, summary, tmp_path / "study")
    (result,) = summary["results"]
    errors = [one["nrmse"] if one["stable"] else math.inf for one in result["worst"]]
    assert len(errors) == 5 and errors == sorted(errors, reverse=True)
    monkeypatch.chdir("/")
    for worst in result["worst"]:
        again = summarise(simulated(Experiment.load(TABLES, [worst["file"]])))
        kept = runs[worst["test"]].summary
        assert {name: again[name] for name in kept} == kept
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file: can't be made"):
        write_worst_tests(design, summary, tmp_path / "file")
    assert worst_folder(tmp_path / "page.html") == tmp_path / "page"
    with pytest.raises(InputError, match="file: is no folder"):
        worst_folder(tmp_path / "file.html")


def test_a_method_that_is_not_compiled_is_simulated_uncompiled_and_named_so(add_method):
    add_method("adapting", adapting)
    reported = []
    both = planned(methods=["none", "adapting"])
    runs = run_study(both, progress=lambda what, _: reported.append(what))
    assert [bool(one.why_not_compiled) for one in runs] == [False, True] * 3
    first = "mass ratio 0.5, {}, test 0"
    assert reported[:2] == [first.format("none"), f"{first.format('adapting')} (uncompiled)"]
    assert [one.summary for one in runs[::2]] == [one.summary for one in runs[1::2]]


def test_all_methods_and_mass_ratios_meet_the_same_tests():
    delay = "/**:actuator.delay:=0.0109"
    design = planned(delay, methods=["all"], ratios=[0.5, 1.0])
    assert design.methods == tuple(COMPENSATION_METHODS)
    alone = planned(delay, methods=["none"], ratios=[3.0])
    assert design.drawn.sections == alone.drawn.sections
    base = design.experiment
    for test in design.tests():
        own = design.experiment_of(test)
        drawn, changed = design.drawn.sections[test.number], {"mass_ratio": test.mass_ratio}
        assert own["ground_motion"] == drawn["ground_motion"]
        assert own["rig"] == drawn["rig"] | changed  # its detectors know it
        follows = test.method == "target_motion"
        control = "velocity_feedforward" if follows else "transfer_function"
        assert own["force_controller"] == base["force_controller"] | {"method": control} | changed
        changed["compensation.method"] = test.method
        assert own["reference_force"] == base["reference_force"] | changed


def test_results_do_not_depend_on_the_number_of_workers():
    design = planned(methods=["none"])
    reported = []
    runs = run_study(design, lambda what, done: reported.append((what, done)), workers=2)
    assert runs == run_study(design)
    assert [done for _, done in reported] == [1, 2, 3]
    assert {what for what, _ in reported} == {str(test) for test in design.tests()}


class Stop:
    """Interrupts after some tests."""

    def __init__(self, tests):
        self.reported, self._tests = [], tests

    def __call__(self, what, done):
        self.reported.append((what, done))
        if len(self.reported) == self._tests:
            raise KeyboardInterrupt


def test_what_was_finished_before_an_interruption_is_not_run_again(tmp_path, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        keeping(planned(), tmp_path, Stop(3))
    (file,) = tmp_path.iterdir()
    assert len(file.read_text().splitlines()) == 3
    with file.open("a") as lines:  # as of a process that was killed
        lines.write('[[0.5, "none", 2], {"steps"')
    ran, own_run = [], study_runs._run
    monkeypatch.setattr(study_runs, "_run", lambda *words: ran.append(words[0]) or own_run(*words))
    reported, more = Stop(0), planned(ratios=[0.5, 1.5], tests=3)  # goes on with more of them
    found = keeping(more, tmp_path, reported)
    done = planned().tests()[:3]
    assert ran == [test for test in more.tests() if test not in done]
    assert reported.reported[0] == ("3 tests were finished before", 3)
    assert found == run_study(more)
    FinishedTests(more, tmp_path).remove()
    assert list(tmp_path.iterdir()) == []


def test_other_inputs_begin_anew(tmp_path):
    record = tmp_path / "motion.csv"
    words = (f"ground_motion:file:={record}", "ground_motion:dt:=0.005", "ground_motion:unit:=m/s2")
    same = [(1.0, {}, 1), (1.0, {"tests": 3}, 1)]
    other = [(1.1, {}, 2), (1.1, {"seed": 2}, 3), (1.1, {"spread": 0.2}, 4)]
    for peak, draws, files in [*same, *other]:
        record.write_text("".join(f"{peak * (-1) ** (k // 20)}\n" for k in range(200)))
        with pytest.raises(KeyboardInterrupt):
            keeping(planned(*words, **draws), tmp_path, Stop(1))
        assert len(list(tmp_path.glob("*.jsonl"))) == files


def test_a_file_of_finished_tests_that_holds_something_else_is_reported(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        keeping(planned(), tmp_path, Stop(1))
    (file,) = tmp_path.iterdir()
    for text in ("some text\n", "[1, {}, 2]\n", "{}\n"):
        file.write_text(text)
        with pytest.raises(InputError, match="holds no finished tests; remove it"):
            keeping(planned(), tmp_path)


def test_finished_tests_that_can_not_be_kept_are_reported(tmp_path):
    with pytest.raises(InputError, match=r"can't be kept there .*start in a folder"):
        keeping(planned(), tmp_path / "none")


def test_a_method_that_can_not_be_set_up_is_left_out_and_the_others_go_on(add_method):
    add_method("impossible", impossible)
    design = planned(methods=["impossible", "none"])
    assert design.not_possible == {(0.5, "impossible"): "there is no model"}
    assert design.tests() == [StudyTest(0.5, "none", number) for number in range(3)]
    with pytest.raises(InputError, match=r"^there is no model$"):
        planned(methods=["impossible"])


def test_an_experiment_that_makes_no_test_is_refused_before_any_method_is_blamed():
    with pytest.raises(InputError, match="denominator is zero"):
        planned("force_controller:denominator:=0", methods=["all"])


def test_a_method_that_breaks_is_reported_with_its_test(add_method):
    add_method("broken", broken)
    with pytest.raises(ExperimentError) as caught:
        run_study(planned(methods=["none", "broken"]))
    said = "mass ratio 0.5, broken, test 0: ZeroDivisionError: division by zero"
    assert str(caught.value) == said
