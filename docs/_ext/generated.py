"""Pages and figures made anew at each build: drawings, materials, validation, performance."""

import builtins
from pathlib import Path
from typing import Any

import frames_figure
import layouts_figure
import materials_page
import notions_figure
import performance
import validation_page
from sphinx.application import Sphinx
from tables import ROOT


def make(app: Sphinx) -> None:
    """Write everything into ``_generated``, which pages include."""
    target = Path(app.srcdir) / "_generated"
    target.mkdir(exist_ok=True)
    figures = (frames_figure, layouts_figure, notions_figure)
    for part in (*figures, materials_page, validation_page, performance):
        part.pages(target)
    gather_scripts(target / "scripts")


def gather_scripts(folder: Path) -> None:
    """Link the gallery's scripts alone: README files of other examples would make sections."""
    folder.mkdir(exist_ok=True)
    for link in folder.iterdir():
        link.unlink()
    header = Path(__file__).parents[1] / "_templates" / "GALLERY_HEADER.rst"
    for path in (header, *(ROOT / "examples").glob("plot_*.py")):
        (folder / path.name).symlink_to(path)


def name_script(gallery: dict[str, Any], script: str) -> None:
    """Let a script know its file, by which it finds the scenes, as it does on its own."""
    builtins.__file__ = str(ROOT / "examples" / Path(script).name)  # type: ignore[attr-defined]


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect `make`, before the gallery looks for its scripts."""
    app.connect("builder-inited", make, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
