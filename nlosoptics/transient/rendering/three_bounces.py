"""Light by three reflections, wall, hidden surface, wall, by quadrature that adapts itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory
from ..._progress import Progress
from ...errors import SamplingError, SceneError
from .surfaces import HiddenSurfaces, Mesh, occluders

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Triangles up to which it is asked beforehand whether any stands before another's plane.
ASKED = 8000
#: Parts of the surface at which one pair of points is given up.
MOST_PARTS = 20_000_000
#: Blocks of pairs that threads share, and most pairs at a time.
BLOCKS, MOST_PAIRS = 64, 1 << 16
#: Most triangles times points of which it is kept whether one sees the other, and most polygons
#: of triangles that a point sees in part, which take a quarter of a KiB each.
MOST_SIGHTS, MOST_KEPT = 1 << 26, 1 << 20


@dataclass(frozen=True, eq=False)
class ThreeBounces:
    """Impulse responses of pairs of wall points, and how they were found.

    Parameters
    ----------
    G : ndarray
        (pairs, n_bins), 1/m^2, without the wall's albedo.
    before, after : ndarray
        (pairs,), 1/m^2, of paths shorter and longer than the bins.
    error : ndarray
        (pairs,), 1/m^2, summed over bins: by how much the last two passes differ.
    parts : ndarray of int64
        (pairs,), parts of the surface in the last pass.
    shadows : bool
        Whether they were looked for: not where no triangle can stand before another's plane, which
        is told of up to `ASKED` triangles.
    """

    G: Array
    before: Array
    after: Array
    error: Array
    parts: NDArray[np.int64]
    shadows: bool


def three_bounces(
    surfaces: HiddenSurfaces,
    lasers: Array,
    sensors: Array,
    *,
    starts: Array,
    delta_t: float,
    n_bins: int,
    tol: float,
    progress: Progress | None = None,
) -> ThreeBounces:
    """Integrate over the hidden surfaces for pairs of points on the wall z = 0.

    Parameters
    ----------
    surfaces : HiddenSurfaces
    lasers, sensors : ndarray
        (pairs, 3), m, z = 0.
    starts : ndarray
        (pairs,), m of r1 + r2, where bin 0 begins.
    delta_t : float
        m.
    n_bins : int
    tol : float
        Relative L1 error over the bins of each pair.
    progress : callable(str, float), optional
        Told what is being done and the fraction done.

    Returns
    -------
    ThreeBounces

    Raises
    ------
    SceneError
        If a wall point lies on a surface.
    SamplingError
        If a pair does not reach ``tol``.
    MemoryLimitError
        If the bins do not fit.

    Notes
    -----
    ``G = (1/pi) Int cos_l cos_h1 f cos_h2 cos_c / (r1^2 r2^2) V dA``, with f the hidden material's
    bidirectional reflectance; physics as in O'Toole et al., Nature 555, 338 (2018), with all
    cosines. Shadows are cut out as polygons, so that V leaves no error. What is left is halved
    until no part errs by a limit, by its middle against its corners; path and integrand are taken
    as linear over a part, with the means of quadratic ones, and spread over the bins in closed
    form. The limit falls until two passes agree. Nothing is drawn at random.
    """
    from . import _three_bounce_kernels as kernels
    from . import _visibility_kernels

    count = len(lasers)
    fits_memory(
        f"{count} responses of {n_bins} bins",
        40.0 * count * (n_bins + 2),  # with the copies that become a capture
        "take fewer points or bins",
    )
    mesh, names = occluders(surfaces)
    rows, reach = mesh[0], mesh[2]
    _check_apart(surfaces.corners, np.concatenate([lasers, sensors]), reach)
    n_triangles = len(names)
    clear = np.zeros((n_triangles, 2), dtype=np.bool_)
    if n_triangles <= ASKED:
        clear = _visibility_kernels.clear_sides(rows, reach)
    world = (surfaces.lobes, surfaces.spans[names], surfaces.alphas[names])
    out, report = np.empty((count, n_bins + 2)), np.empty((count, kernels.REPORT))
    lasers, sensors, lights, sight, turned = _shared(lasers, sensors)
    # what a point sees is kept where others see by it, and need not be asked again
    shared = 2 * len(lights) <= count and len(lights) * n_triangles <= MOST_SIGHTS
    if not shared:
        lights, sight = lights[:1], np.zeros_like(sight)
    known = _sights(mesh, clear, lights, shared and not clear.all())
    # few at first, so that what is out of reach is told soon
    first, step = 0, 64
    while first < count:
        part = slice(first, min(first + step, count))
        blocks = np.unique(np.linspace(0, part.stop - first, BLOCKS + 1).astype(np.int64))
        kernels.three_bounces(
            mesh,
            clear,
            world,
            lasers[part],
            sensors[part],
            turned[part],
            sight[part],
            known,
            starts[part],
            delta_t,
            tol,
            MOST_PARTS,
            blocks,
            out[part],
            report[part],
        )
        _check_done(report[part], lasers[part], sensors[part], tol)
        if progress is not None:
            progress(f"three bounces: {part.stop} of {count} pairs of points", part.stop / count)
        first, step = part.stop, min(4 * step, MOST_PAIRS if progress is None else count // 50 + 64)
    return ThreeBounces(
        out[:, 1:-1],
        out[:, 0],
        out[:, -1],
        report[:, kernels.ERROR],
        report[:, kernels.LEAVES].astype(np.int64),
        bool(not clear.all()),
    )


def _shared(lasers: Array, sensors: Array) -> tuple[Array, Array, Array, Index, NDArray[np.bool_]]:
    """Pairs with the fewer different points first, those points, and which of them each pair has.

    G is the same both ways. The last array says for each pair whether its second point's shadows
    are cut out first. The endpoint that more pairs share goes first, or the lower one if both are
    shared equally. Swapping source and sensor then performs identical arithmetic, so reciprocity
    holds bit for bit.
    """
    points, places = np.unique(np.concatenate([lasers, sensors]), axis=0, return_inverse=True)
    first, second = places.reshape(2, -1)
    pairs = np.bincount(first, minlength=len(points)) + np.bincount(second, minlength=len(points))
    # unique points are sorted
    turned = (pairs[second] > pairs[first]) | ((pairs[second] == pairs[first]) & (second < first))
    if len(np.unique(second)) < len(np.unique(first)):
        lasers, sensors, first, turned = sensors, lasers, second, (first != second) & ~turned
    lights, sight = np.unique(first, return_inverse=True)
    return lasers, sensors, points[lights], sight.reshape(-1), turned


def _sights(mesh: Mesh, clear: NDArray[np.bool_], lights: Array, ask: bool) -> Any:
    """What each of ``lights`` sees of each triangle, and the polygons of what it sees in part.

    Last whether that is all that need be known of these points.
    """
    from . import _three_bounce_kernels as kernels
    from ._visibility_kernels import CORNERS

    shape = len(lights), len(mesh[0])
    known = np.full(shape, kernels.PART, dtype=np.int8)
    ends = np.zeros((shape[0], shape[1] + 1), dtype=np.int32)
    kept, sizes = np.empty((0, 2 * CORNERS)), np.empty(0, dtype=np.int64)
    told = False
    if ask:
        world = mesh, clear, lights, known, ends
        kernels.sights(*world, kept, sizes)
        total = int(ends.sum(dtype=np.int64))
        # in part, yet in no polygon: there were too many, which the pairs shall tell
        told = total <= MOST_KEPT and not ((known == kernels.PART) & (ends[:, 1:] == 0)).any()
        if told and total:
            ends = np.cumsum(ends.ravel(), dtype=np.int32).reshape(ends.shape)
            kept, sizes = np.empty((total, 2 * CORNERS)), np.empty(total, dtype=np.int64)
            kernels.sights(*world[:-1], ends, kept, sizes)
        else:
            ends[:] = 0
    return known, ends, kept, sizes, told


def _check_done(report: Array, lasers: Array, sensors: Array, tol: float) -> None:
    from . import _three_bounce_kernels as kernels
    from ._visibility_kernels import PIECES

    status = report[:, kernels.STATUS]
    wrong = np.flatnonzero(status != kernels.DONE)
    if not len(wrong):
        return
    i = int(wrong[0])
    where = (
        f"wall points ({lasers[i, 0]:g}, {lasers[i, 1]:g}) m and "
        f"({sensors[i, 0]:g}, {sensors[i, 1]:g}) m"
    )
    if status[i] == kernels.TOO_FINE:
        raise SamplingError(
            f"{where}: shadows cut one triangle into more than {PIECES} parts; split large "
            "triangles that stand behind many small ones"
        )
    raise SamplingError(
        f"{where}: three bounces need more than {MOST_PARTS} parts of the surface for tol = "
        f"{tol:g}; ask for a larger tol or wider bins"
    )


def _check_apart(corners: Array, points: Array, reach: float) -> None:
    """Raise where a wall point lies on a triangle: the light there has no bound."""
    touching = corners[corners[..., 2].min(axis=1) <= 1e-9 * reach]
    if not len(touching):
        return
    points = np.unique(points[:, :2], axis=0)
    for triangle in touching:
        low = np.flatnonzero(triangle[:, 2] <= 1e-9 * reach)
        a, b = triangle[low[0], :2], triangle[low[-1], :2]
        side, length = b - a, float((b - a) @ (b - a))
        share = np.clip((points - a) @ side / length, 0.0, 1.0) if length > 0.0 else 0.0
        gap = points - a - np.multiply.outer(share, side)
        distance = np.sqrt((gap * gap).sum(axis=-1))
        if distance.min() <= 1e-9 * reach:
            x, y = points[distance.argmin()]
            raise SceneError(
                f"the wall point ({x:g}, {y:g}) m lies on a hidden surface, where light has no "
                "bound; move the point or the surface"
            )
