"""The validation page: each reference value, the tests that hold it, and our errors."""

import ast
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tables
from tables import COLOURS, ROOT, figure, table

from nlosoptics import psf, scene, views

TESTS = ROOT / "tests"
TITLES = {
    "wall_aberrations.json": "Wave aberrations of walls",
    "psf.json": "Point spreads and their metrics",
    "materials.json": "Materials",
    "relay.json": "What a relay wall passes",
}
Row = dict[str, Any]


def pages(target: Path) -> None:
    """Write the tables and the figure into a folder."""
    tables.write(target / "validation.md", text())
    tables.write(target / "test_files.md", file_table())
    views.save(draw(), target / "validation.svg")


def text() -> str:
    """Return a table for each file of references."""
    parts = []
    for name, title in TITLES.items():
        readers = {
            str(path.relative_to(ROOT)): path.read_text()
            for path in sorted(TESTS.rglob("test_*.py"))
            if f'"{name}"' in path.read_text()
        }
        parts += [f"## {title}\n", f"`tests/truths/{name}`\n"]
        parts.append(reference_table(references(TESTS / "truths" / name), readers))
    return "\n".join(parts)


def references(path: Path) -> dict[str, list[Row]]:
    """Rows of a file by their name; walls of ``wall_aberrations.json`` are rows as well."""
    content = json.loads(path.read_text())
    if isinstance(content, dict):
        content = [
            {
                "name": case["name"],
                "formula": "|O-H| + |H-p| - |O'-p|, minus that at p = 0; reflection at H",
                "source": "mpmath, 50 digits",
                "tolerance": "see the test",
                "values": len(case["rows"]),
            }
            for case in content["cases"]
        ]
    found: dict[str, list[Row]] = {}
    for row in content:
        found.setdefault(row["name"], []).append(row)
    return found


def reference_table(found: Mapping[str, list[Row]], readers: Mapping[str, str]) -> str:
    """Return a line for each reference; ``readers`` are the texts of test files by their paths.

    A file that names no reference of the table reads all of them.

    Raises
    ------
    LookupError
        If a reference is read by no test.
    """
    body = []
    for name, listed in found.items():
        holders = [
            f"`{path}`"
            for path, code in readers.items()
            if name in code or not any(other in code for other in found)
        ]
        if not holders:
            raise LookupError(f"tests/truths has {name!r}, which no test reads")
        formula, source, tolerance = (
            "; ".join(dict.fromkeys(str(row[key]) for row in listed))
            for key in ("formula", "source", "tolerance")
        )
        code = formula.replace("|", "\\|")
        count = listed[0].get("values", len(listed))
        title = name.replace("_", " ")
        body.append([title, f"`{code}`", count, source, tolerance, ", ".join(holders)])
    return table(["reference", "formula", "values", "source", "tolerance", "checked by"], body)


def file_table() -> str:
    """Return what each file of tests is about, by its first line."""
    body = []
    for path in sorted(TESTS.rglob("test_*.py")):
        about = (ast.get_docstring(ast.parse(path.read_text())) or "").partition("\n")[0]
        body.append([f"`{path.relative_to(TESTS)}`", about])
    return table(["file", "about"], body)


def draw() -> Any:
    """Draw what the library computes at the references, and by how much it differs."""
    drawn = figure(9.6, 3.8)
    left, right = drawn.subplots(1, 2)
    draw_walls(left)
    draw_strehl(right)
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
