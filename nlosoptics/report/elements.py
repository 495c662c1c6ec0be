"""Building blocks of the page: numbers with units, figures, fact lists and sections."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

from .._html import Column, Html, joined, png, table, tag

#: Anchor, title and contents of a section.
Part = tuple[str, str, Html]
NARROW = "\N{NARROW NO-BREAK SPACE}"


def number(value: float, digits: int = 3) -> str:
    """Format a number with ``digits`` digits and written powers of ten: ``1.6 × 10⁻¹⁰``."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        text = f"{value:.{digits}g}"
        text = text if "e" not in text else f"{float(text):.0f}"
    else:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        raised = str(int(exponent)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
        text = f"{float(mantissa):g}{NARROW}×{NARROW}10{raised}"
    return text.replace("-", "−")


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Format a number with an SI unit and a suitable prefix: ``433 nm``."""
    rounded = float(f"{value:.{digits}g}")
    power = 0 if rounded == 0.0 else 3 * math.floor(math.log10(abs(rounded)) / 3)
    power = min(max(power, -12), 9)
    prefix = ("p", "n", "µ", "m", "", "k", "M", "G")[power // 3 + 4]
    return f"{number(rounded / 10.0**power, digits)}{NARROW}{prefix}{unit}"


def seconds(value: float) -> str:
    """Format a time in s; below 1 s with a prefix."""
    return f"{number(value)}{NARROW}s" if value >= 1.0 else quantity(value, "s")


def spaced(name: str) -> str:
    """Replace underscores in an identifier by spaces."""
    return name.replace("_", " ")


def plot(data: bytes, title: str, alt: str, *caption: object) -> Html:
    """Return a figure: a PNG picture, and a caption that begins with the title."""
    picture = tag("img", src=png(data), alt=alt)
    return tag("figure", picture, tag("figcaption", tag("b", title), *caption), class_="plot")


def facts(rows: Iterable[tuple[object, object]], class_: str = "facts") -> Html:
    """Return a list of names and values; rows with the value None are left out."""
    shown = [
        tag("div", tag("dt", name), tag("dd", value)) for name, value in rows if value is not None
    ]
    return tag("dl", *shown, class_=class_)


def wide_table(caption: str, columns: dict[str, str | None], rows: list[Any]) -> Html:
    """Return a table in a box that scrolls sideways in a narrow window; empty without rows.

    ``columns`` gives the kind of each column, "number" or None, by its head.
    """
    if not rows:
        return Html()
    inner = table(caption, [Column(head, kind) for head, kind in columns.items()], rows)
    return tag("div", inner, class_="wide", tabindex=0, role="group", aria_label=caption)


def sections(made: Iterable[tuple[str, str, Iterator[Html]]]) -> list[Part]:
    """Return the sections of a page with their headings, without empty ones."""
    parts = []
    for anchor, title, contents in made:
        inner = joined(contents)
        if inner:
            name = f"{anchor}-title"
            head = tag("h2", title, id=name)
            parts.append(
                (anchor, title, tag("section", head, inner, id=anchor, aria_labelledby=name))
            )
    return parts
