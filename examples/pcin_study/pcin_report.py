"""Tables in Markdown and pictures of what the study found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Line = dict[str, Any]

WALLS = ("flat", "concave", "convex", "wavy")
COLUMNS = ("correlation", "psnr", "ssim", "seconds", "iterations", "status")
FAMILY = (
    "image",
    "inverse_filter",
    "phase_retrieval",
    "hio",
    "cnn",
    "wu2024",
    "evidence",
    "evidence_2frames",
    "tv",
)


def name_of(key: Line, what: str) -> str:
    """Name of a case's picture; its data's where `what` is "image" or "truth"."""
    parts = [key["scale"], key["object"], key["wall"], f"{key['exposure_ms']}ms", key["size"]]
    name = "-".join(map(str, parts))
    method = key["method"] if what == "object" else what
    return f"{name}-{method}"


def write(lines: list[Line], folder: Path) -> None:
    """tables.md and the pictures, of whatever is finished."""
    ordered = sorted(lines, key=lambda x: (x["scale"], x["object"], x["wall"], x["exposure_ms"]))
    parts = [_pivot(ordered, scale) for scale in ("wall", "paper")]
    parts += [_warm(ordered), _verdicts(ordered), _all(ordered)]
    (folder / "tables.md").write_text("\n\n".join(part for part in parts if part) + "\n")
    _pictures(ordered, folder)


def _pivot(lines: list[Line], scale: str) -> str:
    """Correlation by method (columns) of each object, wall and exposure (rows)."""
    chosen = [x for x in lines if x["scale"] == scale]
    used = [m for m in FAMILY if any(x["method"] == m for x in chosen)]
    if not used:
        return ""
    rows = [
        f"### Registered correlation, scale: {scale}",
        "",
        "A star marks the status `converged`.",
        "",
        "| object | wall | ms | " + " | ".join(used) + " |",
        "|---" * (3 + len(used)) + "|",
    ]
    places = sorted(
        {(x["object"], x["wall"], x["exposure_ms"]) for x in chosen},
        key=lambda p: (p[0], WALLS.index(p[1]), p[2]),
    )
    for place in places:
        cells = []
        for method in used:
            found = [
                x
                for x in chosen
                if (x["object"], x["wall"], x["exposure_ms"]) == place and x["method"] == method
            ]
            cells.append(_cell(found[0]) if found else "")
        rows.append("| " + " | ".join([*map(str, place), *cells]) + " |")
    return "\n".join(rows)


def _cell(line: Line) -> str:
    if "correlation" not in line:
        return line["status"]
    star = "*" if line["status"] == "converged" else ""
    return f"{line['correlation']:.3f}{star}"


def _warm(lines: list[Line]) -> str:
    """Cold against warm starts."""
    rows = []
    for line in lines:
        place = f"{line['object']}, {line['wall']}, {line['exposure_ms']} ms"
        if line["method"] == "wu2024_warm" and "correlation" in line:
            rows.append(
                f"| wu2024 | {place} | {line['cold_iterations_to_fit']} | "
                f"{line['warm_iterations_to_fit']} | {line['cold_correlation']:.3f} | "
                f"{line['correlation']:.3f} |"
            )
        if line["method"] == "evidence_2frames_warm" and "correlation" in line:
            for cold in lines:
                same = all(cold[k] == line[k] for k in ("object", "wall", "exposure_ms", "size"))
                if same and cold["method"] == "evidence_2frames":
                    rows.append(
                        f"| evidence, two frames | {place} | {cold['iterations']} | "
                        f"{line['iterations']} | {cold['correlation']:.3f} | "
                        f"{line['correlation']:.3f} |"
                    )
    if not rows:
        return ""
    head = (
        "### Cold and warm starts\n\nwu2024: iterations until the residual is within 2 % of the "
        "least of the cold run; evidence: answers tried.\n\n| recipe | case | cold "
        "iterations | warm iterations | cold correlation | warm correlation |\n" + "|---" * 6 + "|"
    )
    return "\n".join([head, *rows])


def _verdicts(lines: list[Line]) -> str:
    """Means and verdicts by method, scale "wall"."""
    rows = []
    for method in FAMILY:
        found = [
            x
            for x in lines
            if x["method"] == method and x["scale"] == "wall" and "correlation" in x
        ]
        if not found:
            continue
        values = np.array([x["correlation"] for x in found])
        said = np.array([x["status"] == "converged" for x in found])
        told = f"{int(np.sum(said & (values <= 0.9)))}" if method != "image" else ""
        rows.append(
            f"| {method} | {len(found)} | {np.median(values):.3f} | {values.min():.3f} | "
            f"{int(np.sum(values > 0.9))} | {told} | "
            f"{np.median([x['seconds'] for x in found]):.2f} |"
        )
    if not rows:
        return ""
    head = (
        "### Methods over all cases of scale: wall\n\n| method | cases | median correlation | least"
        " | above 0.9 | converged but not above 0.9 | median seconds |\n" + "|---" * 7 + "|"
    )
    return "\n".join([head, *rows])


def _all(lines: list[Line]) -> str:
    rows = [
        "### All cases",
        "",
        "| scale | object | wall | ms | method | " + " | ".join(COLUMNS) + " |",
        "|---" * (5 + len(COLUMNS)) + "|",
    ]
    for line in lines:
        place = [line[k] for k in ("scale", "object", "wall", "exposure_ms", "method")]
        cells = [_figure(name, line.get(name)) for name in COLUMNS]
        rows.append("| " + " | ".join(map(str, [*place, *cells])) + " |")
    return "\n".join(rows)


def _figure(name: str, value: Any) -> str:
    digits = {"correlation": 3, "psnr": 1, "ssim": 3, "seconds": 2}.get(name)
    return "" if value is None else str(value) if digits is None else f"{value:.{digits}f}"


def _pictures(lines: list[Line], folder: Path) -> None:
    """Rows of pictures for each question, of what there is."""
    at = {"scale": "wall", "object": "letter", "wall": "concave", "exposure_ms": 40}
    _rows(lines, folder / "walls.png", at, "wall", WALLS, FAMILY)
    _rows(lines, folder / "exposures.png", at, "exposure_ms", (10, 20, 30, 40), FAMILY)
    objects = ("letter", "posed", "cartoon", "hanzi", "tilted")
    _rows(lines, folder / "objects.png", at, "object", objects, FAMILY)
    known = ("image", "inverse_filter", "tv")
    paper = {**at, "scale": "paper", "wall": "flat"}
    _rows(lines, folder / "paper_exposures.png", paper, "exposure_ms", (10, 20, 30, 40), known)
    _rows(lines, folder / "paper_walls.png", paper, "wall", WALLS, known)


def _rows(
    lines: list[Line],
    path: Path,
    fixed: Line,
    varied: str,
    values: tuple[Any, ...],
    chosen: tuple[str, ...],
) -> None:
    """One picture: a row for each value, a column for each method, the truth last."""
    cases = {
        (x[varied], x["method"]): x
        for x in lines
        if all(x[k] == v for k, v in fixed.items() if k != varied)
    }
    rows = [v for v in values if any((v, m) in cases for m in chosen)]
    used = [m for m in chosen if any((v, m) in cases for v in rows)]
    if not rows:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.25 * (len(used) + 1), 1.4 * len(rows) + 0.2), layout="constrained")
    axes = figure.subplots(len(rows), len(used) + 1, squeeze=False)
    for row, value in zip(axes, rows, strict=True):
        row[0].set_ylabel(f"{value} ms" if varied == "exposure_ms" else str(value), fontsize=8)
        for axis, method in zip(row, [*used, "truth"], strict=True):
            case = cases.get((value, method)) or next(
                (cases[value, m] for m in used if method == "truth" and (value, m) in cases), None
            )
            _panel(axis, case, method, folder=path.parent)
    for axis, method in zip(axes[0], [*used, "truth"], strict=True):
        axis.text(
            0.5, 1.22, method.replace("_", "\n"), transform=axis.transAxes, ha="center", fontsize=7
        )
    figure.savefig(path, dpi=100)


def _panel(axis: Any, case: Line | None, method: str, *, folder: Path) -> None:
    axis.set_xticks([])
    axis.set_yticks([])
    axis.spines[:].set_visible(False)
    if case is None:
        return
    what = method if method in ("image", "truth") else "object"
    path = folder / "objects" / f"{name_of(case, what)}.npy"
    if path.exists():
        shown: Callable[[Any], Any] = np.asarray
        axis.imshow(shown(np.load(path)).astype(np.float32), cmap="gray", interpolation="nearest")
    if method != "truth":
        axis.set_title(_cell(case), fontsize=7, pad=2)
