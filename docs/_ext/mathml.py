"""Formulas as MathML, which browsers draw by themselves: no script and nothing to fetch.

The font, STIX Two Math, comes from the package ziamath and is copied into the site.
"""

import shutil
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

FONT = files("ziamath") / "fonts" / "STIXTwoMath-Regular.ttf"


def visit_inline(writer: Any, node: nodes.math) -> None:
    """Write a formula within a line."""
    writer.body.append(convert(node.astext()))
    raise nodes.SkipNode


def visit_block(writer: Any, node: nodes.math_block) -> None:
    """Write a formula on lines of its own, which may scroll on a narrow screen."""
    name = node["ids"][0] if node["ids"] else ""
    opening = (
        f'<div class="formula" id="{name}" tabindex="0">'
        if name
        else '<div class="formula" tabindex="0">'
    )
    writer.body.append(opening + convert(node.astext(), display="block") + "</div>\n")
    raise nodes.SkipNode


def copy_font(app: Sphinx, error: Exception | None) -> None:
    """Put the font beside the style sheet."""
    if error is None and app.builder.format == "html":
        with as_file(FONT) as source:
            shutil.copy(source, Path(app.outdir) / "_static" / FONT.name)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.connect("build-finished", copy_font)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
