"""Results files, tables in Markdown and the style of the site's figures."""

import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from nlosoptics.report import elements

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"

#: Okabe and Ito's colours, distinct to every kind of colour vision.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
#: How cells begin in a column of numbers.
NUMERIC = re.compile(r"[-+\u2212\d]|not reached|n\^|$")
JOINED = re.compile(r"(?<=\d) (?=(?:%|mm|MiB|MB)(?:\W|$)|of \d)|(?<=\d of) (?=\d)")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def rows(name: str) -> Any:
    """Everything in a results file, of JSON or (``.jsonl``) of a JSON line each."""
    text = (RESULTS / name).read_text()
    if name.endswith(".jsonl"):
        return [json.loads(line) for line in text.splitlines() if line.strip()]
    return json.loads(text)


def number(value: float | None, digits: int = 3) -> str:
    """A figure as it is read: ``1.3e-05`` where it is small or large, else ``0.0234``."""
    if value is None:
        return ""
    if value == 0:
        return "0"
    plain = 1e-3 <= abs(value) < 1e5
    text = f"{value:.{digits}g}" if plain else f"{value:.{max(digits - 2, 0)}e}"
    return text.replace("-", "\N{MINUS SIGN}")  # a line does not end there


def seconds(value: float | None) -> str:
    """A time as reports have it; nothing where none was taken."""
    return "" if value is None else elements.seconds(value)


def table(head: Sequence[str], body: Iterable[Sequence[object]]) -> str:
    """A Markdown table, columns of numbers after the first on the right."""
    # a number stays with its unit and with what it is a part of
    cells = [[JOINED.sub("\N{NO-BREAK SPACE}", str(cell)) for cell in line] for line in body]
    numeric = [all(NUMERIC.match(cell) for cell in column) for column in zip(*cells, strict=True)]
    marks = ["---", *("--:" if right else "---" for right in numeric[1:])]
    lines = [head, marks, *cells]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def figure(width: float = 8.0, height: float = 4.0) -> Figure:
    """A figure for the site."""
    return Figure(figsize=(width, height), layout="constrained")


def write(target: Path, text: str) -> None:
    """Write a file where it differs, so that Sphinx reads again only what changed."""
    if not target.exists() or target.read_text() != text:
        target.write_text(text)
