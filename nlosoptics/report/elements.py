"""Building blocks of the page: numbers with units, figures, fact lists and sections."""

from __future__ import annotations

import math
from collections.abc import Iterable

from .._html import Html, tag

PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NARROW = "\N{NARROW NO-BREAK SPACE}"


def number(value: float, digits: int = 3) -> str:
    """Format a number with ``digits`` digits and written powers of ten: ``1.6 × 10⁻¹⁰``."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        text = f"{value:.{digits}g}"
        text = text if "e" not in text else f"{float(text):.0f}"
    else:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        raised = str(int(exponent)).translate(SUPERSCRIPTS)
        text = f"{float(mantissa):g}{NARROW}×{NARROW}10{raised}"
    return text.replace("-", "−")


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Format a number with an SI unit and a suitable prefix: ``433 nm``."""
    rounded = float(f"{value:.{digits}g}")
    power = 0 if rounded == 0.0 else 3 * math.floor(math.log10(abs(rounded)) / 3)
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    return f"{number(rounded / 10.0**power, digits)}{NARROW}{PREFIXES[power]}{unit}"


def seconds(value: float) -> str:
    """Format a time in s; below 1 s with a prefix."""
    return f"{number(value)}{NARROW}s" if value >= 1.0 else quantity(value, "s")


def date(iso: str) -> str:
    """Format the ISO 8601 date and time of a record."""
    return iso.replace("T", " ").replace("+00:00", " UTC")


def percent(share: float) -> str:
    """Format a fraction as percentage."""
    return f"{number(100.0 * share)}{NARROW}%"


def figure(picture: object, *caption: object, class_: str | None = None) -> Html:
    """Return a figure: picture and caption."""
    return tag("figure", picture, tag("figcaption", *caption), class_=class_)


def facts(rows: Iterable[tuple[object, object]], class_: str = "facts") -> Html:
    """Return a list of names and values; rows with the value None are left out."""
    held = [tag("div", tag("dt", name), tag("dd", told)) for name, told in rows if told is not None]
    return tag("dl", *held, class_=class_)


def section(anchor: str, title: str, *parts: object) -> Html:
    """Return a section of the page with its heading."""
    return tag(
        "section", tag("h2", title, id=f"{anchor}-title"), *parts, id=anchor,
        aria_labelledby=f"{anchor}-title",
    )  # fmt: skip
