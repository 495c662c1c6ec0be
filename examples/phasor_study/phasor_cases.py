"""One case of the study: a capture, its picture by the confocal camera, and how far depths are off.

Captures are kept in a folder and rendered once; light of three bounces, which draws nothing at
random, is shared by all seeds.
"""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import Any

import numpy as np
import phasor_scenes as scenes
from numpy.typing import NDArray

from nlosoptics import raytrace, transient
from nlosoptics.errors import NlosError

Array = NDArray[np.float64]
Key = dict[str, Any]

BEGIN = 1.0  # m of path: no light comes back before
OFFSETS = (0.0, 0.25, 0.5, 0.75)  # of a voxel, by which the planes are moved
FACING = 0.9  # cosine to the wall's normal from which a surface faces it

RENDERED = ("scene", "material", "points", "bin", "max_bounces", "tol", "n_rays", "cell")


def name_of(key: Key) -> str:
    """Name of a case, which tells it from all others of its setting."""
    parts = [
        key["scene"],
        key["material"],
        f"{key['points']}pts",
        f"wl{1e3 * key['wavelength']:g}",
        f"voxel{1e3 * key['voxel']:g}",
        f"aperture{1e3 * key['aperture']:g}",
        f"to{key['bounces']}",
        f"seed{key['seed']}",
    ]
    return "-".join(map(str, parts))


def capture_name(key: Key, seed: int | None) -> str:
    """Name of a rendered capture; the one of three bounces has no seed."""
    parts = [str(key[name]) for name in RENDERED]
    return "-".join(parts) + ("" if seed is None else f"-seed{seed}")


def capture_of(key: Key, folder: Path) -> transient.TransientCapture:
    """Light of a case up to its number of bounces, rendered unless it is in the folder."""
    three = _kept({**key, "max_bounces": 3, "n_rays": 0}, None, folder)
    if key["bounces"] == 3:
        return three
    more = _kept(key, key["seed"], folder)
    seconds = three.details["seconds"] + more.details["seconds"]
    parts = {3: three.by_bounce[3]} | {n: more.by_bounce[n] for n in range(4, key["bounces"] + 1)}
    return dataclasses.replace(
        three,
        H=np.sum(list(parts.values()), axis=0),
        by_bounce=parts,
        standard_error=more.standard_error,
        details={**more.details, "seconds": seconds},
    )


def _kept(key: Key, seed: int | None, folder: Path) -> transient.TransientCapture:
    path = folder / f"{capture_name(key, seed)}.hdf5"
    if path.exists():
        return transient.TransientCapture.load(path)
    capture = _rendered(key, seed)
    folder.mkdir(parents=True, exist_ok=True)
    capture.save(path)
    return capture


def _rendered(key: Key, seed: int | None) -> transient.TransientCapture:
    """More than three bounces of a seed; without one, three bounces alone."""
    deepest = scenes.DEPTHS[key["scene"]][1]
    aside = 0.5 * scenes.SIDE
    longest = math.hypot(aside, aside, deepest) + math.hypot(2 * aside, 2 * aside, deepest)
    # the pulse of the longest wave needs 4 standard deviations beyond the last path
    end = longest + 4.0 * key["longest"] / math.sqrt(2.0)
    return transient.render(
        scenes.surfaces(key["scene"], key["material"], cell=key["cell"]),
        transient.Scan(
            laser_points=transient.wall_grid(scenes.SIDE, key["points"]),
            sensor_points=np.zeros(3),
            t_start=BEGIN,
            delta_t=key["bin"],
            n_bins=math.ceil((end - BEGIN) / key["bin"]),
            wall_size=scenes.ROOM[:2],
        ),
        min_bounces=3 if seed is None else 4,
        max_bounces=key["max_bounces"],
        tol=key["tol"],
        tol_multiple=1e-2,
        n_rays=key["n_rays"] or None,
        seed=seed or 0,
    )


def solved(key: Key, folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """One line of results, and the pictures of the planes that are not moved."""
    try:
        capture = capture_of(key, folder / "captures")
        return _line(key, capture)
    except NlosError as problem:
        return {**key, "status": "refused", "error": str(problem)}, {}


def _line(key: Key, capture: transient.TransientCapture) -> tuple[dict[str, Any], dict[str, Array]]:
    meshes = scenes.objects(key["scene"], cell=key["cell"])
    figures: list[dict[str, Any]] = []
    pictures: dict[str, Array] = {}
    seconds = []
    notes: tuple[str, ...] = ()
    for offset in OFFSETS[: key["offsets"]]:
        grid = scenes.volume(key["scene"], key["voxel"], offset)
        start = time.perf_counter()
        image = transient.phasor_image(
            capture, grid, wl_mean=key["wavelength"], aperture=key["aperture"]
        )
        seconds.append(time.perf_counter() - start)
        notes = image.notes
        found, shown = measured(image, meshes)
        figures.append(found)
        pictures = pictures or shown
    line = {
        **key,
        "status": "done",
        **{name: [figure[name] for figure in figures] for name in figures[0]},
        "light": {str(n): float(part.sum()) for n, part in capture.by_bounce.items()},
        "error_of_bins": _error_of_bins(capture),
        "notes": list(notes),
        "render_seconds": float(capture.details["seconds"]),
        "seconds": min(seconds),
    }
    return line, pictures


def measured(
    image: transient.PhasorImage, meshes: list[Any]
) -> tuple[dict[str, Any], dict[str, Array]]:
    """How far a picture's depths are from the surfaces', by three measures, and the maps.

    - ``mae``: peaks found between voxels, against rays to the surfaces;
    - ``mae_voxels``: the brightest voxels, against the same rays;
    - ``mae_paper``: the brightest voxels, against the first voxels that hold a surface.
    """
    grid = image.volume
    truth = transient.true_depths(meshes, grid)
    peaks = transient.depth_map(image)
    best = transient.depth_error(peaks, truth)
    coarse = transient.depth_error(transient.depth_map(image, interpolate=False), truth)
    paper = transient.depth_error(
        transient.depth_map(image, interpolate=False), first_voxels(meshes, grid)
    )
    wrong = peaks.depth - truth
    wrong[~(peaks.confidence >= best.threshold)] = np.nan
    cosines = scenes.facing(meshes, grid)
    outline = np.isfinite(truth)
    straight = outline & (cosines >= FACING)
    aslant = outline & (cosines < FACING)
    off = np.abs(wrong[straight])
    figures = {
        "mae": best.mae,
        "mae_voxels": coarse.mae,
        "mae_paper": paper.mae,
        "mae_all": float(best.curve[0, 1]),
        "median": best.median,
        "threshold": best.threshold,
        "coverage": best.coverage,
        "false": best.false,
        "overlap": overlap(peaks.confidence, outline),
        "facing": _mean(peaks.confidence[straight]),
        "aslant": _mean(peaks.confidence[aslant]),
        "shown_facing": _mean(np.isfinite(off)),
        "mae_facing": _mean(off[np.isfinite(off)]),
        "brightest": float(image.intensity.max()),
    }
    shown = {"light": peaks.confidence, "truth": truth, "wrong": wrong}
    return figures, shown


def kept_pictures(line: dict[str, Any], folder: Path) -> dict[str, Array] | None:
    """Pictures of a finished case, where they were kept."""
    path = folder / "pictures" / f"{name_of(line)}.npz"
    if not path.exists():
        return None
    with np.load(path) as kept:
        return {name: kept[name] for name in kept.files}


def first_voxels(meshes: list[Any], grid: transient.Volume) -> Array:
    """(ny, nx): depth of the first voxel that holds a surface, m; NaN where none does."""
    full = voxelised(meshes, grid)
    return np.where(full.any(axis=0), grid.z[full.argmax(axis=0)], np.nan)


def voxelised(meshes: list[Any], grid: transient.Volume) -> NDArray[np.bool_]:
    """(nz, ny, nx): whether a surface crosses a voxel, by rays through centres along each axis."""
    axes = (grid.x, grid.y, grid.z)
    full = np.zeros([len(axis) for axis in axes], dtype=bool)
    for along, axis in enumerate(axes):
        others = [i for i in range(3) if i != along]
        rays = np.moveaxis(full, along, -1)  # a view
        pitch = axis[1] - axis[0]
        origins = np.empty((*rays.shape[:2], 3))
        origins[..., others[0]] = axes[others[0]][:, None]
        origins[..., others[1]] = axes[others[1]]
        origins[..., along] = axis[0] - 0.5 * pitch
        for mesh in meshes:
            hits = raytrace.all_hits(mesh, origins, np.eye(3)[along])
            level = np.floor(hits.distance / pitch).astype(np.int64)
            inside = level < len(axis)
            rows, columns = np.unravel_index(hits.ray[inside], rays.shape[:2])
            rays[rows, columns, level[inside]] = True
    return full.transpose(2, 1, 0)


def overlap(bright: Array, outline: NDArray[np.bool_]) -> float:
    """Intersection over union of an outline and what is brighter than the best of 100 levels."""
    shares = []
    for level in np.arange(1, 101) / 100.0:
        seen = bright >= level
        shares.append(float((seen & outline).sum() / (seen | outline).sum()))
    return max(shares)


def mirrored(
    grid: transient.Volume, light: Array, outline: NDArray[np.bool_], aperture: float
) -> tuple[float, float]:
    """Shares of outline and of its brightness where a mirror parallel to the wall would show.

    That is half way between the sensor in the middle and any laser: within a quarter of the
    aperture from the middle.
    """
    near = [np.abs(axis) < 0.25 * aperture for axis in (grid.y, grid.x)]
    within = near[0][:, None] & near[1] & outline
    return (
        float(within.sum() / outline.sum()),
        float(light[within].sum() / light[outline].sum()),
    )


def _mean(values: Array) -> float | None:
    return float(values.mean()) if values.size else None


def _error_of_bins(capture: transient.TransientCapture) -> float:
    """Standard error of bins over the light, both summed: that of what is drawn at random."""
    if capture.standard_error is None:
        return 0.0
    return float(capture.standard_error.sum() / capture.H.sum())
