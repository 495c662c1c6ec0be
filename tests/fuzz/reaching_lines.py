"""Lines of the package whose execution reaches a changed piece of code."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable
from pathlib import Path

from .mutant_runs import is_kernel


def reaching_lines(
    package: Path, file: str, line: int, users: Iterable[str]
) -> dict[str, set[int]]:
    """Return lines by file, one of which a test has to execute to notice a change of a line.

    Those are the lines of the changed statement; for a default value, those of its function. For a
    value of a module or class they are all that mention its name, in the file and its users. Lines
    of compiled code leave no trace: for these they are the lines that mention the function, or one
    that calls it through others.
    """
    tree = ast.parse((package / file).read_text())
    around = [node for node in ast.walk(tree) if isinstance(node, ast.stmt) and _holds(node, line)]
    inner = [node for node in around if isinstance(node, ast.FunctionDef)][-1:]
    if inner and not is_kernel(file):
        if line < inner[0].body[0].lineno:
            return {file: _lines(inner[0].body[0].lineno, inner[0].end_lineno)}
        body = getattr(around[-1], "body", None)
        last = max(around[-1].lineno, body[0].lineno - 1) if body else around[-1].end_lineno
        return {file: _lines(around[-1].lineno, last)}
    names = {inner[0].name} if inner else _assigned(around[-1])
    texts = {one: (package / one).read_text().splitlines() for one in {file, *users}}
    while True:
        word = re.compile(r"\b(" + "|".join(map(re.escape, names or {"nothing"})) + r")\b")
        callers = {name for one in texts if is_kernel(one) for name in _callers(texts[one], word)}
        if callers <= names:
            break
        names |= callers
    return {
        one: {number for number, text in enumerate(lines, 1) if word.search(text)}
        for one, lines in texts.items()
    }


def of_default(package: Path, file: str, line: int) -> bool:
    """Whether a line gives the default value of a parameter or of a class's field."""
    around = [
        node
        for node in ast.walk(ast.parse((package / file).read_text()))
        if isinstance(node, ast.stmt) and _holds(node, line)
    ]
    held = len(around) > 1 and isinstance(around[-2], ast.ClassDef)
    field = held and isinstance(around[-1], ast.AnnAssign)
    function = isinstance(around[-1], ast.FunctionDef) and line < around[-1].body[0].lineno
    return field or function


def _holds(node: ast.stmt, line: int) -> bool:
    first = min([node.lineno, *(one.lineno for one in getattr(node, "decorator_list", []))])
    return first <= line <= (node.end_lineno or node.lineno)


def _lines(first: int, last: int | None) -> set[int]:
    return {*range(first, (last or first) + 1)}


def _assigned(node: ast.stmt) -> set[str]:
    """Return the names that a statement gives a value."""
    stored = (one for one in ast.walk(node) if isinstance(one, ast.Name | ast.Attribute))
    return {
        one.id if isinstance(one, ast.Name) else one.attr
        for one in stored
        if isinstance(one.ctx, ast.Store)
    }


def _callers(lines: list[str], word: re.Pattern[str]) -> set[str]:
    """Return the functions of a file that mention a name."""
    return {
        node.name
        for node in ast.parse("\n".join(lines)).body
        if isinstance(node, ast.FunctionDef)
        and any(word.search(text) for text in lines[node.body[0].lineno - 1 : node.end_lineno])
    }
