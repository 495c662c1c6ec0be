"""Write the pages of `docs/doors` as notebooks: ``python docs/notebooks.py``.

Python blocks become cells of code, commands of a console cells with ``!``, all else text. The
notebooks are in `examples/notebooks`; they have no outputs.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "examples" / "notebooks"
DOORS = ("camera", "instrument", "transient")
#: A block of Python or of commands.
BLOCK = re.compile(r"^```(python|console)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
#: A role of Sphinx, of which a notebook shows the text.
ROLE = re.compile(r"\{[\w:]+\}`~?(?:nlosoptics\.)?([^`<]+?)(?: <[^`]*>)?`")


def cells(page: str) -> list[tuple[str, str]]:
    """Return kind, "code" or "markdown", and text of each cell of a page of Markdown."""
    found, end = [], 0
    for block in BLOCK.finditer(page):
        found.append(("markdown", page[end : block.start()]))
        code = block[2]
        if block[1] == "console":
            code = re.sub(r"(?m)^\$ ", "!", re.sub(r"\\\n>? *", "", code))
        found.append(("code", code))
        end = block.end()
    found.append(("markdown", page[end:]))
    return [(kind, text.strip()) for kind, text in found if text.strip()]


def notebook(page: str) -> dict[str, Any]:
    """Return a page of Markdown as a notebook of the format 4.5."""
    made = []
    for number, (kind, text) in enumerate(cells(page)):
        if kind == "markdown":
            text = ROLE.sub(r"\1", text)
            text = re.sub(r"\]\(\.\./(?=figures)", "](../../docs/", text)
            text = re.sub(r"\]\(\.\./gallery/(\w+)\.rst\)", r"](../\1.py)", text)
            text = re.sub(r"\]\((?:\.\./)?([\w/]+\.md[^)]*)\)", r"](../../docs/\1)", text)
        cell = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": text}
        made.append(cell | ({"execution_count": None, "outputs": []} if kind == "code" else {}))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {
        "cells": made,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def texts() -> dict[Path, str]:
    """Return the files of all notebooks."""
    pages = {FOLDER / f"{name}.ipynb": ROOT / "docs" / "doors" / f"{name}.md" for name in DOORS}
    return {
        path: json.dumps(notebook(page.read_text()), indent=1, ensure_ascii=False) + "\n"
        for path, page in pages.items()
    }


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for path, text in texts().items():
        path.write_text(text)
        print(path.relative_to(ROOT))
