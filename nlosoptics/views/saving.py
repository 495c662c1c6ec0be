"""Writing of figures, films and 3-D views to files."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import counted, path_of
from .._whole_files import write_whole
from ..errors import SceneError
from .canvas import label_box, place_axes

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pyvista import Plotter

    #: Axes of each file that shows a figure, the first one, or a part of it.
    Panels = Mapping[str, Sequence[Axes]]

#: Metadata of files: without program name, date and random identifiers, equal figures give equal
#: bytes.
METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}
COMPRESSION = 3  # of PNG files: half of the time of the usual level 6, and files as small
MARGIN = 8.0  # pixels around the labels of axes that are cut out


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
    path = path_of("path", path)
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
    from matplotlib import rc_context

    figure = _figure_of([picture] if hasattr(picture, "get_figure") else list(picture))
    if suffix == ".png" and _drawn_once(figure):
        figure.canvas.draw()
        return _png(figure)
    content = BytesIO()
    with rc_context({"svg.hashsalt": "nlosoptics"}):
        figure.savefig(content, format=suffix[1:], metadata=METADATA[suffix])
    return content.getvalue()


def _figure_of(parts: Iterable[Any]) -> Any:
    """Return the figure to which all of several axes belong."""
    figures = {part.get_figure(root=True) for part in parts}  # a figure is its own root
    if len(figures) != 1:
        raise SceneError(
            f"picture has axes of {counted(len(figures), 'figure')}, one file holds one; save each "
            "figure by itself"
        )
    return figures.pop()


def panel_files(panels: Panels) -> dict[str, bytes]:
    """Draw a figure once; return it and some of its axes, with their labels, as PNG files.

    Parameters
    ----------
    panels : mapping of str to sequence of Axes
        Axes of each file. The first file shows the whole figure.

    Returns
    -------
    dict of str to bytes
        Files by the same names.
    """
    whole, *_ = panels
    content = figure_file(panels[whole], ".png")
    figure = _figure_of(panels[whole])
    if len(panels) > 1 and not _drawn_once(figure):
        figure.canvas.draw()
    return {whole: content, **{name: _png(figure, box) for name, box in _boxes(panels).items()}}


def _boxes(panels: Panels) -> dict[str, tuple[slice, slice]]:
    """Return rows and columns of the pixels of all panels but the first."""
    from matplotlib.transforms import Bbox

    found = {}
    for name, axes in list(panels.items())[1:]:
        figure = _figure_of(axes)
        labelled: list[Any] = [each.get_tightbbox() for each in axes]
        box = Bbox.union(labelled).padded(MARGIN)
        wide, high = figure.canvas.get_width_height()
        rows = slice(max(int(high - box.y1), 0), min(math.ceil(high - box.y0), high))
        columns = slice(max(int(box.x0), 0), min(math.ceil(box.x1), wide))
        found[name] = rows, columns
    return found


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


def _png(figure: Any, part: Any = ...) -> bytes:
    """Return pixels that the canvas of a figure has drawn as a PNG file, by default all."""
    from PIL import Image

    pixels = np.asarray(figure.canvas.buffer_rgba())[part]
    if (pixels[..., 3] == 255).all():
        pixels = pixels[..., :3]
    content = BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(
        content, format="png", dpi=(figure.dpi, figure.dpi), compress_level=COMPRESSION
    )
    return content.getvalue()


class GrowingFigure:
    """Figure whose axes are drawn one after the other, each as soon as its contents are known.

    The axes have the places that a layout tries first where there are colour bars. The files have
    the same bytes as those of `panel_files`.

    Parameters
    ----------
    axes : sequence of Axes
        All axes of the figure, empty.
    """

    def __init__(self, axes: Sequence[Axes]) -> None:
        self._figure: Any = _figure_of(axes)
        self._layout = self._figure.get_layout_engine()
        self._layout.begin(bars=True)
        place_axes(self._figure, self._layout.space)
        self._renderer = self._figure.canvas.get_renderer()
        self._figure.patch.draw(self._renderer)
        self._measured: dict[Any, Any] = {}

    def draw(self, axes: Iterable[Axes]) -> None:
        """Draw axes, once."""
        for each in axes:
            self._measured[each] = label_box(each)
            each.draw(self._renderer)

    def awaiting(self, panels: Panels, late: Axes | None) -> Callable[[], dict[str, bytes] | None]:
        """Prepare files while the contents of the last axes are awaited.

        Parameters
        ----------
        panels : mapping of str to sequence of Axes
            Axes of each file, see `panel_files`.
        late : Axes, optional
            Axes that are not drawn yet. Their labels will take as much space as now.

        Returns
        -------
        callable
            Draws the last axes and returns the files; None if labels do not fit their places.
        """
        if late is not None:
            self._measured[late] = label_box(late)
        figure, (whole, *_) = self._figure, panels
        fit = self._layout.misfit(figure, self._measured) is None and _drawn_once(figure)
        boxes = _boxes(panels)
        early = {
            name: _png(figure, boxes.pop(name)) for name in [*boxes] if late not in panels[name]
        }

        def files() -> dict[str, bytes] | None:
            if not fit:
                return None
            if late is not None:
                late.draw(self._renderer)
            parts = {name: _png(figure, box) for name, box in boxes.items()}
            return {whole: _png(figure), **early, **parts}

        return files


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
