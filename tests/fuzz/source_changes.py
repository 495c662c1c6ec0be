"""Small changes of Python source that the tests should notice.

Each change swaps one operator, constant or condition, or removes one call or statement. Docstrings,
annotations, decorators, f-strings and the arguments of ``raise`` are left alone: no test of a
computed value can notice a change there.
"""

from __future__ import annotations

import ast
import io
import tokenize
from bisect import bisect
from collections.abc import Iterator
from typing import NamedTuple

#: Operators by node: the token, and its replacements by kind of change.
OPERATORS: dict[type[ast.AST], tuple[str, dict[str, str]]] = {
    ast.Lt: ("<", {"boundary": "<=", "comparison": ">="}),
    ast.LtE: ("<=", {"boundary": "<", "comparison": ">"}),
    ast.Gt: (">", {"boundary": ">=", "comparison": "<="}),
    ast.GtE: (">=", {"boundary": ">", "comparison": "<"}),
    ast.Eq: ("==", {"comparison": "!="}),
    ast.NotEq: ("!=", {"comparison": "=="}),
    ast.Is: ("is", {"comparison": "is not"}),
    ast.IsNot: ("is not", {"comparison": "is"}),
    ast.In: ("in", {"comparison": "not in"}),
    ast.NotIn: ("not in", {"comparison": "in"}),
    ast.Add: ("+", {"arithmetic": "-"}),
    ast.Sub: ("-", {"arithmetic": "+"}),
    ast.Mult: ("*", {"arithmetic": "/"}),
    ast.Div: ("/", {"arithmetic": "*"}),
    ast.FloorDiv: ("//", {"arithmetic": "%"}),
    ast.Mod: ("%", {"arithmetic": "//"}),
    ast.Pow: ("**", {"arithmetic": "*"}),
    ast.BitAnd: ("&", {"boolean": "|"}),
    ast.BitOr: ("|", {"boolean": "&"}),
    ast.And: ("and", {"boolean": "or"}),
    ast.Or: ("or", {"boolean": "and"}),
}
#: Modules whose functions of one argument are removed, and functions that only convert.
NUMERICAL = ("math", "np", "torch")
CONVERSIONS = ("array", "asarray", "ascontiguousarray", "from_numpy", "tensor", "uint64", "int64")


class Change(NamedTuple):
    """One change of a file: characters ``start`` to ``end`` become ``text``."""

    file: str
    kind: str
    start: int
    end: int
    text: str

    def applied(self, source: str) -> str:
        """Return the changed source."""
        return source[: self.start] + self.text + source[self.end :]

    def line(self, source: str) -> int:
        """Return the number of the first changed line."""
        return source.count("\n", 0, self.start) + 1

    def lines(self, source: str) -> tuple[str, str]:
        """Return the changed lines, before and after, without their indentation."""
        first = source.rfind("\n", 0, self.start) + 1
        last = source.find("\n", self.end)
        before = source[first:last]
        changed = before[: self.start - first] + self.text + before[self.end - first :]
        return before.strip(), changed.strip()


def changes(file: str, source: str) -> list[Change]:
    """Return all changes of one source file, in the order of the source."""
    found = _Finder(file, source)
    found.visit(ast.parse(source))
    return sorted(set(found.changes), key=lambda one: (one.start, one.end, one.kind))


class _Finder(ast.NodeVisitor):
    """Collect the changes of one file."""

    def __init__(self, file: str, source: str) -> None:
        self.changes: list[Change] = []
        self._file, self._source = file, source
        self._lines = source.splitlines(keepends=True)
        self._starts = [0]
        for line in self._lines:
            self._starts.append(self._starts[-1] + len(line))
        self._tokens = [
            (self._starts[token.start[0] - 1] + token.start[1], token.string)
            for token in tokenize.generate_tokens(io.StringIO(source).readline)
            if token.type in (tokenize.OP, tokenize.NAME)
        ]

    def visit(self, node: ast.AST) -> None:
        """Add the changes of a node, then those of its children that tests can notice."""
        method = getattr(self, f"_on_{type(node).__name__.lower()}", None)
        if method is not None:
            method(node)
        for child in _children(node):
            self.visit(child)

    def _add(self, kind: str, start: int, end: int, text: str) -> None:
        self.changes.append(Change(self._file, kind, start, end, text))

    def _span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        """Return the character offsets of a node; the tree counts bytes of a line."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        places = ((node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset))
        start, end = (self._starts[line - 1] + self._column(line, at) for line, at in places)
        return start, end

    def _column(self, line: int, at: int) -> int:
        text = self._lines[line - 1]
        return at if text.isascii() else len(text.encode()[:at].decode())

    def _replace(self, kind: str, node: ast.expr | ast.stmt, text: str) -> None:
        self._add(kind, *self._span(node), text)

    def _swap(self, operator: ast.AST, after: int, before: int, suffix: str = "") -> None:
        """Add the changes of an operator between two offsets, where it is the only one."""
        word, others = OPERATORS.get(type(operator), ("", {}))
        first, last = (word.split() or [""])[0] + suffix, (word.split() or [""])[-1] + suffix
        between = self._tokens[bisect(self._tokens, (after,)) : bisect(self._tokens, (before,))]
        starts = [at for at, text in between if text == first]
        ends = [at + len(last) for at, text in between if text == last]
        for kind, other in others.items():
            self._add(kind, starts[0], ends[0], other + suffix)

    def _on_compare(self, node: ast.Compare) -> None:
        left = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            self._swap(operator, self._span(left)[1], self._span(right)[0])
            left = right

    def _on_binop(self, node: ast.BinOp) -> None:
        self._swap(node.op, self._span(node.left)[1], self._span(node.right)[0])

    def _on_boolop(self, node: ast.BoolOp) -> None:
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._swap(node.op, self._span(left)[1], self._span(right)[0])

    def _on_unaryop(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.Not | ast.USub):
            kind = "boolean" if isinstance(node.op, ast.Not) else "arithmetic"
            start, last = self._span(node)[0], self._span(node.operand)[0]
            word = "not" if kind == "boolean" else "-"  # parentheses of the operand stay
            rest = self._source[start + len(word) : last].lstrip()
            self._add(kind, start, last - len(rest), "")

    def _on_constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self._replace("boolean", node, repr(not value))
        elif isinstance(value, int):
            self._replace("constant", node, repr(value + 1))
        elif isinstance(value, float | complex):
            self._replace("constant", node, repr(2 * value or type(value)(1)))

    def _on_if(self, node: ast.If) -> None:
        start, end = self._span(node.test)
        self._replace("condition", node.test, f"not ({self._source[start:end]})")

    def _on_call(self, node: ast.Call) -> None:
        name = node.func
        if (
            isinstance(name, ast.Attribute)
            and isinstance(name.value, ast.Name)
            and name.value.id in NUMERICAL
            and name.attr not in CONVERSIONS
            and len(node.args) == 1
            and not node.keywords
            and not isinstance(node.args[0], ast.Starred)
        ):
            self._replace("removed call", node, f"({ast.unparse(node.args[0])})")

    def _on_expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call):
            self._replace("removed statement", node, "pass")

    def _removed(self, node: ast.stmt) -> None:
        self._replace("removed statement", node, "pass")

    _on_raise = _on_continue = _on_break = _removed

    def _on_augassign(self, node: ast.AugAssign) -> None:
        self._swap(node.op, self._span(node.target)[1], self._span(node.value)[0], "=")
        self._removed(node)


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the children of a node whose changes a test can notice."""
    if isinstance(node, ast.JoinedStr | ast.Raise):
        return
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        if isinstance(node, ast.Module) and isinstance(value, list):
            value = [one for one in value if not _is_alias(one)]
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield child


def _is_alias(node: ast.AST) -> bool:
    """Whether a statement of a module names a type, as in ``Number = int | float``."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return False
    return any(isinstance(one, ast.BitOr) for one in ast.walk(node.value))
