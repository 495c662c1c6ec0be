"""HTML: escaping in one place, tables, and the notebook representation of result objects.

In a notebook an object is shown as a small picture next to a table of figures. Text uses the
notebook's colours, light or dark; pictures have a white background.
"""

from __future__ import annotations

import base64
import html
import importlib
from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from typing import Any, NamedTuple

from .errors import NlosError

#: Module that draws the pictures. It depends on all result classes, so it is imported by name and
#: only when a card is shown. This is the only reference from a lower layer to a higher one.
CARDS = f"{__package__}.views.cards"


class Html(str):
    """Text that is valid HTML; `tag` escapes all other text."""

    __slots__ = ()


def tag(name: str, *children: object, **attributes: object) -> Html:
    """Build an HTML element such as ``"p"``.

    Of its contents, `Html` is inserted unchanged, None is skipped, and all else becomes escaped
    text. Attributes have ``class_`` for ``class`` and ``aria_label`` for ``aria-label``; True gives
    an attribute without value, and None leaves it out.
    """
    opened = name
    for key, value in attributes.items():
        if value is not None:
            key = key.rstrip("_").replace("_", "-")
            opened += f" {key}" if value is True else f' {key}="{html.escape(str(value))}"'
    empty = name in ("img", "source", "meta", "br")
    return Html(f"<{opened}>" if empty else f"<{opened}>{joined(children)}</{name}>")


def joined(children: Iterable[object]) -> Html:
    """Concatenate pieces; text is escaped, `Html` is not."""
    return Html(
        "".join(
            child if isinstance(child, Html) else html.escape(str(child))
            for child in children
            if child is not None
        )
    )


def png(data: bytes) -> str:
    """Return a PNG as a data URL."""
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"


class Column(NamedTuple):
    """Head of a table column; ``kind`` is "number" for aligned numbers."""

    head: str
    kind: str | None = None


def table(
    caption: str,
    columns: Sequence[Column],
    rows: Iterable[Sequence[object]],
    *,
    styled: bool = False,
) -> Html:
    """Build a table in which the first cell of each row is the row's head.

    Cells are contents for `tag`. If all heads are empty, the table has no head row. ``styled`` adds
    inline styles, for pages without a style sheet.
    """
    cell = "text-align:left;vertical-align:top" if styled else None
    above = "caption-side:top;text-align:left;color:inherit;font-weight:bold" if styled else None
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
        tag("caption", caption, style=above),
        tag("thead", tag("tr", *heads)) if any(column.head for column in columns) else None,
        tag("tbody", *body),
    )


class Figures(NamedTuple):
    """Texts of an object's notebook card."""

    title: str  # such as "Speckle image"
    rows: Mapping[str, str]  # names and values of the table
    alt: str  # description of the picture


class Shown:
    """Base of classes with a notebook card: they provide the texts, `CARDS` the picture."""

    def _figures(self) -> Figures:
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return card(self)

    def plot(self) -> Any:
        """Draw the object, as its notebook card does; returns the axes of matplotlib.

        `nlosoptics.views` has functions with options.
        """
        return importlib.import_module(CARDS).axes(self)

    def summary(self) -> str:
        """Return the key figures of the object as lines of text."""
        title, rows, _ = self._figures()
        width = max(map(len, rows), default=0)
        return "\n".join([title, *(f"{name:<{width}}  {text}" for name, text in rows.items())])


def card(noun: Shown) -> Html:
    """Return an object's picture and figures; text only if drawing fails, as without matplotlib."""
    title, rows, alt = noun._figures()
    try:
        source = png(_picture(importlib.import_module(CARDS).axes(noun)))
    except NlosError as error:
        return tag("pre", f"{noun.summary()}\n{error}")
    told = table(title, (Column(""), Column("")), rows.items(), styled=True)
    return tag(
        "div",
        tag("img", alt=alt, src=source, style="max-width:100%;height:auto"),
        tag("div", told, style="flex:1 1 22em"),
        style="display:flex;flex-wrap:wrap;gap:1em;align-items:flex-start",
    )


def _picture(axes: Any) -> bytes:
    """Render the figure of some axes as a small PNG."""
    from PIL import Image

    first = axes if hasattr(axes, "get_figure") else next(iter(axes))
    figure = first.get_figure(root=True)
    drawn = BytesIO()
    figure.savefig(drawn, format="png", dpi=330 / figure.get_size_inches()[1])
    if len(drawn.getvalue()) > 40_000:  # reduced to a palette
        picture = Image.open(drawn).convert("RGB")
        drawn = BytesIO()
        covered = picture.quantize(96, method=Image.Quantize.MAXCOVERAGE)
        covered.save(drawn, format="png", optimize=True)
    return drawn.getvalue()
