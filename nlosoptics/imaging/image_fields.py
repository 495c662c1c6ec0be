"""The coarsest field of point spreads that an image needs."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from .._checks import in_range, seconds_limit, whole
from .._progress import Progress
from ..errors import SamplingError, SceneError
from ..psf import PointSpreadField, SceneOptics, point_spread_field
from ..psf.pupil.scene_optics import optics_of
from ..psf.window.error_bounds import rounded_up
from ..scene import PlanarObject, Scene
from .forward_model import ForwardModel

Array = NDArray[np.float64]

#: Nodes along each side of the picture, tried in turn.
COUNTS = (1, 2, 4, 6, 9, 13, 19, 27)
#: Share of the tolerance within which two grids are enough.
SURE = 0.1
#: Image pixels along the longer side of the picture, at most, by which fields are compared.
WIDEST = 512


def image_field(
    scene: Scene | SceneOptics,
    *,
    tol: float = 1e-3,
    most_nodes: int = COUNTS[-1],
    progress: Progress | None = None,
) -> tuple[PointSpreadField, float]:
    """Point spreads over the hidden picture at as many nodes as its image needs.

    Parameters
    ----------
    scene : Scene or SceneOptics
        With a `PlanarObject`.
    tol : float
        Wanted rms error of the picture's image, relative to its rms; also the wanted error of
        every point spread, max |dI|/max I.
    most_nodes : int
        Along each side of the picture, at most; 4 or more, for three grids of nodes.
    progress : callable(str, float), optional
        Told "field" and the fraction done of the nodes that may be needed.

    Returns
    -------
    field : PointSpreadField
        On the finest of three grids of nodes whose images agree within ``tol``, or of two that
        agree within a tenth of it.
    error : float
        By how much they differ, rms over rms: the error of the coarser ones.

    Raises
    ------
    SceneError
        If an option is out of range or the object is a mesh.
    SamplingError
        If no grid within ``most_nodes`` agrees with the two before, or the next one would pass the
        seconds of a run's budget.
    NlosError
        As of `psf.point_spread_field`.
    """
    in_range("tol", tol, 1e-9, 0.1)
    optics = optics_of(scene)
    picture = picture_frame(optics.scene)
    most_nodes = whole("most_nodes", most_nodes, COUNTS[2])
    counts = [n for n in COUNTS if n <= most_nodes]
    before: Array | None = None
    errors = [math.inf, math.inf]
    start, limit = time.perf_counter(), seconds_limit(math.inf)
    taken, nodes = 0.0, 1  # s, of so many nodes, the field before
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
            # two grids may agree by chance, where their nodes see the same part of a wave
            if max(errors) <= tol:
                return field, max(errors)
            if errors[1] <= SURE * tol:
                return field, errors[1]
        before, taken, nodes = image, time.perf_counter() - begun, count**2
    raise SamplingError(
        f"the picture's image still changes by {max(errors):.2g} of its rms with {counts[-1]} x "
        f"{counts[-1]} point spreads, limit tol = {tol:g}; use tol = {1.1 * max(errors):.2g}"
    )


def expected_counts(error: float, swing: float, tol: float) -> list[int]:
    """Nodes a side of the fields that `image_field` computes until their images agree."""
    bend = 0.4 * max(1.0, swing / 2)
    before = math.inf
    for i, n in enumerate(COUNTS[:-1]):
        # two grids differ by the error of the coarser one
        off = error * min(1.0, bend / n) ** (n - 1)
        if off <= SURE * tol or max(before, off) <= tol:
            return list(COUNTS[: i + 2])
        before = off
    return list(COUNTS)


def picture_frame(scene: Scene) -> Array:
    """The picture in image pixels of the camera, as a flat wall shows it; row 0 at its lower edge.

    At most `WIDEST` pixels a side; white where the picture is black.
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
    """Root mean square of the difference over that of the second."""
    return float(np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2)))
