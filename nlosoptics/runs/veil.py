"""Veil of a camera image: light of the hidden object that the wall scatters diffusely.

Its shape depends on the unknown object, though little. In bright images that little exceeds the
noise, and a fit with the shape of a white object fails. `fitted_veil` therefore alternates: it
reconstructs the object, and computes the veil of what it found.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..imaging import ForwardModel, Shadows, cast_shadows, diffuse_background
from ..imaging.geometry import picture_coordinates
from ..imaging.images import light_levels
from ..scene import PlanarObject, Scene

Array = NDArray[np.float64]

CELLS = 16  # cells of the object along each side, for its veil
#: Assumed error of the veil of a white object, relative to the veil; measured up to 0.17.
ERROR = 0.1
#: Veil errors, in standard errors of the noise of a shape, that a fit tolerates.
TOLERATED = 3.0
ROUNDS = 6  # largest number of reconstructions
ITERATIONS, TOLERANCE = 100, 2e-3  # of each: the veil needs only coarse detail


def veil_shape(scene: Scene, shadows: Shadows | None = None) -> Array:
    """Return the wall's diffuse light in the image, (ny, nx), electrons, for a white object.

    It replaces that of the unknown picture, from which its shape hardly differs. ``shadows`` are
    those of the scene, if known already.
    """
    stand_in = None
    if isinstance(scene.hidden, PlanarObject):
        # four bright pixels, near Gauss points, represent a white object
        stand_in = np.zeros((7, 7))
        stand_in[1::4, 1::4] = 1.0
        if scene.occluders:  # shadows need the whole plate
            stand_in = np.ones((7, 7))
    return diffuse_background(scene, stand_in, shadows=shadows)


def fitted_veil(
    scene: Scene,
    image: Array,
    model: ForwardModel,
    *,
    noise_sigma: Array | None,
    background: float = 0.0,
    shadows: Shadows | None = None,
) -> Array | None:
    """Return the shape of the wall's diffuse light, from the object that the image shows.

    Parameters
    ----------
    scene : Scene
        Scene in which the image was taken.
    image : ndarray, (ny, nx)
        Camera image, in any unit.
    model : ForwardModel
        Image model of the scene.
    noise_sigma : ndarray, (ny, nx), or None
        Rms noise of each pixel, in the image's unit, infinite at masked pixels. None: no noise.
    background : float
        Known background, in the image's unit.
    shadows : Shadows, optional
        Result of `imaging.cast_shadows` for this scene. None: computed if there are occluders.

    Returns
    -------
    ndarray, (ny, nx), or None
        Shape with mean 1; None if the wall has no diffuse lobe.

    Notes
    -----
    The first reconstruction assumes the veil of a white object. As long as the shape of the veil is
    uncertain, its error is added to the noise; the next error is half of the last change. Parts of
    the object that the image does not show are given the mean reflectance of the others. The veil
    of a mesh is known, since all of it has one reflectance.
    """
    from ..inverse import tv_deconvolve

    if shadows is None and scene.occluders:
        shadows = cast_shadows(scene)
    veil = veil_shape(scene, shadows)
    if not veil.any():
        return None
    shape: Array = veil / veil.mean()
    if noise_sigma is None or not isinstance(scene.hidden, PlanarObject):
        return shape
    light = (image - background)[np.isfinite(noise_sigma)]
    error = ERROR * max(float(light.mean()), 0.0) * shape
    cells = None
    for _ in range(ROUNDS):
        if np.sqrt(np.sum((error / noise_sigma) ** 2)) < TOLERATED:
            break
        found = tv_deconvolve(
            image,
            model,
            noise_sigma=np.hypot(noise_sigma, error),
            background=background,
            background_shape=shape,
            max_iterations=ITERATIONS,
            tolerance=TOLERANCE,
        )
        cells = cells or _Cells(scene, scene.hidden, shadows)
        picture = cells.picture(found.object)
        if not picture.any():
            break
        veil = diffuse_background(scene, picture, shadows=shadows)
        change = found.physical_parameters["background"] * (veil / veil.mean() - shape)
        shape, error = veil / veil.mean(), np.full_like(shape, 0.5 * np.sqrt(np.mean(change**2)))
    return shape


class _Cells:
    """Cells of the object's plane, and the pixels that show them."""

    def __init__(self, scene: Scene, hidden: PlanarObject, shadows: Shadows | None) -> None:
        white = replace(hidden, image=np.ones((CELLS, CELLS)))
        levels = light_levels(replace(scene, hidden=white), shadows=shadows)
        column, row = picture_coordinates(white, levels.rays)
        with np.errstate(invalid="ignore"):
            shown = (levels.ideal > 0.0) & (np.minimum(column, row) >= 0.0)
            shown &= np.maximum(column, row) < CELLS
        self._shown = shown
        self._cell = row[shown].astype(np.intp) * CELLS + column[shown].astype(np.intp)
        self._white = self._sums(levels.ideal)

    def picture(self, level: Array) -> Array:
        """Return the reflectance of each cell, at most 1, from an unblurred image (ny, nx)."""
        light, seen = self._sums(level), self._white > 0.0
        picture = np.full(CELLS**2, float(light.sum()) / max(float(self._white.sum()), 1e-300))
        picture[seen] = light[seen] / self._white[seen]
        return (picture / max(float(picture.max()), 1e-300)).reshape(CELLS, CELLS)

    def _sums(self, values: Array) -> Array:
        return np.asarray(np.bincount(self._cell, values[self._shown], CELLS**2), dtype=np.float64)
