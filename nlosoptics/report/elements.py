"""Pieces of HTML: text that is escaped once, numbers with their units, figures and tables."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

VOID = ("img", "meta", "br")
PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NARROW = "\N{NARROW NO-BREAK SPACE}"


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


def number(value: float, digits: int = 3) -> str:
    """Number of so many digits, powers of ten written out: ``1.6 × 10⁻¹⁰``."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        text = f"{value:.{digits}g}"
        text = text if "e" not in text else f"{float(text):.0f}"
    else:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        raised = str(int(exponent)).translate(SUPERSCRIPTS)
        text = f"{float(mantissa):g}{NARROW}×{NARROW}10{raised}"
    return text.replace("-", "−")


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Number with an SI unit and the prefix that suits it: ``433 nm``."""
    rounded = float(f"{value:.{digits}g}")
    power = 0 if rounded == 0.0 else 3 * math.floor(math.log10(abs(rounded)) / 3)
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    return f"{number(rounded / 10.0**power, digits)}{NARROW}{PREFIXES[power]}{unit}"


def seconds(value: float) -> str:
    """Time that something took."""
    return f"{number(value)}{NARROW}s" if value >= 0.01 else f"< 0.01{NARROW}s"


def date(iso: str) -> str:
    """Date and time of a record."""
    return iso.replace("T", " ").replace("+00:00", " UTC")


def percent(share: float) -> str:
    """Share of a whole."""
    return f"{number(100.0 * share)}{NARROW}%"


def png(data: bytes) -> str:
    """A PNG as an address that holds it."""
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"


def figure(picture: object, *caption: object, class_: str | None = None) -> Html:
    """A picture with what it shows."""
    return tag("figure", picture, tag("figcaption", *caption), class_=class_)


def facts(rows: Iterable[tuple[object, object]], class_: str = "facts") -> Html:
    """Names and what they are; rows of None are left out."""
    held = [tag("div", tag("dt", name), tag("dd", told)) for name, told in rows if told is not None]
    return tag("dl", *held, class_=class_)


class Column(NamedTuple):
    """Head of a table's column; ``kind`` is "number" where figures stand under one another."""

    head: str
    kind: str | None = None


def table(caption: str, columns: Sequence[Column], rows: Iterable[Sequence[object]]) -> Html:
    """A table, the first cell of each row its head."""
    heads = [tag("th", column.head, scope="col", class_=column.kind) for column in columns]
    body = [
        tag(
            "tr",
            tag("th", first, scope="row"),
            *(
                tag("td", cell, class_=column.kind)
                for cell, column in zip(rest, columns[1:], strict=True)
            ),
        )
        for first, *rest in rows
    ]
    return tag(
        "table", tag("caption", caption), tag("thead", tag("tr", *heads)), tag("tbody", *body)
    )


def section(anchor: str, title: str, *parts: object) -> Html:
    """A part of the page under its heading."""
    return tag(
        "section", tag("h2", title, id=f"{anchor}-title"), *parts, id=anchor,
        aria_labelledby=f"{anchor}-title",
    )  # fmt: skip
