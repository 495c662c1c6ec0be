"""Docstrings are plain text first: what they leave unmarked is made ready for Sphinx here."""

import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import make_refnode

#: A literal, which stays, or a bar or star that docstrings mean as such.
MARKS = re.compile(r"(``.*?``)|\||\*(?=[A-Za-z])")


def resolve(
    app: Sphinx, environment: BuildEnvironment, node: pending_xref, text: nodes.TextElement
) -> nodes.Element | None:
    """Look up what stands in single backticks by its last parts, which are unique in this package.

    What is not found may be an argument, a file or a private module and stays code, as do the names
    of other packages, whose pages are not fetched. Other roles have to resolve, or Sphinx warns.
    """
    if node["reftarget"].startswith(("python:", "numpy:")):
        return nodes.inline("", text.astext().partition(":")[2] or text.astext())
    if (node.get("refdomain"), node.get("reftype")) != ("py", "obj"):
        return None
    objects = environment.domains.python_domain.objects
    ending = "." + node["reftarget"].removesuffix("()")
    found = [name for name in objects if name.endswith(ending) and not objects[name].aliased]
    if not found:
        return text
    name = min(found, key=lambda name: (name.count("."), len(name)))
    entry = objects[name]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, text, name)


def prepare(
    app: Sphinx, what: str, name: str, entry: object, options: object, lines: list[str]
) -> None:
    """Escape bars and stars, and leave out a subpackage's list of its private files."""
    if what == "module":
        lines[:] = lines[: next((i for i, line in enumerate(lines) if line.startswith("- ")), None)]
    lines[:] = [MARKS.sub(lambda m: m[1] or "\\" + m[0], line) for line in lines]


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect both, the second before numpydoc reads."""
    app.connect("missing-reference", resolve)
    app.connect("autodoc-process-docstring", prepare, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
