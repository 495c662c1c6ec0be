"""Three bounces (wall, hidden surface, wall) by adaptive quadrature over the hidden triangles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import counted, fits_memory
from ..._progress import Progress
from ...errors import SamplingError, SceneError
from .surfaces import HiddenSurfaces, Mesh, occluders

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Largest number of triangles for which free half-spaces are searched first, at quadratic cost.
ASKED = 8000
#: Largest number of parts of the surface for one pair of points.
MOST_PARTS = 20_000_000
#: Largest tables of visibility that are kept: triangles times points, and polygons of partly
#: visible triangles, which take 256 bytes each.
MOST_SIGHTS, MOST_KEPT = 1 << 26, 1 << 20


@dataclass(frozen=True, eq=False)
class ThreeBounces:
    """Impulse responses of pairs of wall points, with error estimates."""

    # (pairs, n_bins): impulse response, integrated over each bin, without the wall's albedo, 1/m^2
    G: Array
    before: Array  # (pairs,): contribution of paths shorter and longer than the bins, 1/m^2
    after: Array
    error: Array  # (pairs,): difference of the last two passes, summed over bins, 1/m^2
    parts: NDArray[np.int64]  # (pairs,): number of parts of the surface in the last pass
    # Whether shadows were searched. They are skipped if no triangle lies in front of another one's
    # plane, which is tested for up to `ASKED` triangles
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
    """Compute the impulse responses of three bounces for pairs of points on the wall z = 0.

    ``G = (1/pi) Int cos_l cos_h1 f cos_h2 cos_c / (r1^2 r2^2) V dA``, with f the bidirectional
    reflectance of the hidden material and V the visibility; physics as in O'Toole et al., Nature
    555, 338 (2018), with all cosines. Shadows are cut out as exact polygons. The visible parts are
    bisected until the error of each part, judged from its centroid against its corners, is below a
    limit. Path and integrand are linear over a part, with the means of quadratic interpolation, and
    are distributed over the bins in closed form. The limit is reduced until two passes agree. No
    random numbers are used.
    """
    from . import _three_bounce_kernels as kernels
    from . import _visibility_kernels

    count = len(lasers)
    fits_memory(
        f"{counted(count, 'response')} of {counted(n_bins, 'bin')}",
        40.0 * count * (n_bins + 2),  # with the copies that become a capture
        "give fewer points or bins",
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
    # the visibility from a point is kept if several pairs share the point
    shared = 2 * len(lights) <= count and len(lights) * n_triangles <= MOST_SIGHTS
    if not shared:
        lights, sight = lights[:1], np.zeros_like(sight)
    known = _sights(mesh, clear, lights, shared and not clear.all())
    step, limits = min(64 + count // 50, 1 << 16), (tol, MOST_PARTS, delta_t)
    for first in range(0, count, step):
        part = slice(first, min(first + step, count))
        blocks = np.unique(np.linspace(0, part.stop - first, 65).astype(np.int64))  # of threads
        pairs = (lasers[part], sensors[part], turned[part], sight[part], starts[part])
        kernels.three_bounces(
            mesh, clear, world, pairs, known, limits, blocks, out[part], report[part]
        )
        _check_done(report[part], lasers[part], sensors[part], tol)
        if progress is not None:
            progress(
                f"three bounces: {part.stop} of {counted(count, 'pair')} of points",
                part.stop / count,
            )
    return ThreeBounces(
        out[:, 1:-1],
        out[:, 0],
        out[:, -1],
        report[:, kernels.ERROR],
        report[:, kernels.LEAVES].astype(np.int64),
        bool(not clear.all()),
    )


def _shared(lasers: Array, sensors: Array) -> tuple[Array, Array, Array, Index, NDArray[np.bool_]]:
    """Order each pair so that the side with fewer different points comes first.

    G is symmetric, so laser and sensor points may be swapped.
    """
    # the point that more pairs share goes first, or that which sorts lower: swapping laser and
    # sensor then performs identical arithmetic, so reciprocity holds bit for bit
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
    """Compute which triangles each point of ``lights`` sees, and the visible polygons of each."""
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
        # partly visible without polygons means too many of them; the pairs report the error
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
            f"{where}: shadows cut one triangle into more than {PIECES} parts, the limit; split "
            "large triangles that lie behind many small ones"
        )
    raise SamplingError(
        f"{where}: three bounces need more than {MOST_PARTS} parts of the surface, the limit, for "
        f"tol = {tol:g}; give a larger tol or wider bins"
    )


def _check_apart(corners: Array, points: Array, reach: float) -> None:
    """Raise `SceneError` if a wall point lies on a triangle, where the intensity is unbounded."""
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
                f"the wall point ({x:g}, {y:g}) m lies on a hidden surface, where the intensity is "
                "unbounded; move the point or the surface"
            )
