"""The validation page: each reference value, the tests that hold it, and our errors."""

import ast
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tables
from tables import COLOURS, ROOT, figure, table

from nlosoptics import limits, psf, scene, views

TESTS = ROOT / "tests"
TITLES = {
    "wall_aberrations.json": "Wave aberrations of walls",
    "psf.json": "Point spreads and their metrics",
    "materials.json": "Materials",
    "relay.json": "What a relay wall passes",
}
Row = dict[str, Any]


@dataclass(frozen=True)
class Test:
    """A test function that reads reference values.

    Parameters
    ----------
    name : str
        ``tests/.../test_x.py::test_y``.
    names : set of str
        The references it reads.
    code : str
        Without its decorators.
    """

    name: str
    names: set[str]
    code: str


def pages(target: Path) -> None:
    """Write tables, the tests' own code and the figure into a folder."""
    tables.write(target / "validation.md", text())
    tables.write(target / "test_files.md", file_table())
    views.save(draw(), target / "validation.svg")


def text() -> str:
    """Return the tables and the tests' own code.

    Raises
    ------
    LookupError
        If a reference is held by no test.
    """
    parts = []
    for path in sorted((TESTS / "truths").glob("*.json"), key=lambda p: list(TITLES).index(p.name)):
        found = references(path)
        tests = [test for module in modules(path.name) for test in module_tests(module, set(found))]
        parts += [f"## {TITLES[path.name]}\n", f"`tests/truths/{path.name}`\n"]
        parts.append(reference_table(found, tests))
        parts += [f"`{test.name}`\n\n```python\n{test.code}\n```\n" for test in tests]
    return "\n".join(parts)


def references(path: Path) -> dict[str, list[Row]]:
    """Rows of a file by their name; walls of ``wall_aberrations.json`` are rows as well."""
    content = json.loads(path.read_text())
    if isinstance(content, dict):
        listed = [
            {
                "name": case["name"],
                "formula": "|O-H| + |H-p| - |O'-p|, minus that at p = 0; reflection at H",
                "source": "mpmath, 50 digits",
                "tolerance": "see the test",
                "values": len(case["rows"]),
            }
            for case in content["cases"]
        ]
    else:
        listed = content
    found: dict[str, list[Row]] = {}
    for row in listed:
        found.setdefault(row["name"], []).append(row)
    return found


def reference_table(found: dict[str, list[Row]], tests: Iterable[Test]) -> str:
    """Return a line for each reference."""
    body = []
    for name, listed in found.items():
        holders = [test.name.split("::")[1] for test in tests if name in test.names]
        if not holders:
            raise LookupError(f"tests/truths has {name!r}, which no test reads")
        first = listed[0]
        values = first.get("values", len(listed))
        code = "; ".join(dict.fromkeys(str(row["formula"]) for row in listed)).replace("|", "\\|")
        body.append(
            [
                name.replace("_", " "),
                f"`{code}`",
                values,
                "; ".join(dict.fromkeys(row["source"] for row in listed)),
                "; ".join(dict.fromkeys(row["tolerance"] for row in listed)),
                ", ".join(f"`{holder}`" for holder in holders),
            ]
        )
    return table(["reference", "formula", "values", "source", "tolerance", "checked by"], body)


def modules(truths: str) -> Iterator[Path]:
    """Yield the test files that name a file of references."""
    for path in sorted(TESTS.rglob("test_*.py")):
        if f'"{truths}"' in path.read_text():
            yield path


def module_tests(path: Path, known: set[str]) -> Iterator[Test]:
    """Yield the tests of a file that read references, by what their code names, directly or not."""
    source = path.read_text()
    tree = ast.parse(source)
    made: dict[str, ast.AST] = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            made[node.name] = node
        elif isinstance(node, ast.Assign):
            made |= {target.id: node for target in node.targets if isinstance(target, ast.Name)}
    for node in tree.body:
        if not isinstance(node, ast.FunctionDef) or not node.name.startswith("test_"):
            continue
        strings, names = mentioned(node, made)
        if not names & {"TRUTHS", "ROWS"}:
            continue
        # a test over the whole file picks no reference by name
        read = strings & known or known
        where = f"{path.relative_to(ROOT)}::{node.name}"
        yield Test(name=where, names=read, code=ast.get_source_segment(source, node) or "")


def mentioned(node: ast.AST, made: dict[str, ast.AST]) -> tuple[set[str], set[str]]:
    """Return strings and names in some code and in all that it calls of its own file."""
    strings: set[str] = set()
    names: set[str] = set()
    ahead = [node]
    while ahead:
        for inner in ast.walk(ahead.pop()):
            if isinstance(inner, ast.Constant) and isinstance(inner.value, str):
                strings.add(inner.value)
            elif isinstance(inner, ast.Name) and inner.id not in names:
                names.add(inner.id)
                if inner.id in made:
                    ahead.append(made[inner.id])
    return strings, names


def file_table() -> str:
    """Return what each file of tests is about, by its first line."""
    body = []
    for path in sorted(TESTS.rglob("test_*.py")):
        tree = ast.parse(path.read_text())
        count = sum(getattr(node, "name", "").startswith("test_") for node in tree.body)
        about = (ast.get_docstring(tree) or "").partition("\n")[0]
        body.append([f"`{path.relative_to(TESTS)}`", about, count])
    return table(["file", "about", "tests"], body)


def draw() -> Any:
    """Draw what the library computes at the references, and by how much it differs."""
    drawn = figure(9.6, 7)
    panels = drawn.subplots(2, 2)
    draw_walls(panels[0, 0])
    draw_strehl(panels[0, 1])
    draw_albedo(panels[1, 0])
    draw_relay(panels[1, 1])
    return drawn


def draw_walls(axes: Any) -> None:
    """Draw |W - reference| of each wall over W."""
    content = json.loads((TESTS / "truths" / "wall_aberrations.json").read_text())
    for case, colour in zip(content["cases"], COLOURS, strict=False):
        kind = dict(case["wall"])
        made = {
            "flat": scene.FlatWall,
            "concave": scene.ConcaveWall,
            "convex": scene.ConvexWall,
            "wavy": scene.WavyWall,
        }[kind.pop("kind")](**kind)
        listed = np.array([[float(value) for value in row] for row in case["rows"]])
        ours = psf.wall_aberration(
            made,
            case["object_point_m"],
            case["pupil_centre_m"],
            case["pupil_aim_m"],
            listed[:, :2],
        )
        off = np.maximum(np.abs(ours - listed[:, 2]), 1e-20)
        axes.loglog(
            np.maximum(np.abs(listed[:, 2]), 1e-20), off, ".", color=colour, label=case["name"]
        )
    axes.set(
        xlabel="reference of 50 digits (m)",
        ylabel="difference (m; 1e-20 means none)",
        title="wave aberration of four walls",
    )
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)


def draw_strehl(axes: Any) -> None:
    """Draw the Strehl ratio of defocus, spherical aberration and coma with the references."""
    listed = references(TESTS / "truths" / "psf.json")
    waves = np.linspace(0, 1, 21)
    system = {"wavelength": 632.8e-9, "pupil_radius": 12.5e-3, "image_distance": 50e-3}
    shapes = {
        "strehl_defocus": lambda x, y: x**2 + y**2,
        "strehl_spherical": lambda x, y: (x**2 + y**2) ** 2,
        "strehl_coma": lambda x, y: x * (x**2 + y**2),
    }
    for (name, shape), colour in zip(shapes.items(), COLOURS, strict=False):
        curve = []
        for number in waves:
            wave = psf.Wavefront.from_function(
                lambda u, v, n=number, f=shape: n * 632.8e-9 * f(u / 12.5e-3, v / 12.5e-3), **system
            )
            curve.append(psf.strehl(wave))
        axes.plot(waves, curve, color=colour, label=name.removeprefix("strehl_"))
        marks = [(float(row["parameters"]["w"]), float(row["value"])) for row in listed[name]]
        axes.plot(
            *zip(*(m for m in marks if m[0] <= 1), strict=True), "o", color=colour, fillstyle="none"
        )
    axes.set(
        xlabel="aberration at the rim of the pupil (waves)",
        ylabel="Strehl ratio",
        title="Strehl ratio (circles: reference)",
    )
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)


def draw_albedo(axes: Any) -> None:
    """Draw the directional albedo of the Oren-Nayar fit with the references."""
    listed = references(TESTS / "truths" / "materials.json")["oren_nayar_directional_albedo"]
    angles = np.linspace(0, 90, 91)
    for sigma, colour in zip(("0.1", "0.3", "0.5", "1"), COLOURS, strict=False):
        material = scene.OrenNayar(1.0, float(sigma))
        axes.plot(
            angles, material.albedo(np.radians(angles)), color=colour, label=f"slope rms {sigma}"
        )
        marks = [
            (row["parameters"]["theta_i_deg"], float(row["value"]))
            for row in listed
            if (row["parameters"]["sigma"], row["parameters"]["rho"]) == (sigma, "1")
        ]
        axes.plot(*zip(*marks, strict=True), "o", color=colour, fillstyle="none")
    axes.axhline(1, color="black", linewidth=0.8)
    axes.set(
        xlabel="angle of incidence (degrees)",
        ylabel="albedo",
        title="white Oren-Nayar wall (circles: reference)",
    )
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)


def draw_relay(axes: Any) -> None:
    """Draw the transfer of a matt wall with the references."""
    listed = references(TESTS / "truths" / "relay.json")["lambert_relay_transfer"]
    frequency = np.geomspace(0.05, 6, 100)
    axes.semilogy(frequency, limits.lambert_relay_transfer(frequency, 1.0), color=COLOURS[0])
    marks = [(float(row["parameters"]["f_cycles_per_m"]), float(row["value"])) for row in listed]
    axes.plot(
        *zip(*(m for m in marks if m[0] <= 6), strict=True), "o", color=COLOURS[0], fillstyle="none"
    )
    axes.set(
        xlabel="spatial frequency 1 m from the wall (cycles/m)",
        ylabel="fraction of the modulation",
        title="what a matt wall passes (circles: reference)",
    )
    axes.grid(alpha=0.3)
