"""One table, on the terminal and on a page."""

import io

from rich.console import Console
from seft_ros.drawing import page
from seft_ros.drawing.style import Mark
from seft_ros.drawing.table import Cell, TextTable

ROWS = [["displacement", Cell("10.5 mm", Mark.BAD)], None, ["x force", "1516 N"]]


def terminal(table: TextTable, width: int = 80) -> str:
    stream = io.StringIO()
    Console(file=stream, width=width).print(table)
    return stream.getvalue()


def test_terminal_and_page_show_the_same_cells(tmp_path) -> None:
    table = TextTable(("", "peak"), ROWS)
    page.write_page(tmp_path / "page.html", "", "", [page.PageSection("one", [table])])
    html, text = (tmp_path / "page.html").read_text(), terminal(table)
    for cell in ("peak", "displacement", "10.5 mm", "x force", "1516 N"):
        assert f">{cell}</t" in html
        assert cell in text
    assert '<td class="bad">10.5 mm</td>' in html
    assert html.count("<tbody>") == 2
    assert text.count("├") == 1  # a line between the sections


def test_without_headings_names_and_values_are_lines() -> None:
    assert terminal(TextTable((), ROWS)).splitlines() == [
        "displacement: 10.5 mm",
        "x force: 1516 N",
    ]


def test_what_is_too_wide_is_folded_and_not_cut_off() -> None:
    words = [[f"row-{index}-{'w' * 30}", "v" * 60] for index in range(3)]
    text = terminal(TextTable(("h" * 40, "peak"), words))
    assert max(map(len, text.splitlines())) <= 80
    assert "…" not in text
    assert [text.count(letter) for letter in "hv"] == [40, 180]


def test_a_list_of_nothing_is_nothing() -> None:
    assert terminal(TextTable((), [])) == ""
    assert [*TextTable(("a",), [None, None]).sections()] == []
