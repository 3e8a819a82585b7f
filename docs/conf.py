"""The pages as HTML, by `make docs`: every link between them and into the code is checked."""

from pathlib import Path

from docutils.nodes import SkipNode, math, math_block
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from seft_ros.cli.show_commands import parameters_text
from sphinx.application import Sphinx
from sphinx.util.logging import getLogger
from sphinx.writers.html5 import HTML5Translator

LOGGER = getLogger(__name__)

project = "seft"
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc", "sphinxcontrib.mermaid"]

# The source is the repository's folder, so that links lead where they lead on GitHub.
root_doc = "docs/index"
include_patterns = ["README.md", "CHANGELOG.md", "docs/*.md", "examples/*/README.md"]
exclude_patterns = [".*", "bags", "build", "src", "tests"]
nitpicky = True

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_fence_as_directive = ["mermaid"]
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings have types, shapes and units
numpydoc_show_class_members = False
default_role = "literal"

html_theme = "furo"
html_title = "seft"
html_math_renderer = "mathml"
html_copy_source = False
html_show_copyright = False


def write_mathml(translator: HTML5Translator, node: math | math_block) -> None:
    """Write a formula as MathML, which browsers draw without a network."""
    block = isinstance(node, math_block)
    try:
        formula = tex2mathml(node.astext(), as_block=block)
    except MathError as error:
        LOGGER.warning("formula: %s", error, location=node)
        raise SkipNode from None
    # with room about it, or the theme's frame scrolls
    translator.body.append(f'<div style="padding: 0.4em">{formula}</div>' if block else formula)
    raise SkipNode


def write_parameters(app: Sphinx) -> None:
    """Write the page of all parameters."""
    text = parameters_text()
    page = Path(app.srcdir) / "docs" / "parameters.md"
    page.write_text(f"# All parameters\n\nMade by `seft parameters`.\n\n{text}\n", "utf-8")


def setup(app: Sphinx) -> None:
    """Make MathML known to Sphinx, and pages that are not written by hand."""
    app.connect("builder-inited", write_parameters)
    app.add_html_math_renderer("mathml", (write_mathml, None), (write_mathml, None))
