"""Pieces of the page: numbers with their units, figures, facts and sections."""

from __future__ import annotations

import math
from collections.abc import Iterable

from .._html import Html, tag

PREFIXES = {-12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NARROW = "\N{NARROW NO-BREAK SPACE}"


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
    """Time in the unit that suits it; long ones stay seconds."""
    return f"{number(value)}{NARROW}s" if value >= 1.0 else quantity(value, "s")


def date(iso: str) -> str:
    """Date and time of a record."""
    return iso.replace("T", " ").replace("+00:00", " UTC")


def percent(share: float) -> str:
    """Share of a whole."""
    return f"{number(100.0 * share)}{NARROW}%"


def figure(picture: object, *caption: object, class_: str | None = None) -> Html:
    """A picture with what it shows."""
    return tag("figure", picture, tag("figcaption", *caption), class_=class_)


def facts(rows: Iterable[tuple[object, object]], class_: str = "facts") -> Html:
    """Names and what they are; rows of None are left out."""
    held = [tag("div", tag("dt", name), tag("dd", told)) for name, told in rows if told is not None]
    return tag("dl", *held, class_=class_)


def section(anchor: str, title: str, *parts: object) -> Html:
    """A part of the page under its heading."""
    return tag(
        "section", tag("h2", title, id=f"{anchor}-title"), *parts, id=anchor,
        aria_labelledby=f"{anchor}-title",
    )  # fmt: skip
