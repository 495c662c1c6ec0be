"""Tables in Markdown and pictures of what the study found."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

Line = dict[str, Any]
Figures = Callable[[str], dict[int, list[tuple[str, str, int]]]]

FAMILY = (
    "box",
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
SUBJECTS = {
    5: "a letter, exposures",
    6: "another posture, exposures",
    7: "a cartoon and a Chinese character, exposures",
    8: "walls",
    9: "methods, 40 ms",
    10: "methods, tilted by 10 degrees, 40 ms",
    11: "methods, 20 ms",
}


def name_of(key: Line, what: str) -> str:
    """Name of a case's picture; its data's where `what` is "image" or "truth"."""
    parts = [key["scale"], key["object"], key["wall"], f"{key['exposure_ms']}ms", key["size"]]
    name = "-".join(map(str, [*parts, f"seed{key['seed']}"]))
    method = key["method"] if what == "object" else what
    return f"{name}-{method}"


def write(lines: list[Line], figures: Figures, folder: Path) -> None:
    """tables.md and the pictures, of whatever is finished."""
    plain = [x for x in lines if "box" in x]
    lines = [*lines, *({**x, "method": "box", "correlation": x["box"]} for x in plain)]
    parts = [_figure(lines, figures, number) for number in SUBJECTS]
    paper = [x for x in lines if x["scale"] == "paper"]
    rows = sorted({_row(x) for x in paper})
    if rows:
        table = _table([(x, "paper") for x in rows], lines)
        parts.append(f"### The paper's own scale\n\n{table}")
    parts += [_warm(lines), *(_verdicts(lines, scale) for scale in ("smooth", "rough"))]
    (folder / "tables.md").write_text("\n\n".join(part for part in parts if part) + "\n")
    _pictures(lines, folder)


def _row(line: Line) -> tuple[str, str, int]:
    return line["object"], line["wall"], line["exposure_ms"]


def _figure(lines: list[Line], figures: Figures, number: int) -> str:
    """Correlation by method (columns) of the rows of one of the paper's figures."""
    rows = [(row, scale) for scale in ("smooth", "rough") for row in figures(scale)[number]]
    return f"### Figure {number}: {SUBJECTS[number]}\n\n{_table(rows, lines)}"


def _table(rows: list[tuple[tuple[str, str, int], str]], lines: list[Line]) -> str:
    found: dict[Any, list[Line]] = {}
    for line in lines:
        found.setdefault((_row(line), line["scale"], line["method"]), []).append(line)
    used = [m for m in FAMILY if any((*row, m) in found for row in rows)]
    text = [
        "| regime | object | wall | ms | " + " | ".join(used) + " |",
        "|---" * (4 + len(used)) + "|",
    ]
    for row, scale in rows:
        cells = [_cell(found.get((row, scale, method), [])) for method in used]
        text.append("| " + " | ".join(map(str, [scale, *row, *cells])) + " |")
    return "\n".join(text)


def _cell(lines: list[Line]) -> str:
    """Median and least correlation, number of runs, a star for each that is called converged."""
    if not lines:
        return ""
    scores = [x["correlation"] for x in lines if "correlation" in x]
    if not scores:
        return str(lines[0]["status"])
    stars = "\\*" * sum(x["status"] == "converged" for x in lines)
    if len(lines) == 1:
        return f"{scores[0]:.3f}{stars} (1)"
    return f"{np.median(scores):.3f}, {min(scores):.3f}{stars} ({len(lines)})"


def _warm(lines: list[Line]) -> str:
    """Cold against warm starts of PCIN as published."""
    rows = [
        f"| {x['scale']}: {x['object']}, {x['wall']}, {x['exposure_ms']} ms | "
        f"{x['cold_iterations_to_fit']} | {x['warm_iterations_to_fit']} | "
        f"{x['cold_correlation']:.3f} | {x['correlation']:.3f} |"
        for x in lines
        if x["method"] == "wu2024_warm" and "correlation" in x
    ]
    if not rows:
        return ""
    head = (
        "### Cold and warm starts of PCIN as published\n\nIterations until the residual is within "
        "2 % of the least of the cold run.\n\n| case | cold iterations | warm iterations | cold "
        "correlation | warm correlation |\n" + "|---" * 5 + "|"
    )
    return "\n".join([head, *rows])


def _verdicts(lines: list[Line], scale: str) -> str:
    """Correlations, verdicts and seconds by method."""
    rows = []
    for method in FAMILY:
        found = [
            x for x in lines if x["method"] == method and x["scale"] == scale and "correlation" in x
        ]
        if not found:
            continue
        values = np.array([x["correlation"] for x in found])
        said = np.array([x["status"] == "converged" for x in found])
        rows.append(
            f"| {method} | {len(found)} | {np.median(values):.3f} | {values.min():.3f} | "
            f"{values.max():.3f} | {int(np.sum(values > 0.9))} | {int(np.sum(said))} | "
            f"{int(np.sum(said & (values <= 0.9)))} | "
            f"{np.median([x['seconds'] for x in found]):.2f} |"
        )
    if not rows:
        return ""
    head = (
        f"### Methods over all runs, {scale}\n\n| method | runs | median correlation | least | "
        "largest | above 0.9 | converged | converged, not above 0.9 | median seconds |\n"
        + "|---" * 9
        + "|"
    )
    return "\n".join([head, *rows])


def _pictures(lines: list[Line], folder: Path) -> None:
    """Rows of pictures for each question, of the first seed."""
    objects = ("letter", "posed", "cartoon", "hanzi", "tilted")
    times = (10, 20, 30, 40)
    for scale, base in (("smooth", "concave"), ("rough", "flat"), ("paper", "flat")):
        at = {"scale": scale, "object": "letter", "wall": base, "exposure_ms": 40, "seed": 1}
        walls = ("flat", "concave", "convex", "wavy")
        _rows(lines, folder / f"{scale}_walls.png", at, "wall", walls, FAMILY)
        _rows(lines, folder / f"{scale}_exposures.png", at, "exposure_ms", times, FAMILY)
        if scale != "paper":
            _rows(lines, folder / f"{scale}_objects.png", at, "object", objects, FAMILY)


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
    used = [m for m in chosen if m != "box" and any((v, m) in cases for v in rows)]
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
        score = case.get("correlation")
        star = "*" if case["status"] == "converged" else ""
        text = case["status"] if score is None else f"{score:.3f}{star}"
        axis.set_title(text, fontsize=7, pad=2)
