"""Sections of the performance page and how they are written."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tables

from nlosoptics import views

from .cells import Cell, Rows, filled


@dataclass(frozen=True)
class Section:
    """One results file on the page.

    Parameters
    ----------
    file : str
        Name in ``benchmarks/results``.
    title, text : str
        Heading, and the paragraph below it.
    command : str
        Command that wrote the file; ``{file}`` is its path.
    table : dict or callable
        Template of each column by its heading, or a function of the content of the file that
        returns Markdown.
    rows : callable, optional
        Function of the content of the file that returns the rows for the templates.
    note : callable, optional
        Function of the content of the file that returns the paragraph below the table, or a
        second table.
    figure : callable, optional
        Function of the content of the file that returns a figure.
    alternative : str
        Description of the figure for readers who cannot see it.
    """

    file: str
    title: str
    text: str
    command: str
    table: dict[str, Cell] | Callable[[Any], str]
    rows: Rows = iter
    note: Callable[[Any], str] | None = None
    figure: Callable[[Any], Any] | None = None
    alternative: str = ""

    def markdown(self, target: Path) -> str:
        """Return the section; its figure is saved in a folder."""
        found = tables.rows(self.file)
        made = self.table
        table = made(found) if callable(made) else filled(made, self.rows(found))
        parts = [f"### {self.title}\n", f"{self.text}\n", table]
        if self.note is not None:
            parts.append(self.note(found).rstrip() + "\n")
        if self.figure is not None:
            picture = f"{Path(self.file).stem}.svg"
            views.save(self.figure(found), target / picture)
            parts.append(f"![{self.alternative}](_generated/{picture})\n")
        command = self.command.format(file=f"benchmarks/results/{self.file}")
        parts.append(f"```console\n$ {command}\n```\n")
        return "\n".join(parts)


def write(rooms: Mapping[str, Iterable[Section]], target: Path) -> None:
    """Write the page and its figures into a folder.

    Raises
    ------
    LookupError
        If a results file has no section or a section no file.
    """
    known = {section.file for part in rooms.values() for section in part}
    if differ := sorted(known ^ {path.name for path in tables.RESULTS.iterdir()}):
        raise LookupError(f"docs/_ext/performance and benchmarks/results differ in {differ}")
    text = []
    for heading, part in rooms.items():
        text += [f"## {heading}\n", *(section.markdown(target) for section in part)]
    tables.write(target / "performance.md", "\n".join(text))
