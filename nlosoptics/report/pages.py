"""The page: its parts in their order, in one file."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from string import Template

from .._html import Html, joined, tag
from ..errors import NlosError
from . import sections
from .folders import Folder
from .rooms import Room, room


def page(folder: str | Path, *, interactive: bool = True) -> str:
    """HTML page about a run, all in one file.

    Parameters
    ----------
    folder : str or Path
        What ``nlosoptics run``, ``reconstruct`` or ``phasor`` wrote.
    interactive : bool
        Also show the scene in three dimensions, with light traced anew; where it cannot be drawn,
        the page says why.

    Returns
    -------
    str
        The text of an HTML file that asks for nothing outside itself.

    Raises
    ------
    SceneError
        If the folder is none of these, or a file of it cannot be read.
    """
    held = Folder.read(Path(folder))
    parts = sections.parts(held, *_room(held, interactive))
    contents = [tag("li", tag("a", title, href=f"#{anchor}")) for anchor, title, _ in parts]
    body = joined(
        [
            tag("header", sections.head(held), _contents(contents)),
            tag("main", *(part for _, _, part in parts)),
            tag("footer", tag("p", sections.colophon())),
        ]
    )
    place = files(__package__)
    return Template((place / "page.html").read_text(encoding="utf-8")).substitute(
        title=tag("title", f"{held.name}, nlosoptics {held.record.command}"),
        style=(place / "style.css").read_text(encoding="utf-8"),
        body=body,
    )


def _contents(items: list[Html]) -> Html:
    return tag("nav", tag("ol", *items), aria_label="Contents")


def _room(held: Folder, interactive: bool) -> tuple[Room | None, str]:
    """The view in three dimensions, or why there is none."""
    if not interactive:
        return None, ""
    try:
        return room(held), ""
    except NlosError as error:
        return None, str(error)
