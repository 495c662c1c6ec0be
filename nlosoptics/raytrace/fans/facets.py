"""Random tilts of the wall's facets, one for each cell of a lattice that lies on the wall."""

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

FACETS: Final = 401  # stream of the random generator
MARGIN: Final = 0.25  # of the seen patch's width, beyond each of its sides


def facet_angles(
    scene: Scene, *, cell: float, slope_rms: float | None = None, seed: int = 0
) -> tuple[Array, Array]:
    """Draw the tilt and azimuth of a facet for every wall cell that the lens sees the object by.

    Parameters
    ----------
    scene : Scene
    cell : float
        Side of a square cell in x and y, m. Cells have their corners at multiples of it.
    slope_rms : float, optional
        Per axis, rad, up to 1; by default that of the wall material's strongest lobe that has one.
    seed : int
        A cell has the same facet for one seed, whatever else is drawn.

    Returns
    -------
    slopes : ndarray, (ny, nx, 2)
        Tangents of the tilt against the mean wall, s1 and s2: the facet's normal is along
        ``n - s1 t1 - s2 t2`` with n the mean wall's normal, t1 its tangent along x and
        t2 = n x t1. For a flat wall it is the gradient of the facet's height.
    positions : ndarray, (ny, nx, 3)
        Centres of the cells on the mean wall, world, m, rows along y. They cover the light from
        the object's reference point to the lens, and a quarter of its width more on every side.

    Raises
    ------
    SceneError
        If no slope is given and the wall material has none.
    SamplingError
        If the lattice has more than 2^31 cells from the origin to the patch.

    Notes
    -----
    V-grooves as of Oren and Nayar: normals have the density ``exp(-t^2/2 slope_rms^2)`` per solid
    angle and mean-plane area at tilts t below pi/2, with any azimuth. A Rayleigh draw is accepted
    with the probability sin(t)/t. For small slopes s1 and s2 are Gaussian of that rms; the facets
    are independent, and no height has them as its gradient.
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
            f"cell = {cell:g} m puts the patch more than 2^31 cells from the origin; enlarge it"
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
            "the wall has no height in a part of the patch about the light, as beyond the rim of a "
            "sphere; use a larger radius or a smaller stop"
        )
    return slopes, np.stack([x, y, height], axis=-1)


def material_slope(scene: Scene) -> float:
    """Slope rms per axis, rad, of the wall material's strongest lobe that has one."""
    lobes = scene.wall_material.lobe_table()
    rough = lobes[(lobes[:, 0] != LAMBERT) & (lobes[:, 2] > 0)]
    if not len(rough):
        raise SceneError(
            "scene.wall_material has no lobe with a slope; give slope_rms, or a material such as "
            "Ward, OrenNayar or SpecularMicrofacet with slope_rms above 0"
        )
    kind, _, width, _ = rough[np.argmax(rough[:, 1])]
    # Ward's alpha is Beckmann's
    alpha = kind in (WARD_1992, WARD_DUER, WARD_BOUNDED)
    return float(width / math.sqrt(2.0) if alpha else width)


def _draw(
    columns: NDArray[np.int64], rows: NDArray[np.int64], slope_rms: float, seed: int
) -> Array:
    """Slopes (ny, nx, 2) of the lattice's cells by their indices."""
    j, i = (a.ravel() for a in np.meshgrid(columns, rows))
    slopes = np.empty((len(i), 2))
    waiting, attempt = np.arange(len(i)), 0
    while len(waiting):
        address = np.empty((len(waiting), 4), dtype=np.uint32)
        # two's complement keeps the cells on either side of the origin apart
        address[:, 0] = j[waiting] & 0xFFFFFFFF
        address[:, 1] = i[waiting] & 0xFFFFFFFF
        address[:, 2], address[:, 3] = attempt, FACETS
        words = philox(address, seed).astype(np.float64)
        # 53 bits, and never 0
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
