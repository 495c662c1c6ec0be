"""Pictures after the paper's figures 3, 4 and 5; all seen from the wall, x to the left."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import phasor_cases as cases
import phasor_claims as claims
import phasor_scenes as scenes
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure

from nlosoptics import transient

Line = dict[str, Any]

#: Okabe and Ito's colours, told apart with any colour vision, with marks and dashes as well.
STYLES = (
    {"color": "#0072B2", "marker": "o", "linestyle": "-"},
    {"color": "#E69F00", "marker": "s", "linestyle": "--"},
    {"color": "#009E73", "marker": "^", "linestyle": ":"},
)
EXTENT = (-0.5 * scenes.SIDE, 0.5 * scenes.SIDE, -0.5 * scenes.SIDE, 0.5 * scenes.SIDE)
#: Figure 5 has the best and the worst that the paper expects, and one between.
SHOWN = (("lambert", 1.792), ("ward-0.4", 1.6), ("ward-0.2", 0.9))


def draw(lines: list[Line], folder: Path, labels: dict[str, str]) -> list[tuple[str, str]]:
    """Draw what there is; names of the files and what they show."""
    deepest = [x for x in lines if x["bounces"] == x["max_bounces"]]
    made = []
    for name in [n for n in scenes.DEPTHS if any(x["scene"] == n for x in deepest)]:
        here = [x for x in deepest if x["scene"] == name and x["seed"] == 0]
        # the finest wavelength with the smallest voxels comes first
        place = claims.places(here)[0]
        chosen = [x for x in here if all(x[k] == v for k, v in place.items())]
        told = (
            f"wavelength {1e2 * place['wavelength']:.3g} cm, voxels of "
            f"{1e2 * place['voxel']:.3g} cm"
        )
        if _irradiance(chosen, folder, f"irradiance_{name}.png", labels):
            made.append(
                (
                    f"irradiance_{name}.png",
                    f"Irradiance of the {name} by the confocal camera (as Fig. 3), the brightest "
                    f"voxel along each line of sight over the picture's brightest; {told}. First "
                    "column: the objects under a lamp at the wall.",
                )
            )
        if _errors(chosen, folder, f"depth_errors_{name}.png", labels):
            made.append(
                (
                    f"depth_errors_{name}.png",
                    f"Depths of the {name} and their errors (as Fig. 5), found minus true, where "
                    f"brighter than the best threshold; {told}.",
                )
            )
    if _curves(deepest, folder / "results" / "mae.png", labels):
        made.append(
            (
                "mae.png",
                "Mean absolute error of depth against the material (as Fig. 4); bars are standard "
                "deviations over seeds and places of the voxels' planes. Full marks: peaks found "
                "between voxels; empty ones: the brightest voxels. Grey: a quarter of a voxel.",
            )
        )
    return made


def _irradiance(lines: list[Line], folder: Path, name: str, labels: dict[str, str]) -> bool:
    materials = [m for m in labels if any(x["material"] == m for x in lines)]
    apertures = sorted({x["aperture"] for x in lines})
    found = {(x["material"], x["aperture"]): cases.kept_pictures(x, folder) for x in lines}
    if not any(found.values()):
        return False
    columns = len(apertures) + 1
    figure = Figure(
        figsize=(2.05 * columns + 0.8, 1.95 * len(materials) + 0.5), layout="constrained"
    )
    axes = figure.subplots(len(materials), columns, squeeze=False, sharex=True, sharey=True)
    shaded = _shaded(lines[0])
    drawn: Any = None
    for row, material in zip(axes, materials, strict=True):
        row[0].imshow(shaded, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=EXTENT)
        row[0].set_ylabel(f"{labels[material]}\ny (m)", fontsize=8)
        for axis, aperture in zip(row[1:], apertures, strict=True):
            kept = found.get((material, aperture))
            if kept is None:
                axis.set_axis_off()
                continue
            drawn = axis.imshow(
                kept["light"],
                cmap="inferno",
                norm=PowerNorm(0.5, 0.0, 1.0),  # or the far letter would be dark
                origin="lower",
                extent=EXTENT,
            )
    titles = ["the scene", *(f"aperture {a:g} m" for a in apertures)]
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, fontsize=9)
    _frame(axes)
    bar = figure.colorbar(drawn, ax=list(axes.ravel()), shrink=0.6)
    bar.set_label("relative irradiance, square root scale", fontsize=8)
    figure.savefig(folder / "results" / name, dpi=90, bbox_inches="tight", pad_inches=0.05)
    return True


def _shaded(line: Line) -> Any:
    """The objects as a lamp at the wall shows them, (128, 128); 0 where there is none."""
    meshes = scenes.objects(line["scene"], cell=line["cell"])
    grid = scenes.volume(line["scene"], scenes.SIDE / 128)
    depths = transient.true_depths(meshes, grid)
    lit = scenes.facing(meshes, grid) * (np.nanmin(depths) / depths) ** 2
    return np.nan_to_num(lit)


def _errors(lines: list[Line], folder: Path, name: str, labels: dict[str, str]) -> bool:
    found = []
    for material, aperture in SHOWN:
        for line in lines:
            if line["material"] == material and line["aperture"] == aperture:
                kept = cases.kept_pictures(line, folder)
                if kept is not None:
                    found.append((line, kept))
    if not found:
        return False
    figure = Figure(figsize=(2.6 * (len(found) + 1) + 1.2, 2.9), layout="constrained")
    axes = figure.subplots(1, len(found) + 1, squeeze=False, sharex=True, sharey=True)
    # viridis and PuOr are told apart with any colour vision; grey: nothing was found
    truth = axes[0, 0].imshow(found[0][1]["truth"], cmap="viridis", origin="lower", extent=EXTENT)
    axes[0, 0].set_title("true depth", fontsize=9)
    figure.colorbar(truth, ax=axes[0, 0], shrink=0.8).set_label("z (m)", fontsize=8)
    reach = 0.5 * lines[0]["wavelength"]
    drawn: Any = None
    for axis, (line, kept) in zip(axes[0, 1:], found, strict=True):
        missed = np.where(np.isfinite(kept["truth"]) & ~np.isfinite(kept["wrong"]), 0.6, np.nan)
        axis.imshow(missed, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=EXTENT)
        drawn = axis.imshow(
            1e3 * kept["wrong"],
            cmap="PuOr",
            vmin=-1e3 * reach,
            vmax=1e3 * reach,
            origin="lower",
            extent=EXTENT,
        )
        title = f"{labels[line['material']]}, {line['aperture']:g} m"
        axis.set_title(f"{title}\nMAE {1e3 * line['mae'][0]:.1f} mm", fontsize=9)
    axes[0, 0].set_ylabel("y (m)", fontsize=8)
    _frame(axes)
    bar = figure.colorbar(drawn, ax=list(axes[0, 1:]), shrink=0.8, extend="both")
    bar.set_label("error (mm); grey: below threshold", fontsize=8)
    figure.savefig(folder / "results" / name, dpi=90, bbox_inches="tight", pad_inches=0.05)
    return True


def _frame(axes: Any) -> None:
    """Square, seen from the wall; labels at the edges alone."""
    for axis in axes.ravel():
        axis.set_aspect("equal")
        axis.tick_params(labelsize=7)
    axes[0, 0].set_xlim(EXTENT[1], EXTENT[0])
    axes[0, 0].set_ylim(EXTENT[2], EXTENT[3])
    for axis in axes[-1]:
        axis.set_xlabel("x (m)", fontsize=8)


def _curves(lines: list[Line], path: Path, labels: dict[str, str]) -> bool:
    places = claims.places(lines)
    if not places:
        return False
    names = [n for n in scenes.DEPTHS if any(p["scene"] == n for p in places)]
    most = max(sum(p["scene"] == n for p in places) for n in names)
    figure = Figure(figsize=(3.0 * most + 0.4, 2.9 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), most, squeeze=False)
    for row, name in zip(axes, names, strict=True):
        here = [p for p in places if p["scene"] == name]
        for axis in row[len(here) :]:
            axis.set_axis_off()
        for axis, place in zip(row, here, strict=False):
            _panel(axis, lines, place, labels)
        row[0].set_ylabel("mean absolute error (mm)", fontsize=8)
    handles, told = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, told, loc="outside lower center", ncols=len(told), fontsize=8)
    figure.savefig(path, dpi=90, bbox_inches="tight", pad_inches=0.05)
    return True


def _panel(axis: Any, lines: list[Line], place: Line, labels: dict[str, str]) -> None:
    here = claims.chosen(lines, place)
    materials = [m for m in labels if any(x["material"] == m for x in here)]
    for i, aperture in enumerate(sorted({x["aperture"] for x in here})):
        style = STYLES[i % len(STYLES)]
        for measure, face in (("mae", style["color"]), ("mae_voxels", "none")):
            values = [
                1e3
                * claims.all_of(claims.chosen(here, place, material=m, aperture=aperture), measure)
                for m in materials
            ]
            axis.errorbar(
                np.arange(len(materials)) + 0.08 * (i - 1),
                [v.mean() for v in values],
                [v.std() for v in values],
                markerfacecolor=face,
                markersize=5,
                linewidth=1.2 if measure == "mae" else 0.5,
                capsize=2,
                label=f"aperture {aperture:g} m" if measure == "mae" else None,
                **style,
            )
    axis.axhline(250.0 * place["voxel"], color="0.6", linewidth=0.8)
    axis.set_xticks(range(len(materials)), [labels[m] for m in materials], fontsize=7)
    axis.tick_params(axis="y", labelsize=7)
    axis.set_ylim(bottom=0.0)
    axis.set_title(
        f"{place['scene']}, wavelength {1e2 * place['wavelength']:.3g} cm, "
        f"voxel {1e2 * place['voxel']:.3g} cm",
        fontsize=8,
    )
