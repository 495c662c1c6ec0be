"""Export of 3-D views as self-contained web pages: glTF, rendered by the three.js of trimesh."""

from __future__ import annotations

import base64
import json
import re
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from .._html import joined, tag
from ..errors import MissingExtraError
from .gltf import glb
from .stages import legend_entries, pyvista

if TYPE_CHECKING:
    from pyvista import Plotter

STEPS = 32  # colours in a colour bar
TICKS = 5  # labels of a colour bar
LAST = "THREE.GLTFLoader=GLTFLoader;})();"  # end of the libraries in trimesh's own page


def html_page(plotter: Plotter) -> str:
    """Return the text of a web page that shows a 3-D view interactively.

    Parameters
    ----------
    plotter : pyvista Plotter
        3-D view to show, for example from `scene_3d`. The page shows its title, its surfaces and
        lines, and below them its legend and colour bars.

    Returns
    -------
    str
        Text of one HTML file that loads nothing from the network. The browser renders the view,
        which is turned by mouse, touch or arrow keys.

    Raises
    ------
    MissingExtraError
        If pyvista is not installed, or the installed trimesh lacks its viewer.

    See Also
    --------
    save : Writes the page to a file with the suffix ``.html``.
    """
    title = plotter.title if getattr(plotter, "title", "") else "Scene in 3-D"
    legend = legend_entries(plotter)
    bars = [_bar(bar_title, bar) for bar_title, bar in plotter.scalar_bars.items()]
    camera = plotter.camera
    near, far = camera.clipping_range
    width, height = plotter.window_size
    room = {
        "position": list(camera.position),
        "focus": list(camera.focal_point),
        "up": list(camera.up),
        "angle": camera.view_angle,
        "aspect": width / height,
        "near": near / 20,
        "far": 20 * far,
        "glb": base64.b64encode(glb(plotter)).decode(),
    }
    names = ", ".join(name for name in legend)
    about = [f"{bar['title']}: {bar['ticks'][0]} to {bar['ticks'][-1]}" for bar in bars]
    filled = {
        "TITLE": joined([title]),
        "BACKGROUND": plotter.background_color.hex_rgb,
        "DESCRIPTION": joined(["; ".join(filter(None, [title, names, *about]))]),
        "CAPTION": "\n".join([_legend(legend), *(_bar_html(bar) for bar in bars)]),
        "VIEWER": f"<script>{_three()}</script>",
        # escaped, so that no actor's name can end the script element
        "ROOM": json.dumps(room).replace("<", "\\u003c"),
    }
    page = files(__package__).joinpath("room_page.html").read_text(encoding="utf-8")
    return re.sub(r"@([A-Z]+)@", lambda found: filled[found[1]], page)


def _three() -> str:
    """Return three.js with its trackball controls and glTF loader, from trimesh's own page."""
    from trimesh import resources, util

    try:
        archive: Any = util.decompress(resources.get_bytes("templates/viewer.zip"), file_type="zip")
        text = archive["viewer.html.template"].read().decode("utf-8")
        _, opened, script = text.partition("<script>")
        libraries, ended, _ = script.partition(LAST)
        if not opened or not ended:
            raise KeyError(LAST)
    except (KeyError, OSError, ValueError):
        raise MissingExtraError(
            "the installed trimesh lacks the viewer that HTML pages need; run pip install "
            "'trimesh>=4.5,<6', or write .glb or .png"
        ) from None
    return str(libraries + ended)


def _bar(title: str, bar: Any) -> dict[str, Any]:
    """Return title, colours and tick labels of a colour bar."""
    table = bar.GetLookupTable()
    low, high = table.GetRange()
    logarithmic = bool(table.UsingLogScale()) and low > 0.0
    # a bar with custom labels has one colour per label
    named = pyvista().convert_array(bar.GetCustomLabels()) if bar.GetUseCustomLabels() else ()
    steps = len(named) or STEPS
    at = (np.arange(steps) + 0.5) / steps
    ends = np.arange(TICKS) / (TICKS - 1)
    if logarithmic:
        values, marks = (low * (high / low) ** share for share in (at, ends))
    else:
        values, marks = (low + (high - low) * share for share in (at, ends))
    colours = []
    for value in values.tolist():
        rgb = [0.0, 0.0, 0.0]
        table.GetColor(value, rgb)
        colours.append(pyvista().Color(rgb).hex_rgb)
    return {
        "title": title,
        "colours": colours,
        "ticks": [_number(float(mark)) for mark in (named if len(named) else marks)],
        "steps": len(named) > 0,
    }


def _number(value: float) -> str:
    """Format a tick label with three digits."""
    return f"{value:.3g}"


def _legend(entries: dict[str, Any]) -> str:
    """Return the legend as an HTML list; empty without entries."""
    rows = [
        tag("li", tag("span", style=f"background: {colour}"), name)
        for name, colour in entries.items()
    ]
    return tag("ul", *rows) if rows else ""


def _bar_html(bar: dict[str, Any]) -> str:
    """Return a colour bar of `_bar` as HTML."""
    cells = [tag("i", style=f"background: {colour}") for colour in bar["colours"]]
    ticks = [tag("span", tick) for tick in bar["ticks"]]
    return tag(
        "div",
        bar["title"],
        tag("div", *cells, class_="colours"),
        tag("div", *ticks, class_="ticks middle" if bar["steps"] else "ticks"),
        class_="bar",
    )
