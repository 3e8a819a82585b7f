"""Pages: complete in one file, and figures thinned without a peak lost."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recordings_at_hand import shown
from seft_msgs_py.errors import InputError
from seft_ros.drawing import page
from seft_ros.drawing.page import (
    PageSection,
    Plot,
    Text,
    VerdictBox,
    check_page,
    line,
    plot,
    write_page,
)
from seft_ros.drawing.style import MAX_POINTS, Cell, Mark, TextTable, thinned


def written(tmp_path: Path, *blocks: Text | VerdictBox | TextTable | Plot) -> str:
    path = tmp_path / "page.html"
    write_page(path, "A test", "of <the> page", [PageSection("All of it", blocks)])
    return path.read_text()


def a_plot(count: int = 10) -> Plot:
    panel = plot("time / s", "force / N")
    line(panel, np.arange(count) * 1.0, np.arange(count) * 2.0, "test")
    return Plot(panel, "what to look for")


def test_a_page_asks_nothing_of_the_network(tmp_path: Path) -> None:
    text = written(tmp_path, a_plot())
    assert not re.search(r"<(script|img|link|iframe)[^>]+(src|href)=[\"'](?!data:)", text)
    assert "Bokeh" in text and "what to look for" in text


def test_a_page_without_figures_carries_no_library(tmp_path: Path) -> None:
    assert len(written(tmp_path, Text("nothing to see"))) < 10_000


def test_text_is_not_taken_for_html(tmp_path: Path) -> None:
    text = written(
        tmp_path,
        Text("<b>bold</b>"),
        VerdictBox(Mark.BAD, "<i>worse</i>", [Cell("<u>found</u>", Mark.DOUBT)]),
        TextTable(["<h>"], [["<td>", Cell("<em>", Mark.GOOD)]]),
    )
    for tag in ("<b>", "<i>", "<u>", "<h>", "<em>", "<the>"):
        assert tag not in text


def test_the_verdict_and_its_findings_have_their_marks(tmp_path: Path) -> None:
    text = written(tmp_path, VerdictBox(Mark.BAD, "tripped", [Cell("force", Mark.GOOD)]))
    assert '<div class="verdict bad">' in text
    assert '<li class="good">force</li>' in text


@given(st.integers(0, 40_000), st.integers(0, 2**32 - 1))
def test_thinning_keeps_ends_and_extremes(count: int, seed: int) -> None:
    y = np.random.default_rng(seed).standard_normal(count)
    at = thinned(y)
    assert len(at) <= max(MAX_POINTS + 4, 1)
    assert np.all(np.diff(at) > 0)
    if count:
        assert {0, count - 1, int(y.argmax()), int(y.argmin())} <= set(at.tolist())


def test_thinning_keeps_short_signals_whole() -> None:
    assert np.array_equal(thinned(np.zeros(MAX_POINTS)), np.arange(MAX_POINTS))


def test_thinning_survives_what_is_not_finite() -> None:
    y = np.full(10 * MAX_POINTS, np.nan)
    y[7] = np.inf
    assert 7 in thinned(y)


@pytest.mark.parametrize(("name", "what"), [("x.pdf", "pages end in"), ("no/x.html", "no folder")])
def test_impossible_names_are_refused_before_the_work(tmp_path: Path, name: str, what: str) -> None:
    with pytest.raises(InputError, match=what):
        check_page(tmp_path / name)


def test_a_name_is_completed(tmp_path: Path) -> None:
    assert check_page(tmp_path / "x") == tmp_path / "x.html"


ROWS = [["displacement", Cell("10.5 mm", Mark.BAD)], None, ["x force", "1516 N"]]


def test_terminal_and_page_show_the_same_cells(tmp_path) -> None:
    table = TextTable(("", "peak"), ROWS)
    page.write_page(tmp_path / "page.html", "", "", [page.PageSection("one", [table])])
    html, text = (tmp_path / "page.html").read_text(), shown([table])
    for cell in ("peak", "displacement", "10.5 mm", "x force", "1516 N"):
        unbroken = cell.replace("5 mm", "5\u00a0mm").replace("6 N", "6\u00a0N")
        assert f">{unbroken}</t" in html
        assert cell in text
    assert '<td class="bad">10.5\u00a0mm</td>' in html
    assert html.count("<tbody>") == 2
    assert text.count("├") == 1  # a line between the sections


def test_without_headings_names_and_values_are_lines() -> None:
    assert shown([TextTable((), ROWS)]).splitlines() == ["displacement: 10.5 mm", "x force: 1516 N"]


def test_what_is_too_wide_is_folded_and_not_cut_off() -> None:
    words = [[f"row-{index}-{'w' * 30}", "v" * 60] for index in range(3)]
    text = shown([TextTable(("h" * 40, "peak"), words)], width=80)
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    assert [text.count(letter) for letter in "hv"] == [40, 180]


def test_a_list_of_nothing_is_nothing() -> None:
    assert shown([TextTable((), [])]) == ""
    assert [*TextTable(("a",), [None, None]).sections()] == []
