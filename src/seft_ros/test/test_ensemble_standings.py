"""Ranking, table and figure, of outcomes that are made up."""

from io import StringIO

import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from rich.console import Console
from seft_msgs_py.errors import InputError
from seft_ros.drawing.style import check_figure, percent
from seft_ros.ensemble.entries import Entry, Tournament
from seft_ros.ensemble.runs import Run
from seft_ros.ensemble.standings import notes, standings, standings_table, tournament_figure

LOST = None
"""Error of an unstable test."""


def made_up(errors, not_possible=None, ratio=1.0):
    """Tournament and runs of errors, one for each rig, by method."""
    rigs = len(next(iter(errors.values())))
    lacking = {(ratio, name): reason for name, reason in (not_possible or {}).items()}
    methods = (*errors, *(not_possible or {}))
    tournament = Tournament(None, methods, (ratio,), ({},) * rigs, lacking)
    runs = [
        Run(Entry(ratio, rig, method), outcome(error, rig))
        for method, own in errors.items()
        for rig, error in enumerate(own)
    ]
    return tournament, runs


def outcome(error, rig):
    row = {
        "nrmse": 7.0 if error is LOST else error,
        "peak": 2.0 * (1.0 + (-1) ** rig * (error or 0.0)),
        "reference_peak": 2.0,
        "delay_s": 0.001 * rig,
    }
    return {"stable": error is not LOST, "displacement": row}


def ranked(errors, not_possible=None):
    tournament, runs = made_up(errors, not_possible)
    return standings(tournament, runs)


def rendered(table, width=80):
    console = Console(width=width, file=StringIO())
    console.print(table)
    return console.file.getvalue()


def test_the_numbers_are_those_of_the_stable_tests():
    (row,) = ranked({"a": [0.1, 0.4, LOST, 0.2]})
    assert (row.rank, row.nrmse_configured, row.nrmse_median) == (1, 0.1, 0.2)
    assert row.nrmse_worst is None
    assert row.peak_error == pytest.approx(-0.4)
    assert (row.delay_s, row.unstable_share) == (0.001, 0.25)


def test_all_unstable_has_no_numbers():
    (row,) = ranked({"a": [LOST, LOST]})
    assert (row.nrmse_median, row.nrmse_worst, row.peak_error, row.delay_s) == (None,) * 4
    assert row.unstable_share == 1.0


def test_the_worst_case_ranks_and_unstable_tests_come_first_in_it():
    rows = ranked(
        {
            "half": [0.01, LOST],
            "steady": [0.3, 0.31],
            "all": [LOST, LOST],
            "mostly": [0.1, 0.5],
            "half, better": [LOST, 0.005],
            "same as steady": [0.3, 0.31],
        },
        {"lacking": "it lacks a delay"},
    )
    assert [(row.rank, row.method) for row in rows] == [
        (1, "steady"),
        (1, "same as steady"),
        (3, "mostly"),
        (4, "half, better"),
        (5, "half"),
        (6, "all"),
        (None, "lacking"),
    ]


errors_of_rigs = st.lists(
    st.lists(st.one_of(st.none(), st.floats(1e-6, 10.0)), min_size=3, max_size=3),
    min_size=1,
    max_size=5,
)


@given(errors_of_rigs, st.randoms())
def test_the_order_of_methods_makes_no_difference(errors, random):
    named = {f"m{index}": own for index, own in enumerate(errors)}
    names = list(named)
    random.shuffle(names)
    shuffled = {name: named[name] for name in names}
    first = {row.method: row for row in ranked(named)}
    assert first == {row.method: row for row in ranked(shuffled)}


@given(st.lists(st.floats(1e-6, 10.0), min_size=3, max_size=3), st.integers(0, 2))
def test_an_unstable_test_never_betters_a_rank(errors, rig):
    spoilt = [LOST if index == rig else error for index, error in enumerate(errors)]
    rows = ranked({"spoilt": spoilt, "whole": errors})
    assert [row.method for row in rows] == ["whole", "spoilt"]


def test_the_table_fits_a_terminal():
    rows = ranked(
        {"linear_acceleration": [0.1234, 0.5], "none": [0.2, LOST], "wild": [12.0, 130.0]},
        {"lacking": "it lacks a delay"},
    )
    text = rendered(standings_table(rows, "title"))
    lines = [line.split() for line in text.splitlines()]
    first = ["1", "linear_acceleration", "31.2", "%", "50.0", "%"]
    first += ["-50.0", "%", "0.5", "ms", "0", "%"]
    assert first in lines
    (none,) = [line for line in lines if "none" in line]
    assert none[:5] == ["3", "none", "20.0", "%", "unstable"]
    assert "…" not in text
    assert "lacking" not in text
    assert notes(rows, []) == ["lacking: not possible: it lacks a delay"]


@pytest.mark.parametrize(
    ("share", "text"),
    [(None, "-"), (0.012345, "1.23 %"), (0.5, "50.0 %"), (1.5, "150 %"), (23.4, "2340 %")],
)
def test_percent(share, text):
    assert percent(share) == text


def test_the_figure_shows_every_test():
    errors = {"good": [0.01, 0.02, 0.03], "lost": [LOST, 0.2, LOST], "gone": [LOST] * 3}
    tournament, runs = made_up(errors, {"lacking": "no delay"})
    rows = standings(tournament, runs)
    (panel,) = tournament_figure(rows, runs, "title $x_y").axes
    assert [label.get_text() for label in panel.get_yticklabels()] == [row.method for row in rows]
    dots = [x for line in panel.lines if line.get_marker() == "o" for x in line.get_xdata()]
    assert sorted(dots) == pytest.approx([2.0, 3.0, 20.0])
    texts = [text.get_text() for text in panel.texts]
    assert sorted(texts) == ["2 of 3 unstable", "3 of 3 unstable", "not possible"]
    low, high = panel.get_xlim()
    assert low < 1.0 and high > 20.0


@pytest.mark.parametrize("errors", [{"a": [0.1]}, {"a": [LOST]}, {"a": [0.0, 0.0]}])
def test_a_figure_of_little_can_be_drawn(errors, tmp_path):
    tournament, runs = made_up(errors)
    figure = tournament_figure(standings(tournament, runs), runs, "")
    assert isinstance(figure, Figure)
    figure.savefig(tmp_path / "figure.png")


def test_many_mass_ratios_have_a_panel_each(tmp_path):
    rows, runs = [], []
    for ratio in (0.0, 0.5, 1.0, 3.0, 10.0):
        tournament, own = made_up({"a": [0.1, 0.2]}, ratio=ratio)
        rows += standings(tournament, own)
        runs += own
    figure = tournament_figure(rows, runs, "")
    titles = [panel.get_title(loc="left") for panel in figure.axes]
    assert titles == [f"mass ratio {ratio}" for ratio in ("0", "0.5", "1", "3", "10")]
    figure.savefig(tmp_path / "figure.png")


def test_a_figure_that_could_not_be_saved_is_refused_beforehand(tmp_path):
    assert check_figure(tmp_path / "figure") == tmp_path / "figure.png"
    assert check_figure(tmp_path / "figure.PDF") == tmp_path / "figure.PDF"
    (tmp_path / "folder.png").mkdir()
    for name, told in (
        ("x.docx", "figures end in"),
        ("none/x.png", "no folder"),
        ("folder.png", "is a folder"),
    ):
        with pytest.raises(InputError, match=told):
            check_figure(tmp_path / name)
