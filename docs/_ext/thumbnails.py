"""Thumbnails of the gallery: one panel of a figure, large enough to be read."""

import shutil
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from PIL import Image, ImageOps
from sphinx.application import Sphinx
from sphinx_gallery.scrapers import matplotlib_scraper
from tables import ROOT

PANELS = ROOT / "docs" / "_generated" / "panels"
SIZE = (400, 280)  # pixels of the gallery's thumbnails


def scrape(block: Any, variables: dict[str, Any], gallery: dict[str, Any], **options: Any) -> str:
    """Keep the largest panel of a script's first picture, and let sphinx-gallery do the rest.

    Of panels of one size the last one is kept.
    """
    target = PANELS / f"{Path(variables['src_file']).stem}.png"
    is_first = not len(variables["image_path_iterator"])  # of the script's pictures
    if plt.get_fignums() and is_first:
        PANELS.mkdir(parents=True, exist_ok=True)
        figure = plt.figure(plt.get_fignums()[0])
        figure.draw_without_rendering()
        panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
        size = {axes: axes.bbox.width * axes.bbox.height for axes in panels}
        largest = max(size.values())
        panel = [axes for axes in panels if size[axes] > 0.9 * largest][-1]
        box = panel.get_tightbbox().transformed(figure.dpi_scale_trans.inverted())
        figure.savefig(target, bbox_inches=box, pad_inches=0.03, dpi=150)
    return str(matplotlib_scraper(block, variables, gallery, **options))


def replace(app: Sphinx) -> None:
    """Put the panels in the places of the gallery's own thumbnails."""
    for panel in PANELS.glob("*.png"):
        thumbnail = Path(app.srcdir) / "gallery/images/thumb" / f"sphx_glr_{panel.stem}_thumb.png"
        with Image.open(panel) as image:
            ImageOps.pad(image.convert("RGB"), SIZE, color="white").save(thumbnail)


def forget(app: Sphinx) -> None:
    """Remove the panels of a build before: the gallery runs only scripts that have changed."""
    shutil.rmtree(PANELS, ignore_errors=True)


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect `replace`, after the gallery has run its scripts."""
    app.connect("builder-inited", forget, priority=100)
    app.connect("builder-inited", replace, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
