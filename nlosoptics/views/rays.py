"""Light paths as lines in 3-D: selection of the paths, and their colours."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import counted, one_of, whole
from ..errors import SceneError
from ..raytrace.fans.paths import DETECTED
from .canvas import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION, pyvista

if TYPE_CHECKING:
    from pyvista import PolyData

    from ..psf import Wavefront
    from ..raytrace import RayPaths

#: Name of the data array and title of the colour bar for each value of ``colour``.
COLOURS = {
    "bounces": ("preceding reflections", "preceding reflections"),
    "path_length": ("path length", "path length from the source (m)"),
    "weight": ("power", "power of the path (W)"),
    "aberration": ("aberration", "wave aberration (waves)"),
}
#: Colours of the segments of a path, by the number of preceding reflections.
LEGS = (VERMILION, ORANGE, SKY, PURPLE, GREEN, BLUE, BLACK)


def chosen_paths(
    paths: RayPaths, *, n_bounces: int | None, only_detected: bool, most: int
) -> NDArray[np.int64]:
    """Return the indices (n,) of the paths to draw, in increasing order.

    Paths that met the hidden object come first: others are drawn only if these are fewer than
    ``most``.

    Raises
    ------
    SceneError
        If there is none.
    """
    whole("most", most)
    if not len(paths.weight):
        raise SceneError(
            "there are no paths to draw; trace with keep_paths=True, and with more rays or bounces "
            "if no power was detected"
        )
    wanted = np.ones(len(paths.weight), dtype=bool)
    if only_detected:
        wanted &= paths.status == DETECTED
        if not wanted.any():
            raise SceneError(
                f"none of {counted(len(wanted), 'path')} reaches the detector; pass "
                "only_detected=False to see where they end"
            )
    if n_bounces is not None:
        whole("n_bounces", n_bounces, 0)
        there = np.unique(paths.n_bounces[wanted])
        wanted &= paths.n_bounces == n_bounces
        if not wanted.any():
            raise SceneError(
                f"no path has n_bounces = {n_bounces}; choose from {', '.join(map(str, there))}"
            )
    chosen: list[NDArray[np.int64]] = []
    for kind in (paths.met_object, ~paths.met_object):
        found = np.flatnonzero(wanted & kind)
        left = most - sum(map(len, chosen))
        if left and len(found):
            chosen.append(found[_by_power(paths.weight[found], left)])
    return np.sort(np.concatenate(chosen))


def _by_power(weight: NDArray[np.float64], most: int) -> NDArray[np.int64]:
    """Return indices of ``most`` paths, drawn in proportion to their ``weight`` (n,)."""
    if len(weight) <= most:
        return np.arange(len(weight))
    power = weight if np.count_nonzero(weight) > most else np.ones(len(weight))
    return np.random.default_rng(0).choice(len(weight), most, replace=False, p=power / power.sum())


def path_lines(
    paths: RayPaths, chosen: NDArray[np.int64], *, colour: str, wavefront: Wavefront | None
) -> PolyData:
    """Return all segments of the chosen paths as one set of two-point lines.

    Raises
    ------
    SceneError
        If ``colour`` is unknown, or ``wavefront`` is missing or does not belong to the paths.
    """
    one_of("colour", colour, COLOURS)
    points = paths.points[chosen]
    legs = np.linalg.norm(np.diff(points, axis=1), axis=2)
    path, leg = np.nonzero(legs > 0.0)  # shorter paths repeat their last point
    ends = np.stack([points[path, leg], points[path, leg + 1]], axis=1)
    lines = pyvista().line_segments_from_points(ends.reshape(-1, 3))
    lines.cell_data["path"] = chosen[path]
    lines.cell_data["preceding reflections"] = leg
    if colour == "path_length":
        run = np.concatenate([np.zeros((len(chosen), 1)), np.cumsum(legs, axis=1)], axis=1)
        lines.point_data["path length"] = np.stack(
            [run[path, leg], run[path, leg + 1]], axis=1
        ).ravel()
    elif colour == "weight":
        lines.cell_data["power"] = paths.weight[chosen][path]
    elif colour == "aberration":
        lines.cell_data["aberration"] = _aberrations(paths, chosen, wavefront)[path]
    return lines


def _aberrations(
    paths: RayPaths, chosen: NDArray[np.int64], wavefront: Wavefront | None
) -> NDArray[np.float64]:
    """Return the wave aberration (n,) of the chosen paths, waves."""
    if wavefront is None:
        raise SceneError(
            "colour = 'aberration' needs wavefront=; compute it by psf.wavefront_from_rays from "
            "the paths of raytrace.pupil_rays"
        )
    detected = np.flatnonzero(paths.status == DETECTED)
    if wavefront.aberration.shape != detected.shape:
        raise SceneError(
            f"wavefront has {wavefront.aberration.size} nodes, must have {len(detected)} like the "
            "detected paths; compute it by psf.wavefront_from_rays"
        )
    if not np.isin(chosen, detected).all():
        raise SceneError(
            "paths that miss the detector have no aberration; pass only_detected=True for "
            "colour = 'aberration'"
        )
    return np.asarray(
        wavefront.aberration[np.searchsorted(detected, chosen)] / wavefront.wavelength
    )


def colour_style(colour: str, values: NDArray[Any]) -> dict[str, Any]:
    """Return pyvista's colour arguments, and ``bar`` and ``steps`` for the colour bar."""
    from matplotlib.colors import ListedColormap

    low, high = float(values.min()), float(values.max())
    if colour == "bounces":
        count = int(high) + 1
        return {
            "cmap": ListedColormap([LEGS[min(k, len(LEGS) - 1)] for k in range(count)]),
            "clim": (-0.5, count - 0.5),
            "bar": {"fmt": "%.0f"},
            "steps": list(range(count)),
        }
    if colour == "aberration":
        largest = max(-low, high) or 1.0
        # light grey in the middle, where RdBu would be invisible on white
        return {"cmap": "coolwarm", "clim": (-largest, largest), "bar": {"fmt": "%.3g"}}
    if colour == "weight":
        high = high or 1.0
        low = min(max(low, high * 1e-6), high / 10.0)
        return {
            "cmap": dark_viridis(),
            "clim": (low, high),
            "log_scale": True,
            "bar": {"fmt": "%.1e"},
        }
    # four steps of two digits, so that the labels are round
    power = 10.0 ** (math.floor(math.log10(high / 4)) - 1) if high > 0.0 else 0.25
    high = 4 * power * math.ceil(high / 4 / power * (1 - 1e-9) or 1)
    return {"cmap": dark_viridis(), "clim": (0.0, high), "bar": {"fmt": "%.3g", "n_labels": 5}}


def dark_viridis() -> Any:
    """Return the part of the viridis colour map that is visible on white."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.86, 256)))
