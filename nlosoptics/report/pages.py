"""Assembly of the report page."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from string import Template

from .. import __version__
from .._checks import path_of, reason
from .._html import joined, tag
from ..errors import NlosError, SceneError
from . import runs, studies


def page(folder: str | Path, *, computed: bool = True) -> str:
    """Make an HTML report of a run or a design study as a single file.

    Parameters
    ----------
    folder : str or Path
        Folder written by ``nlosoptics run``, ``reconstruct`` or ``image``, or with the results of
        a study (the store), complete or not.
    computed : bool
        Whether to add what is computed for the page: for a run, a 3-D view that can be rotated,
        for which light paths are traced; for a study, the point spread functions of its worst,
        median and best point. If something cannot be drawn, the page states the reason instead.

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
    nlosoptics.load_result : Read a saved result.
    nlosoptics.study.Results : Results of a study.
    nlosoptics.views.overview : One figure of a whole run.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from nlosoptics import Scene, report, simulate
    >>> result = simulate(Scene.load("examples/scenes/letter_flat.toml").resized(32), tol=1e-2)
    >>> with TemporaryDirectory() as place:
    ...     result.save(f"{place}/letter")
    ...     text = report.page(f"{place}/letter", computed=False)
    >>> text.startswith("<!DOCTYPE html>")
    True
    """
    path = path_of("folder", folder)
    if (path / "zarr.json").exists():
        title, head, parts = studies.contents(path, computed)
    else:
        record = read_record(path)
        try:
            title, head, parts = runs.contents(path, record, computed)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            if isinstance(error, NlosError):
                raise
            raise SceneError(
                f"{path / 'result.json'} does not have the form that nlosoptics {__version__} "
                f"writes ({reason(error)}); run the command again"
            ) from None
    links = [tag("li", tag("a", name, href=f"#{anchor}")) for anchor, name, _ in parts]
    made = f"Made by nlosoptics report {__version__}. This file is complete and loads nothing else."
    body = joined(
        [
            tag("header", head, tag("nav", tag("ol", *links), aria_label="Contents")),
            tag("main", *(part for _, _, part in parts)),
            tag("footer", tag("p", made)),
        ]
    )
    place = files(__package__)
    return Template((place / "page.html").read_text(encoding="utf-8")).substitute(
        title=tag("title", title),
        style=(place / "style.css").read_text(encoding="utf-8"),
        body=body,
    )


def read_record(folder: Path) -> dict[str, object]:
    """Return the contents of ``result.json`` in a folder.

    Raises
    ------
    SceneError
        If there is none, or it was not written by ``nlosoptics run``, ``reconstruct`` or
        ``image``.
    """
    remedy = "name the output folder of nlosoptics run, reconstruct or image"
    if not folder.is_dir():
        raise SceneError(f"{folder} is {'no folder' if folder.exists() else 'missing'}; {remedy}")
    path = folder / "result.json"
    try:
        record = json.loads(path.read_bytes())
    except OSError:
        raise SceneError(f"{folder} holds no result.json that can be read; {remedy}") from None
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{path} is no JSON ({reason(error)}); {remedy}") from None
    if not isinstance(record, dict) or record.get("command") not in runs.COMMANDS:
        raise SceneError(f"{path} names no command of nlosoptics that has a report; {remedy}")
    return record
