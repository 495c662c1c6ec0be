"""The page and the pictures of what the study found."""

from __future__ import annotations

import platform
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import phasor_cases as cases
import phasor_claims as claims
import phasor_figures as figures
import phasor_scenes as scenes

Line = dict[str, Any]

LABELS = {
    "lambert": "Lambert",
    "ward-1": "Ward 1.0",
    "ward-0.4": "Ward 0.4",
    "ward-0.2": "Ward 0.2",
}


def write(lines: list[Line], folder: Path, setting: str, left: list[Line]) -> None:
    """RESULTS.md and results/*.png, of whatever is finished; ``left`` are the cases not run."""
    done = [line for line in lines if line["status"] == "done"]
    (folder / "results").mkdir(parents=True, exist_ok=True)
    if not done:
        return
    table = claims.table(done)
    done = [line for line in done if line["material"] in LABELS]
    drawn = figures.draw(done, folder, LABELS)
    parts = [
        _head(done, setting, len(lines) - len(done)),
        _left_out(left),
        table,
        *(f"![{text.split(' (as')[0]}](results/{name})\n\n{text}" for name, text in drawn),
        _why(done, folder),
        _depths(done),
        _spreads(done),
        _bounces(done),
        _seconds(done),
    ]
    (folder / "RESULTS.md").write_text("\n\n".join(part for part in parts if part) + "\n")


def _head(lines: list[Line], setting: str, refused: int) -> str:
    some = lines[0]
    scenes = []
    for name in _all(lines, "scene"):
        chosen = [x for x in lines if x["scene"] == name]
        waves = " and ".join(f"{1e2 * w:.3g}" for w in _all(chosen, "wavelength"))
        pitch = 179.2 / chosen[0]["points"]
        scenes.append(
            f"{name}: {chosen[0]['points']} x {chosen[0]['points']} laser points {pitch:.3g} cm "
            f"apart, {_triangles(chosen[0])} triangles, wavelengths {waves} cm, bins of "
            f"{1e2 * chosen[0]['bin']:.2g} cm"
        )
    count = len(_all(lines, "seed"))
    seeds = f"{count} seed{'s' if count > 1 else ''}"
    text = f"""Made by `study.py --setting {setting}`: {len(lines)} cases, {refused} refused.
{"; ".join(scenes)}. Up to {seeds} and {some["max_bounces"]} bounces; seconds
are of a shared machine ({platform.machine()}). The error of depths is the mean of its absolute
value over the cells that the best threshold leaves, which must be half of the true ones at
least."""
    return "# Reflectance and phasor fields: what came out\n\n" + textwrap.fill(text, 100)


def _triangles(line: Line) -> int:
    """Of the hidden objects, without the corridor."""
    return sum(len(mesh.faces) for mesh in scenes.objects(line["scene"], cell=line["cell"]))


def _left_out(left: list[Line]) -> str:
    """Which cases of the setting were not run."""
    if not left:
        return ""
    counts: Counter[str] = Counter()
    for key in left:
        what = "further seeds" if key["seed"] else "three bounces alone"
        alone = key["seed"] or key["bounces"] < key["max_bounces"]
        label = LABELS.get(key["material"], key["material"])
        counts[f"{key['scene']}, {label}{f', {what}' if alone else ''}"] += 1
    rows = "; ".join(f"{name}: {count}" for name, count in counts.items())
    return textwrap.fill(f"Not run are {len(left)} cases more of this setting. {rows}.", 100)


def _why(lines: list[Line], folder: Path) -> str:
    """What the aperture does, with the figures that show it."""
    told = []
    for line in lines:
        kept = cases.kept_pictures(line, folder)
        first = line["seed"] == 0 and line["bounces"] == line["max_bounces"]
        if kept is None or not first or line["material"] != "lambert":
            continue
        grid = scenes.volume(line["scene"], line["voxel"])
        outline = np.isfinite(kept["truth"])
        shares = cases.mirrored(grid, kept["light"], outline, line["aperture"])
        told.append(
            f"| {line['scene']} | {1e2 * line['wavelength']:.3g} | {1e2 * line['voxel']:.3g} | "
            f"{line['aperture']:g} | {shares[0]:.2f} | {shares[1]:.2f} |"
        )
    head = """## Why

A depth is told by the length of the path: the pulse is as long at any aperture. The aperture acts
on depth through what it shows at all, and sideways:

- To waves of centimetres a flat face is a mirror, whatever light does on it: the phase decides.
  Before one sensor in the middle, a face parallel to the wall shows half way to each laser, within
  a quarter of the aperture from the middle; beyond, its edges alone send waves back. Below is how
  much of the outline lies there, and how much of its brightness does (Lambert).
- Columns without waves of their own take the depth of what is bright beside them, which through a
  narrow aperture reaches farther: the letters are 0.45 m apart, so that a few such columns decide
  the mean. The threshold can leave them out only down to half of the true cells.
- A wide lobe scales all of that by one number, and one scale for all changes no depth. A narrow one
  takes light from edges, which alone tell of the letters' columns without mirror points.
- A rounded form has mirror points at any aperture, on either side of the middle, and no second
  surface 0.45 m behind the first. So the dragon's error falls less with the aperture and rises less
  with a narrower lobe. The best threshold is each aperture's own and keeps other columns; over all
  true cells (above) apertures are compared on the same ones.

| scene | wavelength, cm | voxel, cm | aperture, m | of the outline | of the brightness |
|---|---|---|---|---|---|
"""
    return head + "\n".join(told)


def _depths(lines: list[Line]) -> str:
    rows = [
        "## Mean absolute error of depth",
        "",
        "mm, mean and standard deviation over seeds and over four places of the voxels' planes;"
        " peaks found between voxels, in brackets the brightest voxels alone. Of the widest"
        " aperture also the error without a threshold, over all true cells, the coverage by the"
        " best threshold, and the overlap with the outline.",
        "",
    ]
    apertures = _all(lines, "aperture")
    head = " | ".join(f"{a:g} m" for a in apertures)
    rows.append(
        f"| scene | wavelength, cm | voxel, cm | material | {head} "
        "| all cells | coverage | overlap |"
    )
    rows.append("|---" * (7 + len(apertures)) + "|")
    deepest = [x for x in lines if x["bounces"] == x["max_bounces"]]
    for place in claims.places(deepest):
        here = claims.chosen(deepest, place)
        for material in _all(here, "material"):
            cells = []
            for aperture in apertures:
                found = claims.chosen(deepest, place, material=material, aperture=aperture)
                fine, coarse = claims.all_of(found, "mae"), claims.all_of(found, "mae_voxels")
                cells.append(
                    f"{1e3 * fine.mean():.1f} ± {1e3 * fine.std():.1f} ({1e3 * coarse.mean():.1f})"
                    if fine.size
                    else ""
                )
            last = claims.chosen(deepest, place, material=material, aperture=apertures[-1])
            cells.append(f"{1e3 * claims.all_of(last, 'mae_all').mean():.1f}" if last else "")
            for name in ("coverage", "overlap"):
                cells.append(f"{claims.all_of(last, name).mean():.2f}" if last else "")
            where = [place["scene"], f"{1e2 * place['wavelength']:.3g}"]
            where += [f"{1e2 * place['voxel']:.3g}", LABELS[material]]
            rows.append("| " + " | ".join([*where, *cells]) + " |")
    return "\n".join(rows)


def _spreads(lines: list[Line]) -> str:
    """What the error varies by: seeds, and places of the planes."""
    deepest = [x for x in lines if x["bounces"] == x["max_bounces"]]
    rows = [
        "## Where the spread comes from",
        "",
        "Standard deviations of the error, mm: over seeds of the light of more than three bounces,"
        " and over places of the planes; medians over materials and apertures.",
        "",
        "| scene | wavelength, cm | voxel, cm | seeds | planes |",
        "|---|---|---|---|---|",
    ]
    for place in claims.places(deepest):
        seeds, planes = [], []
        for material in _all(deepest, "material"):
            for aperture in _all(deepest, "aperture"):
                found = claims.chosen(deepest, place, material=material, aperture=aperture)
                values = np.array([x["mae"] for x in found])
                if len(values) > 1:
                    seeds.append(values.mean(axis=1).std())
                if values.size:
                    planes.append(values.mean(axis=0).std())
        rows.append(
            f"| {place['scene']} | {1e2 * place['wavelength']:.3g} | {1e2 * place['voxel']:.3g} | "
            f"{f'{1e3 * np.median(seeds):.2f}' if seeds else 'one seed'} | "
            f"{1e3 * np.median(planes):.2f} |"
        )
    return "\n".join(rows)


def _bounces(lines: list[Line]) -> str:
    """Light by number of bounces, and what the further ones do to depths."""
    most = max(x["max_bounces"] for x in lines)
    rows = [
        "## Bounces",
        "",
        "Shares of the light within the bins, the corridor's included, the standard error of that"
        f" drawn at random (bins' sum over the light's), and the error of depth by three bounces"
        f" alone and by {most}, mm, at the finest wavelength, the smallest voxels and the widest"
        " aperture.",
        "",
        "| scene | material | "
        + " | ".join(map(str, range(3, most + 1)))
        + f" | standard error | error by 3 | by {most} |",
        "|---" * (3 + most) + "|",
    ]
    for name in _all(lines, "scene"):
        here = [x for x in lines if x["scene"] == name]
        place = claims.places(here)[0]
        for material in _all(here, "material"):
            widest = max(_all(here, "aperture"))
            found = claims.chosen(here, place, material=material, aperture=widest, seed=0)
            by = {x["bounces"]: x for x in found}
            if len(by) < 2:
                continue
            light = by[most]["light"]
            total = sum(light.values())
            cells = [f"{light[str(n)] / total:.3f}" for n in range(3, most + 1)]
            cells.append(f"{by[most]['error_of_bins']:.3f}")
            cells += [f"{1e3 * np.mean(by[n]['mae']):.1f}" for n in (3, most)]
            rows.append("| " + " | ".join([name, LABELS[material], *cells]) + " |")
    return "\n".join(rows)


def _seconds(lines: list[Line]) -> str:
    rows = [
        "## Run times",
        "",
        "Wall seconds: of a render (median over seeds, all bounces), and of one picture (median,"
        " and the least).",
        "",
        "| scene | material | render | picture | least |",
        "|---|---|---|---|---|",
    ]
    for name in _all(lines, "scene"):
        for material in _all(lines, "material"):
            found = [x for x in lines if x["scene"] == name and x["material"] == material]
            deep = [x["render_seconds"] for x in found if x["bounces"] == x["max_bounces"]]
            if deep:
                taken = [x["seconds"] for x in found]
                rows.append(
                    f"| {name} | {LABELS[material]} | {np.median(deep):.1f} | "
                    f"{np.median(taken):.3f} | {min(taken):.3f} |"
                )
    return "\n".join(rows)


def _all(lines: Iterable[Line], name: str) -> list[Any]:
    """Values of a key, in the order of the materials or rising."""
    order: Callable[[Any], Any] = (
        list(LABELS).index if name == "material" else (lambda v: (v != "letters", v))
    )
    if name not in ("material", "scene"):
        order = float
    return sorted({line[name] for line in lines}, key=order)
