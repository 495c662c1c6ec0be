"""Choice of the coarsest field of point spreads that is accurate enough for an image."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from .._checks import in_range, seconds_limit, whole
from .._progress import Progress
from ..errors import SamplingError, SceneError
from ..psf import PointSpreadField, SceneOptics, point_spread_field
from ..psf.pupil.paraxial import wave_bends
from ..psf.pupil.scene_optics import optics_of
from ..psf.walls.field import chebyshev_weights, picture_nodes, picture_point
from ..psf.window.error_bounds import rounded_up
from ..scene import PlanarObject, Scene
from .forward_model import ForwardModel

Array = NDArray[np.float64]

#: Nodes along each side of the picture, tried in order.
COUNTS = (1, 2, 4, 6, 9, 13, 19, 27)
#: Two grids suffice if their images agree within this fraction of the tolerance.
SURE = 0.1
#: Largest number of pixels along the picture's longer side when fields are compared.
WIDEST = 512
#: Points along a line over the picture at which the interpolation between nodes is tested.
TESTED = 109


def image_field(
    scene: Scene | SceneOptics,
    *,
    tol: float = 1e-3,
    most_nodes: int = COUNTS[-1],
    progress: Progress | None = None,
) -> tuple[PointSpreadField, float]:
    """Compute PSFs at as many points of the hidden object as an accurate camera image needs.

    The point spread functions (PSFs) are computed on a grid of points, the nodes, over the planar
    object. The grid is refined, from 1 to 27 nodes along each side, until the camera image computed
    with it no longer changes.

    Parameters
    ----------
    scene : Scene or SceneOptics
        Scene whose hidden object is a `nlosoptics.scene.PlanarObject`. A
        `nlosoptics.psf.SceneOptics` keeps its pupil and waves for further calls.
    tol : float
        Tolerance of the result, 1e-9 to 0.1. It limits two errors: that of the object's image, rms
        error over rms image, and that of each PSF, max |dI| / max I with its intensity I.
    most_nodes : int
        Largest number of nodes along each side of the object, at least 4.
    progress : callable(str, float), optional
        Called with "field" and the completed fraction of the nodes that may be needed.

    Returns
    -------
    field : PointSpreadField
        PSFs on the finest grid of nodes that was computed. The refinement ends when the
        images of three successive grids agree within ``tol``, or those of two within a tenth of it.
    error : float
        Difference between the images of the last two grids, rms over rms; if three grids were
        compared, the larger of their two successive differences. It estimates the error of the
        coarser grids. The error of ``field``, the finest grid, is usually smaller.

    Raises
    ------
    SceneError
        If an option is out of range, or the object is a mesh.
    SamplingError
        If the images still differ at ``most_nodes``. Within `nlosoptics.simulate` with
        ``max_seconds``, also if the next grid would take longer than this limit.
    NlosError
        If a PSF cannot be computed; see `nlosoptics.psf.point_spread_field`.

    See Also
    --------
    nlosoptics.psf.point_spread_field : PSFs over the hidden object.
    nlosoptics.psf.isoplanatic_radius : Distance within which one PSF suffices.
    form_image : Image in electrons, with noise.
    """
    in_range("tol", tol, 1e-9, 0.1)
    optics = optics_of(scene)
    picture = picture_frame(optics.scene)
    most_nodes = whole("most_nodes", most_nodes, COUNTS[2])
    counts = [n for n in COUNTS if n <= most_nodes]
    before: Array | None = None
    errors = [math.inf, math.inf]
    start, limit = time.perf_counter(), seconds_limit(math.inf)
    taken, nodes = 0.0, 1  # time in s and number of nodes of the previous grid
    for step, count in enumerate(counts):
        base, share = step / len(counts), 1 / len(counts)
        begun = time.perf_counter()
        expected = begun - start + taken / nodes * count**2
        if expected > limit:
            raise SamplingError(
                f"{count} x {count} point spreads over the object would take about {expected:.3g} "
                f"s, limit max_seconds = {limit:g}; use a larger tol, or max_seconds = "
                f"{rounded_up(expected)}"
            )

        def told(name: str, done: float, base: float = base, share: float = share) -> None:
            if progress is not None:
                progress(name, base + share * done)

        field = point_spread_field(optics, count, tol=tol, checks=0, progress=told)
        image = ForwardModel(field, shape=picture.shape).forward(picture)
        if before is not None:
            errors = [errors[1], rms_difference(before, image)]
            # two grids may agree by chance, if their nodes see similar parts of a wave
            if max(errors) <= tol:
                return field, max(errors)
            if errors[1] <= SURE * tol:
                return field, errors[1]
        before, taken, nodes = image, time.perf_counter() - begun, count**2
    raise SamplingError(
        f"the picture's image still changes by {max(errors):.2g} of its rms with {counts[-1]} x "
        f"{counts[-1]} point spreads, limit tol = {tol:g}; use tol = {1.1 * max(errors):.2g}"
    )


def expected_counts(
    error: float, swing: float, tol: float, decay: Array | None = None
) -> tuple[list[int], float]:
    """Predict the grids that `image_field` computes until their images agree.

    Parameters
    ----------
    error : float
        Estimated image error with a single point spread, rms over rms.
    swing : float
        Estimated change of the waves over the picture, rad.
    tol : float
        Tolerance of the image, rms over rms.
    decay : ndarray, (8,), optional
        Relative interpolation errors of `interpolation_errors`.

    Returns
    -------
    counts : list of int
        Nodes per side of the grids.
    change : float
        Predicted difference of the images of the last grids, rms over rms; above ``tol`` if no
        grid suffices.
    """
    bend = 0.4 * max(1.0, swing / 2)
    before = math.inf
    for i, n in enumerate(COUNTS[:-1]):
        # the difference of two grids is the error of the coarser one
        off = error * min(1.0, bend / n) ** (n - 1)
        if decay is not None:
            off = max(off, error * min(1.0, float(decay[i])))
        if off <= SURE * tol or max(before, off) <= tol:
            return list(COUNTS[: i + 2]), off
        last, before = max(before, off), off
    return list(COUNTS), last


def interpolation_errors(scene: Scene) -> Array | None:
    """Test how well each grid of `COUNTS` interpolates the wave's curvature over the picture.

    The second derivatives of W in closed form follow the wall's curvature from point to point.
    A wall with several periods across the picture needs a grid that resolves them.

    Parameters
    ----------
    scene : Scene
        Scene.

    Returns
    -------
    ndarray, (8,), or None
        Largest interpolation error along two lines for each grid, relative to that of one node.
        None if the wall is flat, if the object is a mesh, if a point is reflected outside the
        wall's domain, or if the light to the lens covers more than one period of the wall, which
        averages the curvature.
    """
    wall, hidden, lens = scene.wall, scene.hidden, scene.camera.position[2]
    mirrored = scene.mirrored_object_point
    footprint = scene.camera.stop_diameter * mirrored[2] / (mirrored[2] - lens)
    if wall.is_flat or footprint > wall.finest_period or not isinstance(hidden, PlanarObject):
        return None
    errors = np.zeros(len(COUNTS))
    at = np.linspace(-1.0, 1.0, TESTED)
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

    Row 0 is the picture's lower edge. The frame has at most `WIDEST` pixels per side. An entirely
    black picture is replaced by a white one.
    """
    hidden, camera = scene.hidden, scene.camera
    if not isinstance(hidden, PlanarObject):
        raise SceneError("scene.hidden is a mesh; a field of point spreads needs a PlanarObject")
    depth = float((scene.mirrored_object_point - np.array(camera.position)) @ camera.axis)
    pixels = np.array(hidden.size) * abs(scene.image_distance / depth) / camera.image_pitch
    pixels *= min(1.0, WIDEST / pixels.max())
    nx, ny = (max(1, round(float(n))) for n in pixels)
    rows, columns = hidden.reflectance.shape
    row = ((np.arange(ny) + 0.5) * rows / ny).astype(np.int64)
    column = ((np.arange(nx) + 0.5) * columns / nx).astype(np.int64)
    frame = np.ascontiguousarray(hidden.reflectance[::-1][np.ix_(row, column)])
    return frame if frame.any() else np.ones_like(frame)


def rms_difference(found: Array, exact: Array) -> float:
    """Return the rms of ``found - exact`` divided by the rms of ``exact``."""
    return float(np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2)))
