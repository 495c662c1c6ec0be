"""Assembly of the report page."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from string import Template

from .._checks import path_of
from .._html import Html, joined, tag
from ..errors import NlosError
from . import sections
from .folders import Folder
from .rooms import Room, room


def page(folder: str | Path, *, interactive: bool = True) -> str:
    """Make an HTML report of a run as a single file: key figures, pictures and provenance.

    Parameters
    ----------
    folder : str or Path
        Folder written by ``nlosoptics run``, ``reconstruct`` or ``phasor``.
    interactive : bool
        Whether to include a 3-D view of the scene that can be rotated. Light paths are traced for
        it. If the view cannot be drawn, the page states the reason instead.

    Returns
    -------
    str
        Text of an HTML file, which needs no other file and no network.

    Raises
    ------
    SceneError
        If the folder was not written by one of these commands, or a file in it cannot be read.

    See Also
    --------
    Folder : Contents of a run's folder.
    nlosoptics.views.overview : One figure of a whole run.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from nlosoptics import Scene, report, simulate
    >>> result = simulate(Scene.load("examples/scenes/letter_flat.toml").resized(32), tol=1e-2)
    >>> with TemporaryDirectory() as place:
    ...     result.save(f"{place}/letter")
    ...     text = report.page(f"{place}/letter", interactive=False)
    >>> text.startswith("<!DOCTYPE html>")
    True
    """
    held = Folder.read(path_of("folder", folder))
    parts = sections.parts(held, *_room(held, interactive))
    title = f"{held.name}, nlosoptics {held.record.command}"
    return assembled(title, sections.head(held), parts, sections.colophon())


def assembled(title: str, head: Html, parts: Sequence[sections.Part], footer: str) -> str:
    """Return the text of a page from its header and sections."""
    contents = [tag("li", tag("a", name, href=f"#{anchor}")) for anchor, name, _ in parts]
    body = joined(
        [
            tag("header", head, _contents(contents)),
            tag("main", *(part for _, _, part in parts)),
            tag("footer", tag("p", footer)),
        ]
    )
    place = files(__package__)
    return Template((place / "page.html").read_text(encoding="utf-8")).substitute(
        title=tag("title", title),
        style=(place / "style.css").read_text(encoding="utf-8"),
        body=body,
    )


def _contents(items: list[Html]) -> Html:
    return tag("nav", tag("ol", *items), aria_label="Contents")


def _room(held: Folder, interactive: bool) -> tuple[Room | None, str]:
    """Return the 3-D view, or None and the reason why it cannot be drawn."""
    if not interactive:
        return None, ""
    try:
        return room(held), ""
    except NlosError as error:
        return None, str(error)
