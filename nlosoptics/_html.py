"""What nouns show in a notebook: a small picture beside a table of figures.

Colours and backgrounds are the notebook's own, light or dark; pictures bring their white paper.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from io import BytesIO
from typing import Any

from .errors import NlosError

HEIGHT = 330  # pixels of a picture
MOST_BYTES = 40_000  # of a picture, beyond which it is given a palette
COLOURS = 96  # of that
CELL = ' style="text-align:left;vertical-align:top"'


def card(title: str, figures: Mapping[str, str], *, draw: Callable[[], Any], alt: str) -> str:
    """Picture and figures of a noun, as HTML.

    Parameters
    ----------
    title : str
        What it is.
    figures : mapping of str to str
        Names and values of the table.
    draw : callable
        Returns the matplotlib axes, or several of one figure, that show it. Where it raises an
        error of nlosoptics, as without matplotlib, all is told as text.
    alt : str
        What the picture shows, in words.
    """
    try:
        source = _picture(draw())
    except NlosError as error:
        width = max(map(len, figures), default=0)
        lines = [title, *(f"{name:<{width}}  {value}" for name, value in figures.items())]
        return f"<pre>{escape(chr(10).join([*lines, str(error)]))}</pre>"
    rows = "".join(
        f'<tr><th scope="row"{CELL}>{escape(name)}</th><td{CELL}>{escape(value)}</td></tr>'
        for name, value in figures.items()
    )
    beside = f"<table>{_caption(title)}<tbody>{rows}</tbody></table>"
    return (
        '<div style="display:flex;flex-wrap:wrap;gap:1em;align-items:flex-start">'
        f'<img alt="{escape(alt)}" src="{source}" style="max-width:100%;height:auto">'
        f'<div style="flex:1 1 22em">{beside}</div></div>'
    )


def table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Rows of text under a header, as HTML."""
    head = "".join(f'<th scope="col"{CELL}>{escape(name)}</th>' for name in header)
    body = "".join(
        f"<tr>{''.join(f'<td{CELL}>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return f"<table>{_caption(title)}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _caption(title: str) -> str:
    style = "caption-side:top;text-align:left;color:inherit;font-weight:bold"
    return f'<caption style="{style}">{escape(title)}</caption>'


def _picture(axes: Any) -> str:
    """The figure of axes as a small PNG in a data URI."""
    from PIL import Image

    first = axes if hasattr(axes, "get_figure") else next(iter(axes))
    figure = first.get_figure(root=True)
    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=HEIGHT / figure.get_size_inches()[1])
    if len(drawn.getvalue()) > MOST_BYTES:
        picture = Image.open(drawn).convert("RGB")
        drawn = BytesIO()
        covered = picture.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE)
        covered.save(drawn, format="png", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(drawn.getvalue()).decode()}"
