"""Check the docstrings of the package: ``python docs/check_language.py [FOLDER ...]``.

A docstring's first line must stand alone, so that it may not begin with a word that refers to a
neighbour. Every parameter of a public function or class needs a description, and every array a
shape. The source is read without importing it.
"""

import ast
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]

#: First words that make a reader look for what they refer to.
FORBIDDEN = re.compile(
    r"(Of|What|The same|By|How|Those|That|As|Likewise|Where|Whose|Which)\b(?!-)", re.ASCII
)
#: A numpydoc entry: ``name, name : type`` at the section's own indentation.
ENTRY = re.compile(r"(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: ?: ?(.*))?$")
#: An array's shape, as in ``(n, 3) array`` or ``ndarray of shape (n,)``.
SHAPE = re.compile(r"\(\w[^()]*,[^()]*\)|\(\)|0-d|scalar|shape|like")


Node = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def section(lines: list[str], title: str) -> list[tuple[str, str, str]]:
    """Return the entries of a numpydoc section.

    Parameters
    ----------
    lines : list of str
        The docstring without its indentation.
    title : str
        Section title, for example ``"Parameters"``.

    Returns
    -------
    list of (str, str, str)
        Name, type and description of every entry.
    """
    try:
        start = next(
            i + 2 for i in range(len(lines) - 1) if lines[i] == title and set(lines[i + 1]) == {"-"}
        )
    except StopIteration:
        return []
    entries: list[tuple[str, str, str]] = []
    for i in range(start, len(lines)):
        if i + 1 < len(lines) and lines[i + 1] and set(lines[i + 1]) == {"-"}:
            break
        if not lines[i]:
            continue
        if lines[i][0] != " " and (found := ENTRY.match(lines[i])):
            entries.append((found[1], found[2] or "", ""))
        elif entries:
            name, kind, text = entries[-1]
            entries[-1] = (name, kind, f"{text} {lines[i].strip()}".strip())
    return entries


def arguments(node: Node) -> set[str]:
    """Return the names of a function's arguments, without `self` and `cls`; empty for a class."""
    if isinstance(node, ast.ClassDef):
        return set()
    given = node.args
    every = [*given.posonlyargs, *given.args, *given.kwonlyargs]
    return {argument.arg for argument in every} - {"self", "cls"}


def faults_of(node: Node, public: bool) -> list[str]:
    """Return what is wrong with the docstring of one function or class.

    Parameters
    ----------
    node : ast.FunctionDef, ast.AsyncFunctionDef or ast.ClassDef
        Definition to check.
    public : bool
        Whether its parameters are checked as well as its first line.
    """
    text = ast.get_docstring(node)
    if text is None:
        return []
    lines = text.splitlines()
    found = []
    if FORBIDDEN.match(lines[0]):
        found.append(f"begins with a reference to something else: {lines[0]!r}")
    if not public:
        return found
    entries = section(lines, "Parameters") + section(lines, "Attributes")
    for name, kind, told in entries:
        if not told:
            found.append(f"{name} has no description")
        if "array" in kind and not SHAPE.search(f"{kind} {told}"):
            found.append(f"{name}: the array has no shape")
    named = {part.strip("* ") for name, _, _ in entries for part in name.split(",")}
    if section(lines, "Parameters") and (missing := arguments(node) - named):
        found.append(f"parameters not described: {', '.join(sorted(missing))}")
    return found


def exported() -> set[str]:
    """Return every name that a package's stub or ``__init__`` exports."""
    names: set[str] = set()
    for path in (ROOT / "nlosoptics").rglob("__init__.py*"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                names |= {alias.asname or alias.name for alias in node.names}
    return {name for name in names if not name.startswith("_")}


def faults(path: Path, names: set[str]) -> list[str]:
    """Return a line for every fault of a file's docstrings.

    Parameters
    ----------
    path : Path
        Python file.
    names : set of str
        Public names, whose parameters are checked.
    """
    tree = ast.parse(path.read_text())
    found = []
    text = ast.get_docstring(tree)
    if text and FORBIDDEN.match(text):
        found.append(f"{path}:1: begins with a reference: {text.splitlines()[0]!r}")

    def walk(node: ast.AST, public: bool) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, Node):
                outer = isinstance(node, ast.Module)
                seen = child.name in names if outer else public and child.name[0] != "_"
                found.extend(
                    f"{path}:{child.lineno}: {child.name}: {fault}"
                    for fault in faults_of(child, seen)
                )
                walk(child, seen)

    walk(tree, public=True)
    return found


def main() -> None:
    """Print the faults of the folders on the command line and fail where there are any."""
    folders = [Path(name) for name in sys.argv[1:]] or [ROOT / "nlosoptics"]
    names = exported()
    files = sorted(path for folder in folders for path in folder.rglob("*.py"))
    found = [line for path in files for line in faults(path, names)]
    print("\n".join(found))
    if found:
        sys.exit(f"{len(found)} docstrings to mend")


if __name__ == "__main__":
    main()
