"""Writing of figures, films and 3-D views to files."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._checks import counted
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
    """Write a figure, film or 3-D view to a file in the format of its suffix.

    If writing fails, no partial file remains and an existing file is unchanged.

    Parameters
    ----------
    picture : matplotlib Figure, Axes, iterable of Axes or FuncAnimation, or pyvista Plotter
        Drawing to write, as the functions of ``nlosoptics.views`` return it. For axes, the whole
        figure to which they belong is written; several axes must belong to the same figure.
    path : str or Path
        File to write; its suffix selects the format. Figures: ``.png``, ``.pdf`` or ``.svg``. 3-D
        views: ``.png``, ``.html`` (an interactive page, see `html_page`) or ``.glb`` (glTF with
        surfaces, lines and camera, but no text). Films: ``.gif`` or ``.html`` (a page with a
        slider). HTML pages load nothing from the network.

    Raises
    ------
    SceneError
        If the suffix is not one of these, the axes belong to several figures, or the file cannot be
        written.
    MissingExtraError
        If a 3-D view is written as ``.png`` on a machine that cannot render, see
        `rendering_works`.

    See Also
    --------
    html_page : 3-D view as a web page.
    rendering_works : Whether this machine can render.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from nlosoptics import Scene, views
    >>> axes = views.scene_sketch(Scene.load("examples/scenes/letter_flat.toml"))
    >>> with TemporaryDirectory() as folder:
    ...     views.save(axes, Path(folder, "scene.svg"))
    ...     print([file.name for file in Path(folder).iterdir()])
    ['scene.svg']
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if hasattr(picture, "render_window"):
        _checked_suffix(path, "a 3-D view", (".png", ".html", ".glb"))
        content = _plotter_file(picture, suffix)
    elif hasattr(picture, "to_jshtml"):
        from .films import film_file

        _checked_suffix(path, "a film", (".gif", ".html"))
        content = film_file(picture, suffix)
    else:
        _checked_suffix(path, "a figure", (".png", ".pdf", ".svg"))
        content = figure_file(picture, suffix)
    write_whole({path: content})


def _checked_suffix(path: Path, what: str, known: tuple[str, ...]) -> None:
    """Raise SceneError if the suffix of a path is not among the known ones."""
    if path.suffix.lower() not in known:
        raise SceneError(
            f"{path} has the suffix {path.suffix!r}, must be one of {', '.join(known)} for {what}; "
            "rename the file"
        )


def figure_file(picture: Any, suffix: str) -> bytes:
    """Return the figure of axes as the bytes of a file."""
    parts = [picture] if hasattr(picture, "get_figure") else list(picture)
    figures = {part.get_figure(root=True) for part in parts}  # a figure is its own root
    if len(figures) != 1:
        raise SceneError(
            f"picture has axes of {counted(len(figures), 'figure')}, one file holds one; save each "
            "figure by itself"
        )
    from matplotlib import rc_context

    (figure,) = figures
    content = BytesIO()
    # without program name, date and random identifiers, equal figures give equal bytes
    metadata = {".png": {"Software": None}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
    with rc_context({"svg.hashsalt": "nlosoptics"}):
        if suffix == ".png" and _drawn_once(figure):
            figure.canvas.print_png(content, metadata=metadata[suffix])
        else:
            figure.savefig(content, format=suffix[1:], metadata=metadata[suffix])
    return content.getvalue()


def _drawn_once(figure: Any) -> bool:
    """Return whether the canvas of a figure can write the PNG that `savefig` would write.

    `savefig` draws a figure twice, the first time only to place its axes. The canvas places and
    draws them at once, but reads none of matplotlib's settings for saving.
    """
    from matplotlib import rcParams, rcParamsDefault

    from .canvas import drawing_classes

    # by name, since reading all settings would load pyplot
    saving = [name for name in rcParamsDefault if name.startswith("savefig.")]
    return type(figure.canvas) is drawing_classes()[1] and all(
        rcParams[name] == rcParamsDefault[name] for name in saving
    )


def _plotter_file(plotter: Any, suffix: str) -> bytes:
    """Return a 3-D view as the bytes of a file."""
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
