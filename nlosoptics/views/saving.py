"""Writing of figures and 3-D views to files."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._checks import counted, expect, path_of
from .._whole_files import write_whole
from ..errors import SceneError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pyvista import Plotter


def save(picture: Figure | Axes | Iterable[Axes] | Plotter, path: str | Path) -> None:
    """Write a figure or 3-D view to a file in the format of its suffix.

    If writing fails, no partial file remains and an existing file is unchanged.

    Parameters
    ----------
    picture : matplotlib Figure, Axes or iterable of Axes, or pyvista Plotter
        Drawing to write, as the functions of ``nlosoptics.views`` return it. For axes, the whole
        figure to which they belong is written; several axes must belong to the same figure.
    path : str or Path
        File to write; its suffix selects the format. Figures: ``.png``, ``.pdf`` or ``.svg``. 3-D
        views: ``.png``, ``.html`` (a page in which the view can be turned, and which loads nothing
        from the network) or ``.glb`` (glTF with surfaces, lines and camera, but no text).

    Raises
    ------
    SceneError
        If the suffix is not one of these, the axes belong to several figures, or the file cannot be
        written.
    MissingExtraError
        If a 3-D view is written as ``.png`` on a machine that cannot render.

    See Also
    --------
    scene_3d : 3-D view of a scene.
    overview : One figure of a whole run.

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
    path = path_of("path", path)
    suffix = path.suffix.lower()
    is_view = hasattr(picture, "render_window")
    known = (".png", ".html", ".glb") if is_view else (".png", ".pdf", ".svg")
    if suffix not in known:
        raise SceneError(
            f"{path} has the suffix {path.suffix!r}, must be one of {', '.join(known)} for a "
            f"{'3-D view' if is_view else 'figure'}; rename the file"
        )
    content = plotter_file(picture, suffix) if is_view else figure_file(picture, suffix)
    write_whole({path: content})


def figure_file(picture: Any, suffix: str = ".png") -> bytes:
    """Return the figure of axes as the bytes of a file."""
    from matplotlib import rc_context

    single = hasattr(picture, "get_figure") or not isinstance(picture, Iterable)
    parts = [picture] if single else list(picture)
    for part in parts:
        expect("picture", part, "Figure", "Axes")
    figures = {part.get_figure(root=True) for part in parts}  # a figure is its own root
    if len(figures) != 1:
        raise SceneError(
            f"picture has axes of {counted(len(figures), 'figure')}, one file holds one; save each "
            "figure by itself"
        )
    # without program name, date and random identifiers, equal figures give equal bytes
    anonymous = {".png": "Software", ".pdf": "CreationDate", ".svg": "Date"}
    content = BytesIO()
    with rc_context({"svg.hashsalt": "nlosoptics"}):
        figures.pop().savefig(content, format=suffix[1:], metadata={anonymous[suffix]: None})
    return content.getvalue()


def plotter_file(plotter: Any, suffix: str) -> bytes:
    """Return a 3-D view as the bytes of a file."""
    if suffix == ".glb":
        from .room_files import model

        return bytes(model(plotter).export(file_type="glb"))
    if suffix == ".html":
        from .room_files import html_page

        return html_page(plotter).encode()
    from PIL import Image

    from .stages import quiet, rendering_works

    rendering_works()
    with quiet():
        shot = plotter.screenshot(None, return_img=True)
    content = BytesIO()
    Image.fromarray(shot).save(content, format="PNG")
    return content.getvalue()
