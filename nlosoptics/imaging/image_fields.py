"""Choice of the coarsest field of point spreads that is accurate enough for an image.

The field is compared with point spreads computed directly at points between its nodes. How much the
differences change the image depends on the picture: errors that cancel over a pixel or two matter
only at its edges.
"""

from __future__ import annotations

import math
import time

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from .._checks import in_range, seconds_limit, whole
from .._progress import Progress
from .._random import generator
from ..errors import SamplingError, SceneError
from ..psf import PointSpreadField, SceneOptics
from ..psf.pupil.paraxial import wave_bends
from ..psf.pupil.scene_optics import optics_of
from ..psf.walls.field import (
    Place,
    SampledSpreads,
    chebyshev_weights,
    picture_nodes,
    picture_point,
)
from ..psf.window.error_bounds import rounded_up
from ..scene import PlanarObject, Scene

Array = NDArray[np.float64]

#: Nodes along each side of the picture, tried in order.
COUNTS = (1, 3, 5, 8, 12, 18, 27)
#: Points along each side of the picture at which a field is compared with exact point spreads.
CHECKED = 4
#: Factor for what lies between these points: over 40 draws of them, five walls and nine grids, the
#: largest difference that they found was 0.55 to 3 times the rms error of the image.
SAFETY = 1.5


def image_field(
    scene: Scene | SceneOptics,
    *,
    tol: float = 1e-3,
    most_nodes: int = COUNTS[-1],
    planned_nodes: int | None = None,
    anywhere: bool = False,
    progress: Progress | None = None,
) -> tuple[PointSpreadField, float]:
    """Compute PSFs at as many points of the hidden object as an accurate camera image needs.

    The point spread functions (PSFs) are computed on a grid of points, the nodes, over the planar
    object, and interpolated between them. The grid is refined, from 1 to 27 nodes along each side,
    until the interpolated PSFs are accurate enough at random points of the object.

    Parameters
    ----------
    scene : Scene or SceneOptics
        Scene whose hidden object is a `nlosoptics.scene.PlanarObject`. A
        `nlosoptics.psf.SceneOptics` keeps its pupil and waves for further calls.
    tol : float
        Tolerance of the result, 1e-9 to 0.1. It limits two errors: that of the object's image, rms
        error over rms image, and that of each PSF, max |dI| / max I with its intensity I.
    most_nodes : int
        Largest number of nodes along each side of the object.
    planned_nodes : int, optional
        Number of nodes along each side that a plan expects to suffice. Beyond it the grid is
        refined only while each step halves the error, and the best field is returned even if its
        error is above ``tol``. By default such an error is raised.
    anywhere : bool, default False
        Whether the PSFs are checked all over the object, as for photographs of an unknown object
        in the place of the scene's. By default they are checked where the picture is bright.
    progress : callable(str, float), optional
        Called with "field" and the completed fraction of the nodes that may be needed.

    Returns
    -------
    field : PointSpreadField
        PSFs on the coarsest grid of nodes that suffices. Its ``error_estimate`` includes the
        differences from exact PSFs at the random points.
    error : float
        Estimated error of the object's image, rms error over rms image; at most ``tol`` unless
        ``planned_nodes`` are given.

    Raises
    ------
    SceneError
        If an option is out of range, or the object is a mesh.
    SamplingError
        If ``most_nodes`` are too few. Within `nlosoptics.simulate` with
        ``max_seconds``, also if the next grid would take longer than this limit.
    NlosError
        If a PSF cannot be computed; see `nlosoptics.psf.point_spread_field`.

    See Also
    --------
    nlosoptics.psf.point_spread_field : PSFs over the hidden object.
    form_image : Image in electrons, with noise.
    """
    in_range("tol", tol, 1e-9, 0.1)
    optics = optics_of(scene)
    picture = picture_frame(optics.scene)
    most_nodes = whole("most_nodes", most_nodes)
    planned = most_nodes if planned_nodes is None else whole("planned_nodes", planned_nodes, 0)
    counts = [n for n in COUNTS if n <= most_nodes]
    start, limit = time.perf_counter(), seconds_limit(math.inf)
    spreads = SampledSpreads(optics, optics.scene.camera.image_pitch, tol / 2)
    places = checked_places(np.ones_like(picture) if anywhere else picture)
    exact = np.array([one.intensity for one in spreads.at(places)])
    echo = autocorrelation(picture, spreads.side)
    bright = blurred_power(exact, echo)
    computed = len(places)
    best: tuple[float, PointSpreadField | None] = (math.inf, None)
    before = error = math.inf
    for step, count in enumerate(counts):
        if count > planned and error > before / 2:
            break  # the nodes do not resolve the wall's shape, and a few more would not
        begun = time.perf_counter()
        expected = (begun - start) * (1.0 + count**2 / computed)
        if expected > limit:
            raise SamplingError(
                f"{count} x {count} point spreads over the object would take about {expected:.3g} "
                f"s, limit max_seconds = {limit:g}; use a larger tol, or max_seconds = "
                f"{rounded_up(expected)}"
            )

        def told(name: str, done: float, step: int = step) -> None:
            if progress is not None:
                progress(name, (step + done) / len(counts))

        field = spreads.field((count, count), places, told)
        computed += count**2
        off = np.tensordot(field.at(*np.transpose(places)), field.modes, (0, 0)) - exact
        before = error
        error = SAFETY * math.sqrt(float((blurred_power(off, echo) / bright).max()))
        best = min(best, (error, field), key=lambda pair: pair[0])
        if error <= tol:
            return field, error
    if planned_nodes is not None and best[1] is not None:
        return best[1], best[0]
    raise SamplingError(
        f"the picture's image still has an error of about {error:.2g} of its rms with {count} x "
        f"{count} point spreads, limit tol = {tol:g}; use tol = {1.1 * error:.2g}"
    )


def checked_places(picture: Array) -> list[Place]:
    """Return random points, one in each of `CHECKED` x `CHECKED` equal parts of a picture's light.

    ``picture`` is the result of `picture_frame`. The parts are those of the rectangle that holds
    all its bright pixels.
    """
    draws = generator(0, 501).uniform(size=(2, CHECKED, CHECKED))
    shares = (np.indices((CHECKED, CHECKED)) + draws) / CHECKED
    up, across = np.empty((2, CHECKED, CHECKED))
    for axis, at in enumerate((up, across)):
        lit = np.flatnonzero(picture.any(axis=1 - axis))
        low, high = lit[0], lit[-1] + 1
        at[...] = 2.0 * (low + shares[axis] * (high - low)) / picture.shape[axis] - 1.0
    return list(zip(across.ravel().tolist(), up.ravel().tolist(), strict=True))


def autocorrelation(picture: Array, side: int) -> Array:
    """Return a picture's sums of products with itself, displaced by less than ``side`` pixels.

    Negative displacements are at the end of each axis, as in a discrete Fourier transform; zeros
    between fill the axes to a length of fast transforms.
    """
    grid = tuple(scipy.fft.next_fast_len(n + side, real=True) for n in picture.shape)
    spectrum = scipy.fft.rfft2(picture, grid)
    products = scipy.fft.irfft2(spectrum.real**2 + spectrum.imag**2, grid)
    lags = np.arange(1 - side, side)
    echo = np.zeros(2 * (scipy.fft.next_fast_len(2 * side - 1, real=True),))
    echo[np.ix_(lags, lags)] = products[np.ix_(lags, lags)]
    return echo


def blurred_power(kernels: Array, echo: Array) -> Array:
    """Return the sums of squares (n,) of a picture blurred by each of ``kernels`` (n, side, side).

    ``echo`` is the picture's `autocorrelation`. By Parseval's theorem the sum is that of its
    products with the autocorrelation of the kernel.
    """
    powers = np.empty(len(kernels))
    for i, kernel in enumerate(kernels):  # one by one, which takes little memory
        spectrum = scipy.fft.rfft2(kernel, echo.shape)
        products = scipy.fft.irfft2(spectrum.real**2 + spectrum.imag**2, echo.shape)
        products *= echo
        powers[i] = products.sum()
    return np.maximum(powers, 0.0)


def expected_counts(
    error: float, swing: float, tol: float, decay: Array | None = None
) -> tuple[list[int], float]:
    """Predict the grids that `image_field` computes until their images agree."""
    bend = 0.4 * max(1.0, swing / 2)
    for i, n in enumerate(COUNTS):
        off = SAFETY * error * min(1.0, bend / n) ** (n - 1)
        if decay is not None:
            off = max(off, SAFETY * error * min(1.0, float(decay[i])))
        if off <= tol:
            break
    return list(COUNTS[: i + 1]), off


def interpolation_errors(scene: Scene) -> Array | None:
    """Test how well each grid of `COUNTS` interpolates the wave's curvature over the picture.

    The second derivatives of W in closed form follow the wall's curvature from point to point.
    A wall with several periods across the picture needs a grid that resolves them.
    """
    wall, hidden, lens = scene.wall, scene.hidden, scene.camera.position[2]
    mirrored = scene.mirrored_object_point
    footprint = scene.camera.stop_diameter * mirrored[2] / (mirrored[2] - lens)
    if wall.is_flat or footprint > wall.finest_period or not isinstance(hidden, PlanarObject):
        return None
    errors = np.zeros(len(COUNTS))
    at = np.linspace(-1.0, 1.0, 109)
    try:
        for axis in (0, 1):

            def bends(places: Array, axis: int = axis) -> Array:
                pairs = np.insert(np.full((len(places), 1), 0.3), axis, places, axis=1)
                points = [picture_point(hidden, *pair) for pair in pairs]
                return wave_bends(scene, np.array(points)).reshape(len(places), 4)

            exact = bends(at)
            for i, n in enumerate(COUNTS):
                found = chebyshev_weights(n, at) @ bends(picture_nodes(n))
                errors[i] = max(errors[i], float(np.abs(found - exact).max()))
    except SceneError:
        return None
    return errors / errors[0] if errors[0] > 0.0 else None


def picture_frame(scene: Scene) -> Array:
    """Resample the picture to the camera's image pixels, as seen in a flat wall.

    Row 0 is the picture's lower edge. The frame has at most 512 pixels per side. An entirely
    black picture is replaced by a white one.
    """
    hidden, camera = scene.hidden, scene.camera
    if not isinstance(hidden, PlanarObject):
        raise SceneError("scene.hidden is a mesh; a field of point spreads needs a PlanarObject")
    depth = float((scene.mirrored_object_point - np.array(camera.position)) @ camera.axis)
    pixels = np.array(hidden.size) * abs(scene.image_distance / depth) / camera.image_pitch
    pixels *= min(1.0, 512 / pixels.max())
    nx, ny = (max(1, round(float(n))) for n in pixels)
    rows, columns = hidden.reflectance.shape
    row = ((np.arange(ny) + 0.5) * rows / ny).astype(np.int64)
    column = ((np.arange(nx) + 0.5) * columns / nx).astype(np.int64)
    frame = np.ascontiguousarray(hidden.reflectance[::-1][np.ix_(row, column)])
    return frame if frame.any() else np.ones_like(frame)
