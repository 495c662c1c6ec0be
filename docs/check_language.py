"""Check the docstrings of the package: ``python docs/check_language.py [FOLDER ...]``.

A docstring's first line must stand alone, so that it may not begin with a word that refers to a
neighbour. Every parameter of a public function or class needs a description, and every array a
shape. The source is read without importing it.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]

#: First words that make a reader look for what they refer to.
FORBIDDEN = re.compile(
    r"(Of|What|The same|By|How|Those|That|As|Likewise|Where|Whose|Which)\b(?!-)", re.ASCII
)
#: An array's shape, as in ``(n, 3) array`` or ``ndarray of shape (n,)``.
SHAPE = re.compile(r"\(\w[^()]*,[^()]*\)|\(\)|0-d|scalar|shape|like")


def parameters(text: str) -> list[tuple[str, str, str]]:
    """Return name, type and description of the entries below Parameters and Attributes."""
    entries: list[tuple[str, str, str]] = []
    for part in re.split(r"\n(?=.+\n-{3,}\n)", text):
        title, _, body = part.strip().partition("\n")
        if title not in ("Parameters", "Attributes"):
            continue
        for line in filter(None, body.splitlines()[1:]):
            if line[0] != " ":
                name, _, kind = line.partition(" : ")
                entries.append((name, kind, ""))
            else:
                name, kind, told = entries[-1]
                entries[-1] = (name, kind, f"{told} {line.strip()}")
    return entries


def exported() -> set[str]:
    """Return every name that a package's stub or ``__init__`` exports."""
    names: set[str] = set()
    for path in (ROOT / "nlosoptics").rglob("__init__.py*"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                names |= {alias.asname or alias.name for alias in node.names}
    return {name for name in names if not name.startswith("_")}


def faults(path: Path, names: set[str]) -> Iterator[str]:
    """Yield a line for every fault of a file's docstrings; ``names`` are the public names."""
    tree = ast.parse(path.read_text())
    if FORBIDDEN.match(ast.get_docstring(tree) or ""):
        yield f"{path}:1: begins with a reference to something else"
    ahead = [(child, True, True) for child in tree.body]
    while ahead:
        node, public, outer = ahead.pop()
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        public = node.name in names if outer else public and node.name[0] != "_"
        ahead += [(child, public, False) for child in node.body]
        text = ast.get_docstring(node) or ""
        place = f"{path}:{node.lineno}: {node.name}:"
        if FORBIDDEN.match(text):
            yield f"{place} begins with a reference to something else"
        described = parameters(text)
        if not public or not described:
            continue
        for name, kind, told in described:
            if not told:
                yield f"{place} {name} has no description"
            if "array" in kind and not SHAPE.search(kind + told):
                yield f"{place} {name}: the array has no shape"
        named = {part.strip("* ") for name, _, _ in described for part in name.split(",")}
        if not isinstance(node, ast.ClassDef):
            given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            missing = {argument.arg for argument in given} - named - {"self", "cls"}
            if missing:
                yield f"{place} parameters not described: {', '.join(sorted(missing))}"


if __name__ == "__main__":
    folders = [Path(name) for name in sys.argv[1:]] or [ROOT / "nlosoptics"]
    public = exported()
    files = sorted(path for folder in folders for path in folder.rglob("*.py"))
    sys.exit("\n".join(line for path in files for line in faults(path, public)) or None)
