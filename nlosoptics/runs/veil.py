"""Veil of a camera image: light of the hidden object that the wall scatters diffusely.

Its shape depends on the unknown object, though little. In bright images that little exceeds the
noise, and a fit with the shape of a white object fails. `fitted_veil` therefore alternates: it
reconstructs the object, and computes the veil of what it found.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..imaging import ForwardModel, Shadows, cast_shadows, diffuse_background
from ..imaging.geometry import picture_coordinates, picture_points
from ..imaging.images import mirror_image
from ..imaging.radiometry import has_highlight, laser_spot, spot_irradiance
from ..inverse.data.measurement import Measurement
from ..inverse.data.noisy_image import noisy_image
from ..inverse.known.total_variation import sharpest
from ..scene import PlanarObject, Scene

Array = NDArray[np.float64]

CELLS = 8  # cells of the object along each side, for its veil


def veil_shape(scene: Scene, shadows: Shadows | None = None) -> Array:
    """Return the wall's diffuse light in the image, (ny, nx), electrons, for a white object.

    It replaces that of the unknown picture, from which its shape hardly differs. ``shadows`` are
    those of the scene, if known already.
    """
    stand_in = None
    if isinstance(scene.hidden, PlanarObject):
        if scene.occluders:  # shadows need the whole plate
            stand_in = np.ones((7, 7))
        elif has_highlight(scene):
            stand_in = _points(scene, scene.hidden, np.ones((CELLS, CELLS)))
        else:  # four bright points, near those of Gauss's rule, represent a white object
            stand_in = np.zeros((7, 7))
            stand_in[1::4, 1::4] = 1.0
            stand_in = _points(scene, scene.hidden, stand_in)
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
    """Return the shape (ny, nx) of the wall's diffuse light, from the object that the image shows.

    The shape has mean 1; it is None if the wall has no diffuse lobe. ``noise_sigma`` is the rms
    noise of each pixel in the image's unit, infinite at masked pixels, or None; ``background`` is
    known, and ``shadows`` are those of `imaging.cast_shadows`, computed if omitted.

    The first reconstruction assumes the veil of a white object. As long as the shape of the veil is
    uncertain, its error is added to the noise; the next error is half of the last change. Parts of
    the object that the image does not show are given the mean reflectance of the others. The veil
    of a mesh is known, since all of it has one reflectance. The reconstructions are of the binned
    image, by the mean of the point spreads. Only the ratio of the veil to that of a white object
    changes; it is smooth, and computed in fewer pixels.
    """
    white = veil_shape(scene, shadows)
    if not white.any():
        return None
    shape: Array = white / white.mean()
    if noise_sigma is None or not isinstance(scene.hidden, PlanarObject):
        return shape
    valid = np.isfinite(noise_sigma)
    light = max(float((image - background)[valid].mean()), 0.0)
    assumed = 0.1  # error of the veil of a white object, relative to it; measured up to 0.17
    tolerated = 3.0  # standard errors of the noise of a shape
    if _standard_errors(assumed * light * shape, noise_sigma) < tolerated:
        return shape
    side = _binning(image.shape, 64)  # of the image in which the object is found
    binned = _Binned(valid, side)
    fewer = _binning(binned.shape, 32)  # of that in which its veil is computed
    cells = _Cells(_resized(scene, side), scene.hidden)
    coarse = _resized(scene, side * fewer)
    coarse_shadows = cast_shadows(coarse) if scene.occluders else None
    first = veil_shape(coarse, coarse_shadows)
    seen, noise, mine = binned.mean(image), binned.noise(noise_sigma), binned.mean(shape)
    blur = ForwardModel(_binned_kernel(model, side), shape=binned.shape)
    ratio, error = np.ones_like(seen), assumed * light * mine
    found = first
    for _ in range(6):
        if _standard_errors(error, noise) < tolerated:
            break
        given = Measurement(
            seen,
            noise_sigma=np.hypot(noise, error),
            background=background,
            background_shape=mine * ratio,
        )
        data = noisy_image(given, blur, measured_scale=False)
        object_, strength, _ = sharpest(data, blur, (100, 2e-3))  # coarse detail is enough
        picture = cells.picture(np.asarray(object_))
        if not picture.any():
            break
        picture = picture if scene.occluders else _points(scene, scene.hidden, picture)
        found = diffuse_background(coarse, picture, shadows=coarse_shadows)
        before, ratio = ratio, _ratio(found, first, fewer)
        ratio = ratio / (mine * ratio).mean()
        change = strength * mine * (ratio - before)
        error = np.full_like(mine, 0.5 * np.sqrt(np.mean(change**2)))
    shape = shape * _ratio(found, first, side * fewer)
    return np.asarray(shape / shape.mean())


def _points(scene: Scene, hidden: PlanarObject, picture: Array) -> Array:
    """Return a picture whose light comes from one part of each pixel, which is one patch.

    It is the middle one, or the one at the centre of the light if there is a highlight, and as
    bright as all together. The wall's light changes by the order of (side/distance)^2 of a pixel.
    """
    (rows, columns), finer = picture.shape, 9
    parts = np.ones((rows, finer, columns, finer))
    if has_highlight(scene):
        down, across = (
            (np.arange(n * finer) + 0.5) * (texels / (n * finer))
            for n, texels in zip(picture.shape, hidden.reflectance.shape, strict=True)
        )
        column, row = np.meshgrid(across, down)
        places = picture_points(hidden, column.ravel(), row.ravel())
        irradiance, _ = spot_irradiance(scene, laser_spot(scene), places, hidden.axes[2])
        parts = irradiance.reshape(parts.shape)
    light = np.maximum(parts.sum(axis=(1, 3)), 1e-300)
    step = np.arange(finer)
    y = np.rint(np.einsum("iyjx,y->ij", parts, step) / light).astype(np.intp)
    x = np.rint(np.einsum("iyjx,x->ij", parts, step) / light).astype(np.intp)
    i, j = np.indices(picture.shape)
    bright = picture * (light / finer**2) / np.maximum(parts[i, y, j, x], 1e-300)
    points = np.zeros((rows * finer, columns * finer))
    points[i * finer + y, j * finer + x] = bright / max(float(bright.max()), 1.0)
    return points


def _ratio(veil: Array, other: Array, side: int) -> Array:
    """Return the ratio of two veils in ``side`` times as many pixels; 1 where both are dark."""
    above, below = _enlarged(veil, side), _enlarged(other, side)
    return np.divide(above, below, out=np.ones_like(above), where=below > 0.0)


def _resized(scene: Scene, side: int) -> Scene:
    """Return the scene with pixels of side x side pixels."""
    return scene if side == 1 else scene.resized(scene.camera.shape[1] // side)


def _enlarged(picture: Array, side: int) -> Array:
    """Return a picture with ``side`` times as many pixels, interpolated linearly."""

    def weights(n: int) -> Array:
        at = np.clip((np.arange(n * side) + 0.5) / side - 0.5, 0.0, n - 1.0)
        return np.asarray(np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(n))))

    rows, columns = (weights(n) for n in picture.shape)
    return rows @ picture @ columns.T


def _standard_errors(error: Array, noise_sigma: Array) -> float:
    return float(np.sqrt(np.sum((error / noise_sigma) ** 2)))


def _binning(shape: tuple[int, ...], most: int) -> int:
    """Return the least number that divides both sides into at most ``most`` parts.

    It is 1 if there is none that leaves `CELLS` parts.
    """
    for side in range(1, min(shape) // CELLS + 1):
        if math.gcd(side, *shape) == side and max(shape) <= most * side:
            return side
    return 1


def _binned_kernel(model: ForwardModel, side: int) -> Array:
    """Return the mean point spread (ky, kx) between pixels of side x side pixels."""
    kernel = model.kernel
    if model.weights is not None:
        kernel = np.tensordot(model.weights.mean((-2, -1)), kernel, 1)

    def sums(length: int) -> Array:
        arm = -(-(length // 2) // side)
        parts = np.arange(-arm, arm + 1)[:, None]
        return np.maximum(0.0, 1.0 - np.abs((np.arange(length) - length // 2) / side - parts))

    rows, columns = (sums(length) for length in kernel.shape)
    return np.asarray(rows @ kernel @ columns.T)


class _Binned:
    """Means over squares of pixels, of those that are valid."""

    def __init__(self, valid: NDArray[np.bool_], side: int) -> None:
        self._valid, self._side = valid, side
        self._count = self._sums(valid)
        self.shape = self._count.shape

    def mean(self, values: Array) -> Array:
        """Return the means; 0 where no pixel is valid."""
        return self._sums(np.where(self._valid, values, 0.0)) / np.maximum(self._count, 1.0)

    def noise(self, sigma: Array) -> Array:
        """Return the noise of the means; infinite where no pixel is valid."""
        variance = self._sums(np.where(self._valid, sigma, 0.0) ** 2)
        return np.where(self._count > 0.0, np.sqrt(variance) / np.maximum(self._count, 1.0), np.inf)

    def _sums(self, values: NDArray[Any]) -> Array:
        side = self._side
        rows, columns = (length // side for length in values.shape)
        whole = values[: rows * side, : columns * side]
        return np.asarray(whole.reshape(rows, side, columns, side).sum(axis=(1, 3)), dtype=float)


class _Cells:
    """Cells of the object's plane, and the pixels that show them."""

    def __init__(self, scene: Scene, hidden: PlanarObject) -> None:
        white = replace(hidden, image=np.ones((CELLS, CELLS)))
        rays, light = mirror_image(replace(scene, hidden=white))
        column, row = picture_coordinates(white, rays)
        with np.errstate(invalid="ignore"):
            shown = (light > 0.0) & (np.minimum(column, row) >= 0.0)
            shown &= np.maximum(column, row) < CELLS
        self._shown = shown
        self._cell = row[shown].astype(np.intp) * CELLS + column[shown].astype(np.intp)
        self._white = self._sums(light)

    def picture(self, level: Array) -> Array:
        """Return the reflectance of each cell, at most 1, from an unblurred image (ny, nx)."""
        light, seen = self._sums(level), self._white > 0.0
        picture = np.full(CELLS**2, float(light.sum()) / max(float(self._white.sum()), 1e-300))
        picture[seen] = light[seen] / self._white[seen]
        return (picture / max(float(picture.max()), 1e-300)).reshape(CELLS, CELLS)

    def _sums(self, values: Array) -> Array:
        return np.asarray(np.bincount(self._cell, values[self._shown], CELLS**2), dtype=np.float64)
