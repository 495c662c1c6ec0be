"""The package's imports drawn as a house of rooms, for ARCHITECTURE.md.

    python docs/house.py [--out docs/figures/house.svg]

Prints the price of each room too: lines of code, public names and constants in capitals.

A room is a folder of the package; a file directly in ``nlosoptics/`` is a room of its own. An arrow
means that a file of the upper room imports a file of the lower one, wherever in the file the import
stands. Exits with 1 if there is a circle, an arrow upward or a folder of more than 20 files.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import re
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "nlosoptics"
MOST_FILES = 20  # in a folder
CEILINGS = ROOT / "docs" / "ceilings.json"  # code, names and constants of each room
CONSTANT = re.compile(r"(?m)^_?[A-Z][A-Z0-9_]+(?:, _?[A-Z][A-Z0-9_]+)*(?:: [^=\n]+)? = ")

#: Floors from the ground up: packages, each with its rooms in import order. What lies in the
#: package's own folder is above its rooms.
FLOORS: tuple[dict[str, tuple[str, ...]], ...] = (
    {"kernels": ()},
    {"ground": ()},
    {"scene": ("parts", "walls", "file")},
    {"raytrace": ("intersection", "fans", "light", "images")},
    {
        "psf": (
            "aperture",
            "wave",
            "pupil",
            "window",
            "transform",
            "metrics",
            "rough",
            "exchange",
            "walls",
        ),
        "transient": ("capture", "rendering", "imaging"),
    },
    {"imaging": ()},
    {"inverse": ("data", "wave", "known", "shadows", "published", "burst", "blind")},
    {"limits": ()},
    {"runs": ()},
    {"study": ("design", "search")},
    {"views": (), "verification": ()},
    {"report": ()},
    {"cli": ()},
)


def imported(tree: ast.AST, path: str) -> Iterator[tuple[int, str]]:
    """Yield the absolute dotted names that a file imports, at any depth, with their lines.

    Parameters
    ----------
    tree : ast.AST
        Syntax tree of the file.
    path : str
        Path of the file relative to the package, which relative imports start from.
    """
    folders = ["nlosoptics", *path.split("/")[:-1]]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = folders[: len(folders) - node.level + 1] if node.level else []
            stem = ".".join([*above, *([node.module] if node.module else [])])
            yield from ((node.lineno, f"{stem}.{alias.name}") for alias in node.names)


def files() -> list[str]:
    """Return every Python file of the package but its root, relative to the package."""
    found = sorted(p.relative_to(PACKAGE).as_posix() for p in PACKAGE.rglob("*.py"))
    return [p for p in found if p != "__init__.py"]


def room_of(path: str) -> str:
    """Return the room of a file: its folder; ``ground`` for a file in the package's own."""
    folder, _, _ = path.rpartition("/")
    return folder or "ground"


def target(name: str, known: set[str]) -> str | None:
    """Return the file that holds an absolute dotted name; None for names of other packages."""
    first, *parts = name.split(".")
    if first != "nlosoptics":
        return None
    for count in range(len(parts), 0, -1):
        stem = "/".join(parts[:count])
        for path in (f"{stem}.py", f"{stem}/__init__.py"):
            if path in known:
                return path
    return None


def arrows(sources: Mapping[str, str]) -> dict[tuple[str, str], list[str]]:
    """Return the arrows between files: (importer, imported) -> lines.

    Parameters
    ----------
    sources : mapping of str to str
        Text of each file by its path relative to the package.
    """
    known = set(sources)
    found: dict[tuple[str, str], list[str]] = defaultdict(list)
    for path, text in sources.items():
        for line, name in imported(ast.parse(text), path):
            there = target(name, known)
            if there is not None and there != path:
                found[path, there].append(f"{path}:{line}")
    return dict(found)


def order() -> dict[str, tuple[int, int]]:
    """Return the place of each room: its floor, and its position within its package.

    The package's own folder, which holds its face, is above its rooms.
    """
    places = {}
    for floor, packages in enumerate(FLOORS):
        for package, rooms in packages.items():
            places |= {f"{package}/{room}": (floor, k) for k, room in enumerate(rooms)}
            places[package] = (floor, len(rooms))
    return places


def upward(found: Mapping[tuple[str, str], list[str]]) -> list[str]:
    """Return the arrows that point up, one line of text each.

    A file may import from lower floors, and within its package from rooms before its own.
    """
    places, broken = order(), []
    for (path, there), lines in sorted(found.items()):
        here, other = room_of(path), room_of(there)
        if here == other:
            continue
        (floor, k), (other_floor, other_k) = places[here], places[other]
        same = here.split("/")[0] == other.split("/")[0]
        if not (other_floor < floor or (same and other_k < k)):
            broken.append(f"{lines[0]} {here} must not import {other}")
    return broken


def circles(links: Mapping[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected components of more than one node (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    out: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in links.get(node, ()):
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            group = [stack.pop()]
            while group[-1] != node:
                group.append(stack.pop())
            if len(group) > 1:
                out.append(sorted(group))

    for node in list(links):
        if node not in index:
            visit(node)
    return out


def between_rooms(found: Mapping[tuple[str, str], list[str]]) -> dict[str, set[str]]:
    """Return the rooms that each room imports."""
    links: dict[str, set[str]] = defaultdict(set)
    for path, there in found:
        a, b = room_of(path), room_of(there)
        if a != b:
            links[a].add(b)
    return dict(links)


def between_files(found: Mapping[tuple[str, str], list[str]]) -> dict[str, set[str]]:
    """Return the files that each file imports; faces are left out, for they import their rooms."""
    links: dict[str, set[str]] = defaultdict(set)
    for path, there in found:
        if not (path.endswith("__init__.py") or there.endswith("__init__.py")):
            links[path].add(there)
    return dict(links)


def layers(links: Mapping[str, set[str]], package: str) -> int:
    """Return how many rooms lie on the longest chain of imports within a package."""
    rooms = {room for room in order() if room.startswith(f"{package}/")}

    def depth(room: str) -> int:
        return 1 + max((depth(r) for r in links.get(room, set()) & rooms if r != room), default=0)

    return max(depth(room) for room in rooms)


def crowded() -> dict[str, int]:
    """Return the folders of the package that hold more than 20 files."""
    folders = {p.parent for p in PACKAGE.rglob("*.py")}
    counts = {f.relative_to(ROOT).as_posix(): len(list(f.glob("*.py"))) for f in folders}
    return {folder: count for folder, count in sorted(counts.items()) if count > MOST_FILES}


class Price(NamedTuple):
    """What a room costs its readers."""

    code: int
    names: int
    constants: int


def code_lines(text: str) -> int:
    """Return the number of lines that hold code: no docstrings, comments or blanks."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    prose: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
            prose.update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    layout = (
        tokenize.COMMENT,
        tokenize.NL,
        tokenize.NEWLINE,
        tokenize.INDENT,
        tokenize.DEDENT,
        tokenize.ENDMARKER,
    )
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in layout:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - prose)


def public_names(text: str) -> set[str]:
    """Return the names that a face offers: imported as themselves, or listed in ``__all__``."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom):
            names |= {a.name for a in node.names if a.asname == a.name and a.name[0] != "_"}
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            names |= set(ast.literal_eval(node.value))
    return names


def prices() -> dict[str, Price]:
    """Return the price of each room; names count at the faces of packages."""
    out = dict.fromkeys(sorted(order()), Price(0, 0, 0))
    for path in PACKAGE.rglob("*.py*"):
        if path.suffix not in (".py", ".pyi"):
            continue
        text, room = path.read_text(), room_of(path.relative_to(PACKAGE).as_posix())
        face = path.stem == "__init__" and "/" not in room
        names = len(public_names(text)) if face else 0
        code, constants = 0, 0
        if path.suffix == ".py":
            code, constants = code_lines(text), len(CONSTANT.findall(text))
        before = out.get(room, Price(0, 0, 0))
        out[room] = Price(before.code + code, before.names + names, before.constants + constants)
    return out


def lower(rows: Mapping[str, Price]) -> None:
    """Write prices as ceilings, where these are not lower already; a new room gets its own."""
    before = json.loads(CEILINGS.read_text()) if CEILINGS.exists() else {}
    ceilings = {room: [*map(min, price, before.get(room, price))] for room, price in rows.items()}
    text = ",\n".join(f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in ceilings.items())
    CEILINGS.write_text("{\n" + text + "\n}\n")


def read() -> dict[str, str]:
    """Return the text of every file of the package but its root."""
    return {path: (PACKAGE / path).read_text() for path in files()}


def draw(links: Mapping[str, set[str]], out: Path) -> None:
    """Draw floors, packages and rooms with the arrows between packages and within each.

    An arrow is left out where a longer chain of arrows says the same.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyBboxPatch

    counts: dict[str, int] = defaultdict(int)
    for path in files():
        counts[room_of(path)] += not path.endswith("__init__.py")
    figure = Figure(figsize=(11, 13))
    FigureCanvasSVG(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    centre: dict[str, tuple[float, float, float, float]] = {}
    packages_drawn = []

    def box(x: float, y: float, width: float, height: float, fill: str, edge: str) -> None:
        axes.add_patch(
            FancyBboxPatch(
                (x, y), width, height, boxstyle="round,pad=0,rounding_size=0.06", fc=fill, ec=edge
            )
        )

    def depths(package: str, rooms: tuple[str, ...]) -> dict[str, int]:
        found: dict[str, int] = {}
        for name in (f"{package}/{room}" for room in rooms):
            found[name] = 1 + max(
                (found[other] for other in links.get(name, set()) if other in found), default=-1
            )
        return found

    y = 0.0
    for packages in FLOORS:
        height, x = 0.0, 0.0
        plans = {package: depths(package, rooms) for package, rooms in packages.items()}
        total = sum(0.7 + 1.65 * (max(p.values(), default=0) + 1) for p in plans.values())
        x = -total / 2
        for package, plan in plans.items():
            columns = max(plan.values(), default=0) + 1
            rows = max((list(plan.values()).count(k) for k in range(columns)), default=1)
            width, tall = 0.3 + 1.65 * columns, 0.75 if not plan else 0.5 + 0.5 * rows
            box(x, y, width, tall, "#f3f1ea", "#8a8473")
            label = package if package != "ground" else "ground floor"
            single = not plan
            axes.text(
                x + width / 2 if single else x + 0.12,
                y + tall / 2 + 0.08 if single else y + tall - 0.1,
                label,
                ha="center" if single else "left",
                va="center" if single else "top",
                fontsize=12,
                weight="bold",
                color="#333333",
            )
            if single:
                n = counts[package]
                axes.text(x + width / 2, y + 0.2, f"{n} files", ha="center", fontsize=8)
            centre[package] = (x + width / 2, y, y + tall, width)
            packages_drawn.append(centre[package])
            used: dict[int, int] = defaultdict(int)
            for room, column in plan.items():
                rx, ry = x + 0.3 + 1.65 * column, y + 0.1 + 0.5 * used[column]
                used[column] += 1
                box(rx, ry, 1.35, 0.38, "#dbe7f0", "#3b6d94")
                name = room.split("/")[1]
                for up, size, text in ((0.24, 9, name), (0.09, 6.5, f"{counts[room]} files")):
                    axes.text(rx + 0.67, ry + up, text, ha="center", va="center", fontsize=size)
                centre[f"room {room}"] = (rx, ry + 0.19, rx + 1.35, 0.0)
            x += width + 0.4
            height = max(height, tall)
        y += height + 0.45

    def reduced(pairs: set[tuple[str, str]]) -> set[tuple[str, str]]:
        reach = set(pairs)
        for middle in {b for _, b in pairs}:  # transitive closure (Warshall 1962)
            before = {a for a, b in reach if b == middle}
            reach |= {(a, b) for a in before for m, b in reach if m == middle}
        return {(a, b) for a, b in pairs if not any((a, m) in reach for m, c in reach if c == b)}

    whole = {
        (a.split("/")[0], b.split("/")[0])
        for a, found in links.items()
        for b in found
        if a.split("/")[0] != b.split("/")[0]
    }
    style = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0}
    for a, b in sorted(reduced(whole)):
        (xa, ya, _, wa), (xb, _, yb, wb) = centre[a], centre[b]
        low, high = max(xa - wa / 2, xb - wb / 2) + 0.2, min(xa + wa / 2, xb + wb / 2) - 0.2
        x0, x1 = ((low + high) / 2,) * 2 if low < high else (xa, xb)
        axes.annotate(
            "", (x1, yb), (x0, ya), zorder=0, arrowprops={**style, "color": "#8a8473", "lw": 1.4}
        )
    inside = {
        (a, b)
        for a, found in links.items()
        for b in found
        if a.split("/")[0] == b.split("/")[0] and {f"room {a}", f"room {b}"} <= set(centre)
    }
    for a, b in sorted(reduced(inside)):
        (xa, ya, _, _), (_, yb, xb, _) = centre[f"room {a}"], centre[f"room {b}"]
        axes.annotate("", (xb, yb), (xa, ya), arrowprops={**style, "color": "#3b6d94", "lw": 1})
    half = max(max(abs(x - width / 2), abs(x + width / 2)) for x, _, _, width in packages_drawn)
    axes.set_xlim(-half - 0.1, half + 0.1)
    axes.set_ylim(-0.2, y)
    axes.set_aspect("equal")
    with rc_context({"svg.hashsalt": "nlosoptics"}):
        figure.savefig(
            out, metadata={"Date": None} if out.suffix == ".svg" else None, bbox_inches="tight"
        )


def main() -> int:
    """Draw the house, and say what breaks its order."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs/figures/house.svg")
    parser.add_argument("--lower", action="store_true", help="lower the ceilings to these prices")
    arguments = parser.parse_args()
    out = arguments.out
    found = arrows(read())
    links = between_rooms(found)
    faults = [
        *upward(found),
        *(f"circle: {', '.join(c)}" for c in circles(links) + circles(between_files(found))),
        *(f"{folder} holds {n} files, limit {MOST_FILES}" for folder, n in crowded().items()),
    ]
    for fault in faults:
        print(fault)
    rows = prices()
    total = Price(*(sum(column) for column in zip(*rows.values(), strict=True)))
    print(f"{'room':24}{'code':>8}{'names':>8}{'constants':>11}")
    for room, price in (*rows.items(), ("all", total)):
        print(f"{room:24}{price.code:8}{price.names:8}{price.constants:11}")
    if arguments.lower:
        lower(rows)
    if not faults:
        draw(links, out)
        depth = layers(links, "psf")
        print(f"{out}: {len(files())} files, {len(order())} rooms, {depth} layers in psf")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
