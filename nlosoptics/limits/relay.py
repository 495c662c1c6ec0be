"""Limits of a relay wall for any solver: transfer of its lobes and modes above the noise."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy  # loads scipy.special and scipy.optimize on first use
from numpy.typing import ArrayLike, NDArray

from .._checks import in_range, positive, whole
from .._random import generator
from ..errors import SceneError
from ..imaging.detector import noise_variance
from ..imaging.images import LightLevels
from ..imaging.lit_walls import lit_transports
from ..imaging.objects import plate
from ..inverse.shadows.shadow_fit import shadow_fit
from ..scene import Material, PlanarObject, Scene, SumMaterial

Array = NDArray[np.float64]

CELLS = 24  # cells of the object along its longer side
DRAWS = 3  # images with noise of which a forecast takes the mean
LEAST_BINS = 64  # that a fit needs
MOST_BINS = 64  # along the longer side
CONTRAST = 0.3  # assumed rms variation of a cell's reflectance about the mean


def lambert_relay_transfer(frequency: ArrayLike, distance: float) -> Array:
    """Return the modulation transfer function (MTF) from an object to a diffuse wall.

    It is the contrast of the wall's irradiance for a sinusoidal pattern on a plane that is parallel
    to the wall, relative to the contrast of the pattern.

    Parameters
    ----------
    frequency : array_like
        Spatial frequencies on the object, any shape, cycles/m, at least 0.
    distance : float
        Distance between wall and object plane, m.

    Returns
    -------
    ndarray
        MTF, 0 to 1, of the shape of ``frequency``.

    Raises
    ------
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    lambert_relay_limit : Highest frequency above the photon noise.
    lobe_relay_transfer : Transfer function of a glossy wall.

    Notes
    -----
    The MTF at the spatial frequency f is ``q z K1(q z)``, with q = 2 pi f, the distance z and the
    modified Bessel function K1. It is the Fourier transform of the irradiance ``z^2/(r^2 + z^2)^2``
    that a Lambertian object point causes on the wall, normalised to 1 at zero frequency. Here r is
    the distance on the wall from the point nearest to the object point.

    Examples
    --------
    >>> from nlosoptics.limits import lambert_relay_transfer
    >>> [f"{passed:.2g}" for passed in lambert_relay_transfer([0.0, 1.0, 5.0], distance=1.0)]
    ['1', '0.0062', '1.6e-13']
    """
    scale = 2 * math.pi * positive("distance", distance)
    # K1 underflows to 0 in double precision beyond 750
    x = np.minimum(_frequencies(frequency), 1e3 / scale) * scale
    return np.asarray(np.where(x > 0.0, x * scipy.special.k1(np.maximum(x, 1e-300)), 1.0))


def lobe_relay_transfer(frequency: ArrayLike, distance: float, slope_rms: float) -> Array:
    """Return the modulation transfer function (MTF) of a glossy wall for an object parallel to it.

    The wall consists of small facets with random slopes, which mirror the object. Their slopes blur
    its image.

    Parameters
    ----------
    frequency : array_like
        Spatial frequencies on the object, any shape, cycles/m, at least 0.
    distance : float
        Distance between wall and object plane, m.
    slope_rms : float
        Rms slope of the wall's facets along each axis, rad.

    Returns
    -------
    ndarray
        MTF, 0 to 1, of the shape of ``frequency``.

    Raises
    ------
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    lambert_relay_transfer : Transfer function of a diffuse wall.
    feasibility : Predict what an image can show.

    Notes
    -----
    The MTF at the spatial frequency f is ``exp(-8 pi^2 slope_rms^2 distance^2 f^2)``, for Gaussian
    slopes and light near normal incidence. A facet tilted by the angle t mirrors a point of the
    object that is shifted by ``2 t distance``.

    Examples
    --------
    >>> from nlosoptics.limits import lobe_relay_transfer
    >>> passed = lobe_relay_transfer([0.0, 5.0], distance=1.0, slope_rms=0.02)
    >>> [round(float(p), 3) for p in passed]
    [1.0, 0.454]
    """
    blur = 2.0 * in_range("slope_rms", slope_rms, 0.0) * positive("distance", distance)
    # exp(-x) underflows to 0 in double precision beyond x = 750
    turns = np.minimum(_frequencies(frequency), 1e3 / max(blur, 1e-300)) * blur
    return np.exp(-2.0 * (math.pi * turns) ** 2)


def lambert_relay_limit(electrons: float, distance: float) -> float:
    """Compute the spatial frequency up to which a diffuse wall transmits detail above photon noise.

    Parameters
    ----------
    electrons : float
        Number of photoelectrons in the whole image, above 2.
    distance : float
        Distance between wall and object plane, m.

    Returns
    -------
    float
        Frequency f, cycles/m, at which a sinusoidal pattern of full contrast on the object has a
        signal-to-noise ratio of 1: ``lambert_relay_transfer(f, distance) * sqrt(electrons/2) = 1``.
        Photon noise is the only noise considered.

    Raises
    ------
    SceneError
        If a value is out of range.

    See Also
    --------
    lambert_relay_transfer : Transfer function of a diffuse wall.
    feasibility : Predict what an image can show.

    Examples
    --------
    >>> from nlosoptics.limits import lambert_relay_limit
    >>> round(lambert_relay_limit(electrons=1e8, distance=1.0), 2)
    1.64
    """
    distance = positive("distance", distance, unit="m")
    in_range("electrons", electrons, 2.0, open_low=True)
    target = -0.5 * math.log(electrons / 2.0)

    def excess(x: float) -> float:
        return math.log(x) + math.log(scipy.special.k1e(x)) - x - target

    return float(scipy.optimize.brentq(excess, 1e-9, 700.0, xtol=1e-14)) / (2 * math.pi * distance)


class RelayLight(NamedTuple):
    """Light of the wall's wide lobes in bins of pixels, from each cell of the object.

    ``response`` (rows, columns, n_cells) are the electrons due to a white cell, and ``noise``
    (rows, columns) is the rms noise.
    """

    response: Array
    noise: Array

    @property
    def signal(self) -> Array:
        """Signal-to-noise ratio A (n_bins, n_cells) of cells of the contrast `CONTRAST`.

        The Fisher information on the cells' reflectances is ``A^T A/CONTRAST^2``. The singular
        values are the signal-to-noise ratios of independent patterns of this contrast.
        """
        signal = CONTRAST * self.response / self.noise[..., None]
        return np.asarray(signal.reshape(self.noise.size, -1))


def relay_light(
    scene: Scene,
    *,
    exposure: float | None = None,
    light: Array | None = None,
    freedom: float | None = None,
    ambient: Array | None = None,
    cells: int = CELLS,
    bins: int | None = None,
) -> RelayLight | None:
    """Return the light of the wall's wide lobes from every object cell; None without a wide lobe.

    ``light`` (ny, nx) are the expected electrons of all light in each pixel, by default of an
    object of reflectance 0.35; ``freedom`` the degrees of freedom of a pixel's speckle, which the
    part ``ambient`` (ny, nx) of the light has not. Shadows are seen by 64 bins along the longer
    side, by default. Without them, this number is doubled until the degrees of freedom change by
    less than 3 %.

    Wide lobes are the diffuse ones, and mirror-like ones that blur over two cells or more. Narrower
    lobes form an image; `picture_modes` counts its modes.
    """
    material = wide_lobes(scene, cells=cells)
    if material is None:
        return None
    counts = _cell_counts(plate(scene)[2], whole("cells", cells, 2, 64))
    camera = scene.camera
    exposure = positive("exposure", camera.exposure if exposure is None else exposure)
    freedom = None if freedom is None else positive("freedom", freedom)
    dark = camera.dark_current * exposure * camera.binning**2

    def binned(count: int) -> RelayLight:
        bins = _bin_counts(camera.shape, count)
        pixels = math.prod(camera.shape) / math.prod(bins)
        options = {"pixels": bins, "exposure": exposure, "material": material}
        response = np.zeros((math.prod(bins), math.prod(counts)))
        for one, brightness in lit_transports(scene, cells=counts, **options):
            response += brightness * one.matrix
        # without ``light``, that of an object of this mean reflectance
        arriving = 0.35 * response.sum(axis=1) if light is None else _binned(light, bins).ravel()
        room = 0.0 if ambient is None else _binned(ambient, bins).ravel() / pixels
        variance = pixels * noise_variance(camera, arriving / pixels - room, dark + room, freedom)
        return RelayLight(response.reshape(*bins, -1), np.sqrt(variance).reshape(bins))

    if bins is not None or scene.occluders:
        return binned(whole("bins", bins or MOST_BINS, 2, 128))
    count, result = 6, binned(6)
    freedoms = _freedom_of(result.signal)
    while count < min(max(camera.shape), MOST_BINS):
        before, count = freedoms, 2 * count
        result = binned(count)
        freedoms = _freedom_of(result.signal)
        if abs(freedoms - before) <= 0.03 * before:
            break
    return result


def relay_score(scene: Scene, relay: RelayLight | None, levels: LightLevels) -> float:
    """Return the expected correlation of `inverse.shadow_fit` with the object, over its cells.

    Returns a correlation, 0 to 1; 0 without light or for a uniform object. ``levels`` are those of
    the scene.

    No closed form describes this fit: that nothing is darker than black tells more about most
    objects than the modes. So it is applied to the expected image with noise, `DRAWS` times, and
    the mean correlation is returned. A mesh has no picture; its cells are taken as independent, of
    contrast `CONTRAST`, and the fit as linear.
    """
    if relay is None or not relay.response.any():
        return 0.0
    picture, bins = _cell_picture(scene), relay.noise.shape
    whole_bins = _binned(levels.visible, bins) * relay.noise.size > 0.999 * levels.visible.size
    if picture is None or whole_bins.sum() < LEAST_BINS:
        return math.sqrt(_freedom_of(relay.signal) / relay.response.shape[-1])
    if np.ptp(picture) == 0.0:
        return 0.0
    image = _binned(levels.diffuse + levels.ambient, bins)
    image[~whole_bins] = np.nan
    operator, draw = relay.response.reshape(-1, picture.size), generator(0, 1707)
    total = 0.0
    for _ in range(DRAWS):
        fit = shadow_fit(
            image + relay.noise * draw.standard_normal(bins),
            operator,
            cells=picture.shape,
            noise=relay.noise,
            ambient=None if scene.ambient_irradiance > 0.0 else -1,
        )
        if np.ptp(fit.object) > 0.0:
            total += float(np.corrcoef(fit.object.ravel(), picture.ravel())[0, 1])
    return max(total / DRAWS, 0.0)


def _frequencies(values: ArrayLike) -> Array:
    """Return frequencies as an array, checked to be finite and at least 0."""
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError("frequency is not an array of numbers; give cycles/m") from None
    wrong = ~(np.isfinite(found) & (found >= 0.0))
    if wrong.any():
        in_range("frequency", float(found[wrong][0]), 0.0, unit="cycles/m")
    return found


def count_modes(signal: Array) -> int:
    """Count the singular values above 1 of a matrix (n_bins, n_cells), see `RelayLight`."""
    return int(np.count_nonzero(_squares(signal) > 1.0))


def _freedom_of(signal: Array) -> float:
    """Return the degrees of freedom, the sum of v^2/(1 + v^2) over the singular values v."""
    squares = np.maximum(_squares(signal), 0.0)
    return float((squares / (1.0 + squares)).sum())


def _squares(signal: Array) -> Array:
    """Return the squared singular values of a matrix, accurate to 1e-16 of the largest."""
    small = signal if len(signal) <= signal.shape[1] else signal.T
    return np.asarray(np.linalg.eigvalsh(small @ small.T))


def wide_lobes(scene: Scene, *, cells: int = CELLS) -> Material | None:
    """Diffuse lobes of the wall and mirror-like lobes that blur over two object cells or more."""
    size = plate(scene)[2]
    distance = float(scene.object_point[2])
    wide: list[Material] = [
        lobe
        for lobe in scene.mirror_lobes
        if 2.0 * lobe.slope_rms * distance >= 2.0 * max(size) / cells
    ]
    diffuse = scene.wall_material.diffuse
    parts = ([] if diffuse is None else [diffuse]) + wide
    return SumMaterial(*parts) if len(parts) > 1 else (parts[0] if parts else None)


def _cell_counts(size: tuple[float, float], cells: int) -> tuple[int, int]:
    """Return rows and columns of nearly square cells on a plate of a given width and height, m."""
    columns, rows = (max(1, round(cells * side / max(size))) for side in size)
    return rows, columns


def _cell_picture(scene: Scene) -> Array | None:
    """Return the mean reflectance of each cell, (rows, columns); None for a mesh."""
    hidden = scene.hidden
    if not isinstance(hidden, PlanarObject):
        return None
    counts = _cell_counts(hidden.size, CELLS)
    sums = _binned(hidden.reflectance, counts)
    return np.asarray(sums * (math.prod(counts) / hidden.reflectance.size))


def _bin_counts(shape: tuple[int, int], bins: int) -> tuple[int, int]:
    """Return the numbers of square bins along y and x; no bin is smaller than a pixel."""
    longer = max(shape)
    n_y, n_x = (max(1, round(min(bins, longer) * n / longer)) for n in shape)
    return n_y, n_x


def _binned(picture: Array, counts: tuple[int, int]) -> Array:
    """Sum a picture over bins; a pixel on a bin edge is split between the bins by area."""
    for axis, count in enumerate(counts):
        n = picture.shape[axis]
        edges = np.linspace(0.0, n, count + 1)
        lines = np.moveaxis(picture, axis, 0)
        summed = np.concatenate([np.zeros((1, *lines.shape[1:])), np.cumsum(lines, axis=0)])
        low = np.minimum(edges.astype(np.intp), n - 1)
        shape = (-1,) + (1,) * (summed.ndim - 1)
        at = summed[low] + (edges - low).reshape(shape) * (summed[low + 1] - summed[low])
        picture = np.moveaxis(np.diff(at, axis=0), 0, axis)
    return picture
