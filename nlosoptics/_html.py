"""HTML: text that is escaped once, tables, and what nouns show in a notebook.

There it is a small picture beside a table of figures. Colours and backgrounds are the notebook's
own, light or dark; pictures bring their white paper.
"""

from __future__ import annotations

import base64
import html
import importlib
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from typing import Any, NamedTuple

from .errors import NlosError

#: The registry of pictures. It stands above all nouns, so that it is looked up by name, when a card
#: is shown and not before: the only look from a lower part of the package into a higher one.
CARDS = f"{__package__}.views.cards"
VOID = ("img", "source", "meta", "br")
HEIGHT = 330  # pixels of a picture
MOST_BYTES = 40_000  # of a picture, beyond which it is given a palette
COLOURS = 96  # of that
CELL = "text-align:left;vertical-align:top"
CAPTION = "caption-side:top;text-align:left;color:inherit;font-weight:bold"


class Html(str):
    """Text that is HTML already; `tag` escapes every other."""

    __slots__ = ()


def tag(name: str, *children: object, **attributes: object) -> Html:
    """Element of HTML.

    Parameters
    ----------
    name : str
    *children : object
        Its contents: `Html` as it is, None for nothing, all else as escaped text.
    **attributes : object
        ``class_`` stands for ``class``, ``aria_label`` for ``aria-label``; True for a bare one,
        None for none.

    Returns
    -------
    Html
    """
    opened = name
    for key, value in attributes.items():
        if value is not None:
            key = key.rstrip("_").replace("_", "-")
            opened += f" {key}" if value is True else f' {key}="{html.escape(str(value))}"'
    return Html(f"<{opened}>" if name in VOID else f"<{opened}>{joined(children)}</{name}>")


def joined(children: Iterable[object]) -> Html:
    """Pieces one after the other, escaped where they are text."""
    return Html(
        "".join(
            child if isinstance(child, Html) else html.escape(str(child))
            for child in children
            if child is not None
        )
    )


def png(data: bytes) -> str:
    """A PNG as an address that holds it."""
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"


class Column(NamedTuple):
    """Head of a table's column; ``kind`` is "number" where figures stand under one another."""

    head: str
    kind: str | None = None


def table(
    caption: str,
    columns: Sequence[Column],
    rows: Iterable[Sequence[object]],
    *,
    styled: bool = False,
) -> Html:
    """A table, the first cell of each row its head.

    Parameters
    ----------
    caption : str
    columns : sequence of Column
        Without any head, the table has no line of heads.
    rows : iterable of sequence
        As many cells as columns, as the contents of `tag`.
    styled : bool
        Whether elements bring their style, as where there is no style sheet.
    """
    cell = CELL if styled else None
    heads = [
        tag("th", column.head, scope="col", class_=column.kind, style=cell) for column in columns
    ]
    body = [
        tag(
            "tr",
            tag("th", first, scope="row", style=cell),
            *(
                tag("td", told, class_=column.kind, style=cell)
                for told, column in zip(rest, columns[1:], strict=True)
            ),
        )
        for first, *rest in rows
    ]
    return tag(
        "table",
        tag("caption", caption, style=CAPTION if styled else None),
        tag("thead", tag("tr", *heads)) if any(column.head for column in columns) else None,
        tag("tbody", *body),
    )


class Figures(NamedTuple):
    """Title, table and picture text of a noun's notebook card.

    Parameters
    ----------
    title : str
        What it is.
    rows : mapping of str to str
        Names and values of the table.
    alt : str
        What the picture beside it shows, in words.
    """

    title: str
    rows: Mapping[str, str]
    alt: str


class Shown:
    """Base of nouns that show themselves in notebooks: figures here, the picture by `CARDS`."""

    def _figures(self) -> Figures:
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return card(self)


def card(noun: Shown) -> Html:
    """Picture and figures of a noun; as text where it cannot be drawn, as without matplotlib."""
    title, rows, alt = noun._figures()
    try:
        source = png(_picture(importlib.import_module(CARDS).axes(noun)))
    except NlosError as error:
        width = max(map(len, rows), default=0)
        lines = [title, *(f"{name:<{width}}  {value}" for name, value in rows.items())]
        return tag("pre", "\n".join([*lines, str(error)]))
    told = table(title, (Column(""), Column("")), rows.items(), styled=True)
    return tag(
        "div",
        tag("img", alt=alt, src=source, style="max-width:100%;height:auto"),
        tag("div", told, style="flex:1 1 22em"),
        style="display:flex;flex-wrap:wrap;gap:1em;align-items:flex-start",
    )


def _picture(axes: Any) -> bytes:
    """The figure of axes as a small PNG."""
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
    return drawn.getvalue()
