"""Random facet tilts of a rough wall, one facet per cell of a square lattice on the wall."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..._checks import fits_memory, in_range, positive
from ..._random import checked_seed, philox
from ...errors import SamplingError, SceneError
from ...kernels.codes import LAMBERT, WARD_1992, WARD_BOUNDED, WARD_DUER
from ...scene import Scene
from .footprints import lens_footprint, surfaces

Array = NDArray[np.float64]

FACETS: Final = 401  # stream number of the random generator
MARGIN: Final = 0.25  # added on each side of the visible patch, relative to its width


def facet_angles(
    scene: Scene, *, cell: float, slope_rms: float | None = None, seed: int = 0
) -> tuple[Array, Array]:
    """Draw random facet slopes for the part of the wall in which the lens sees the hidden object.

    Parameters
    ----------
    scene : Scene
        Its wall gives the mean surface, its hidden object and camera the visible part.
    cell : float
        Side of a square cell in x and y, m. The cell corners are at integer multiples of it.
    slope_rms : float, optional
        Slope rms per axis, rad, at most 1. The default is that of the strongest lobe of the wall
        material that has a slope.
    seed : int
        Seed of the random generator, 0 to 2^64 - 1. The draw for a cell depends only on the seed
        and the indices of the cell.

    Returns
    -------
    slopes : ndarray, (ny, nx, 2)
        Slopes s1 and s2 of each facet relative to the mean wall. The facet's normal is along
        ``n - s1 t1 - s2 t2``, with n the normal of the mean wall, t1 its tangent along x and
        t2 = n x t1. For a flat wall they are the gradient of the facet's height.
    positions : ndarray, (ny, nx, 3)
        Centres of the cells on the mean wall, world, m, rows along y. They cover the light path
        from the object's reference point to the lens, plus a quarter of its width on each side.

    Raises
    ------
    SceneError
        If no slope is given and the wall material has none, or no light from the object's
        reference point is reflected into the lens.
    SamplingError
        If a cell of the patch is more than 2^31 cells from the origin.
    MemoryLimitError
        If the facets would not fit in memory.

    See Also
    --------
    nlosoptics.psf.pupil_slopes : Wave slopes caused by facet tilts.
    nlosoptics.psf.facet_wavefront : Wave of a wall of tilted facets.

    Notes
    -----
    The facets follow the V-groove statistics of Oren and Nayar: at tilts t below pi/2, normals have
    the density ``exp(-t^2/(2 slope_rms^2))`` per solid angle and mean-plane area, with uniform
    azimuth. A Rayleigh-distributed tilt is accepted with probability sin(t)/t. For a small slope
    rms, s1 and s2 are Gaussian with that rms. The facets are independent, so that in general no
    continuous surface has these slopes.

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> slopes, positions = raytrace.facet_angles(scene, cell=1e-4, slope_rms=0.05, seed=0)
    >>> slopes.shape, round(float(slopes.std()), 3)
    ((222, 253, 2), 0.05)
    """
    cell = positive("cell", cell, unit="m")
    checked_seed(seed)
    if slope_rms is None:
        slope_rms = material_slope(scene)
    slope_rms = in_range("slope_rms", slope_rms, 0.0, 1.0, open_low=True, unit="rad")
    seen = lens_footprint(scene.wall, scene.object_point, scene.camera)
    room = MARGIN * (seen.high - seen.low)
    first, last = np.floor((seen.low - room) / cell), np.floor((seen.high + room) / cell)
    if max(-first.min(), last.max()) >= 2**31:
        raise SamplingError(
            f"cell = {cell:g} m puts the patch more than 2^31 cells from the origin; use a larger "
            "cell"
        )
    counts = last - first + 1
    fits_memory(
        f"{counts[0]:.0f} x {counts[1]:.0f} facets", 300 * counts[0] * counts[1], "enlarge cell"
    )
    columns, rows = (np.arange(a, b + 1) for a, b in zip(first, last, strict=True))
    slopes = _draw(columns.astype(np.int64), rows.astype(np.int64), slope_rms, seed)
    x, y = np.meshgrid((columns + 0.5) * cell, (rows + 0.5) * cell)
    height = surfaces(scene.wall, x, y)[..., 0]
    if np.isnan(height).any():
        raise SceneError(
            "the wall has no height in a part of the patch around the light path, for example "
            "beyond the rim of a sphere; use a larger radius or a smaller stop"
        )
    return slopes, np.stack([x, y, height], axis=-1)


def material_slope(scene: Scene) -> float:
    """Return the slope rms per axis, rad, of the wall's strongest lobe that has a slope.

    Raises
    ------
    SceneError
        If no lobe has a slope.
    """
    lobes = scene.wall_material.lobe_table()
    rough = lobes[(lobes[:, 0] != LAMBERT) & (lobes[:, 2] > 0)]
    if not len(rough):
        raise SceneError(
            "scene.wall_material has no lobe with a slope; give slope_rms, or use a material such "
            "as Ward, OrenNayar or SpecularMicrofacet with slope_rms above 0"
        )
    kind, _, width, _ = rough[np.argmax(rough[:, 1])]
    # a Ward lobe stores alpha = sqrt(2) slope_rms
    alpha = kind in (WARD_1992, WARD_DUER, WARD_BOUNDED)
    return float(width / math.sqrt(2.0) if alpha else width)


def _draw(
    columns: NDArray[np.int64], rows: NDArray[np.int64], slope_rms: float, seed: int
) -> Array:
    """Return random facet slopes (ny, nx, 2), without unit, of the wall's lattice cells.

    ``columns`` (nx,) and ``rows`` (ny,) are the integer indices of the cells. A facet depends only
    on the seed and its own indices, so that overlapping patches of wall agree.
    """
    j, i = (a.ravel() for a in np.meshgrid(columns, rows))
    slopes = np.empty((len(i), 2))
    waiting, attempt = np.arange(len(i)), 0
    while len(waiting):
        address = np.empty((len(waiting), 4), dtype=np.uint32)
        # two's complement maps negative indices to distinct addresses
        address[:, 0] = j[waiting] & 0xFFFFFFFF
        address[:, 1] = i[waiting] & 0xFFFFFFFF
        address[:, 2], address[:, 3] = attempt, FACETS
        words = philox(address, seed).astype(np.float64)
        # 53 random bits; never 0, whose logarithm is infinite
        uniform = (
            np.floor(words[:, 0] / 32) * 2.0**26 + np.floor(words[:, 1] / 64) + 0.5
        ) / 2.0**53
        tilt = slope_rms * np.sqrt(-2 * np.log(uniform))
        accepted = (tilt < math.pi / 2) & (words[:, 2] / 2.0**32 < np.sinc(tilt / math.pi))
        turn = 2 * math.pi * words[:, 3] / 2.0**32
        steep = np.tan(np.where(accepted, tilt, 0.0))
        found = np.stack([steep * np.cos(turn), steep * np.sin(turn)], axis=1)
        slopes[waiting[accepted]] = found[accepted]
        waiting, attempt = waiting[~accepted], attempt + 1
    return slopes.reshape(len(rows), len(columns), 2)
