"""Tables of results files: a column is a heading and a template that a row fills.

A template is a format string, such as ``"{seconds:median time} ({error:n2})"``. After the colon are
words, applied from left to right: one of `WORDS`, or a format specification of Python. A name that
ends with ``?`` leaves nothing where a row lacks it. A function of the row may replace a template.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from statistics import median
from string import Formatter
from typing import Any

from tables import number, seconds, table

Row = dict[str, Any]
Cell = str | Callable[[Row], object]
Rows = Callable[[Any], Iterable[Row]]

WORDS: dict[str, Callable[[Any], Any]] = {
    "median": median,
    "min": min,
    "max": max,
    "first": itemgetter(0),
    "last": itemgetter(-1),
    "percent": lambda value: 100 * value,
    "mm": lambda value: 1e3 * value,
    "milli": lambda value: value / 1e3,
    "MiB": lambda value: value / 2**20,
    "time": seconds,
    "n": number,
    "n2": lambda value: number(value, 2),
    "n4": lambda value: number(value, 4),
}
#: Labels that programs store with a plural after every number.
PLURAL = re.compile(r"(?<![\d.,])1 (mode|process)(?:es|s)\b")


class Template(Formatter):
    """Format strings with the words of this module."""

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        """Return the value of a name."""
        name = str(key)
        return kwargs.get(name[:-1]) if name.endswith("?") else kwargs[name]

    def format_field(self, value: Any, format_spec: str) -> str:
        """Apply the words; None leaves nothing."""
        if value is None:
            return ""
        for word in format_spec.split():
            value = WORDS[word](value) if word in WORDS else format(value, word)
        return str(value)


def fill(cell: Cell, row: Row) -> str:
    """Return a cell's text for a row."""
    text = Template().vformat(cell, (), row) if isinstance(cell, str) else str(cell(row))
    return PLURAL.sub(r"1 \1", text)


def filled(cells: dict[str, Cell], rows: Iterable[Row]) -> str:
    """Return a table with the templates of its columns by heading, and a line for each row."""
    return table(list(cells), ([fill(cell, row) for cell in cells.values()] for row in rows))


def listed(cells: dict[str, Cell], row: Row) -> str:
    """Return a table of two columns, with a line for each template."""
    body = ([name, fill(cell, row)] for name, cell in cells.items())
    return table(["quantity", "value"], body)


def by(
    *keys: str,
    keep: Callable[[Row], object] = bool,
    order: Callable[[Row], Any] | None = None,
) -> Callable[[Iterable[Row]], list[Row]]:
    """Return a function that makes one row, a group, of all rows with the same values of some keys.

    A group has these values, its ``rows``, their number ``count``, and a list of values for each
    other key. Rows count if `keep` is true of them. The groups come in the order of their first
    rows, or sorted by `order`.
    """

    def groups(found: Iterable[Row]) -> list[Row]:
        parts = defaultdict(list)
        for row in filter(keep, found):
            parts[tuple(row[key] for key in keys)].append(row)
        made = []
        for values, part in parts.items():
            others = {key for row in part for key in row}.difference(keys)
            lists = {key: [row[key] for row in part if key in row] for key in others}
            same = dict(zip(keys, values, strict=True))
            made.append(lists | same | {"rows": part, "count": len(part)})
        return sorted(made, key=order) if order else made

    return groups


def methods(found: Iterable[Row]) -> list[Row]:
    """Return a row for each method whose results a row holds as a table of its own."""
    return [
        {"method": name} | value
        for row in found
        for name, value in row.items()
        if isinstance(value, dict)
    ]
