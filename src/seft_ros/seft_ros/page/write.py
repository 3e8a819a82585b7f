"""Write a page as one HTML file that needs nothing else."""

import re
from collections.abc import Sequence
from pathlib import Path

from bokeh.embed import components
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined
from seft_msgs_py.errors import InputError

from seft_ros.page.content import Plot, Section

SUFFIX = ".html"


def write_page(path: Path, title: str, subtitle: str, sections: Sequence[Section]) -> None:
    """Write a page; figures, the library that draws them, and styles are inside the file.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    figures = {
        f"{place}-{index}": block.figure
        for place, section in enumerate(sections)
        for index, block in enumerate(section.blocks)
        if isinstance(block, Plot)
    }
    script, places = components(figures) if figures else ("", {})
    library = Resources(mode="inline", components=["bokeh"]).render_js() if figures else ""
    environment = Environment(
        loader=PackageLoader("seft_ros.page", "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    text = environment.get_template("page.html").render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        anchors=[_anchor(section.title) for section in sections],
        library=library,
        script=script,
        places=places,
    )
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: the page can't be written ({error.strerror})") from None


def check_page(path: Path) -> Path:
    """Complete the name of a page's file, before the work is done that it is to show.

    Raises
    ------
    InputError
        If there is no such folder, or it is the name of another kind of file.
    """
    path = path if path.suffix else path.with_suffix(SUFFIX)
    if path.suffix.lower() not in (SUFFIX, ".htm"):
        raise InputError(f"{path}: pages end in {SUFFIX}")
    if not path.parent.is_dir() or path.is_dir():
        what = "is a folder" if path.is_dir() else f"there is no folder {path.parent}"
        raise InputError(f"{path}: {what}; name a file in a folder that exists")
    return path


def _anchor(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
