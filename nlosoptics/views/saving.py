"""Pictures into files: figures, films and views in 3-D, by the suffix of the file's name."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._whole_files import write_whole
from ..errors import SceneError

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pyvista import Plotter


def save(
    picture: Figure | Axes | Iterable[Axes] | Plotter | FuncAnimation, path: str | Path
) -> None:
    """Write a picture to a file, whose suffix names the format; the file appears whole or not.

    Parameters
    ----------
    picture : matplotlib Figure, Axes, iterable of Axes or FuncAnimation, or pyvista Plotter
        What to write; the whole figure that the axes belong to.
    path : str or Path
        ``.png``, ``.pdf`` or ``.svg`` of figures; ``.png``, ``.html`` or ``.glb`` of plotters. The
        HTML page is that of `html_page`; glTF holds surfaces, lines and camera, and no text.
        ``.gif`` or ``.html``, a page with a slider, of films. No page asks anything of the net.

    Raises
    ------
    SceneError
        If the suffix names no such format, or the file cannot be written.
    MissingExtraError
        If a PNG of a plotter is wanted where nothing can be rendered, see `rendering_works`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if hasattr(picture, "render_window"):
        _checked_suffix(path, "a picture in 3-D", (".png", ".html", ".glb"))
        content = _plotter_file(picture, suffix)
    elif hasattr(picture, "to_jshtml"):
        from .films import film_file

        _checked_suffix(path, "a film", (".gif", ".html"))
        content = film_file(picture, suffix)
    else:
        _checked_suffix(path, "a figure", (".png", ".pdf", ".svg"))
        content = _figure_file(picture, suffix)
    write_whole({path: content})


def _checked_suffix(path: Path, what: str, known: tuple[str, ...]) -> None:
    if path.suffix.lower() not in known:
        raise SceneError(
            f"{path} has the suffix {path.suffix!r}; {what} is written as {', '.join(known)}"
        )


def _figure_file(picture: Any, suffix: str) -> bytes:
    if not hasattr(picture, "get_figure"):
        picture = next(iter(picture))
    from matplotlib import rc_context

    figure = picture.get_figure(root=True)  # a figure is its own root
    content = BytesIO()
    # no program's name, no date and no names drawn at random: equal pictures give equal bytes
    metadata = {".png": {"Software": None}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    with rc_context({"svg.hashsalt": "nlosoptics"}):
        figure.savefig(content, format=suffix[1:], metadata=metadata[suffix])
    return content.getvalue()


def _plotter_file(plotter: Any, suffix: str) -> bytes:
    if suffix == ".glb":
        from .gltf import glb

        return glb(plotter)
    if suffix == ".html":
        from .pages import html_page

        return html_page(plotter).encode()
    from PIL import Image

    from .stages import quiet, rendering_works

    rendering_works()
    with quiet():
        shot = plotter.screenshot(None, return_img=True)
    content = BytesIO()
    Image.fromarray(shot).save(content, format="PNG")
    return content.getvalue()
