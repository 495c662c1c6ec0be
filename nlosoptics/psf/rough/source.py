"""Smooth wave and view of a rough wall, from a scene or from a wavefront with its geometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import in_range
from ..._vectors import Array
from ...errors import SceneError
from ...scene import FacetWall, GaussianWall, HeightMapWall, Scene
from ..pupil.scene_optics import PointOptics, SceneOptics, optics_of
from ..pupil.wall_view import WallView
from ..wave.detilted import Residual, split
from ..wave.wavefront import Wavefront
from .facets import FacetView
from .relief import Relief, ReliefView
from .roughness import Roughness
from .view import RoughView

Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class RoughSource:
    """Wave of a wall without its roughness, with the statistics and geometry of the roughness."""

    # Wave of the smooth wall, without piston and tilt; for a scene with the default sampling.
    residual: Residual
    view: RoughView  # Statistics of the roughness, and the geometry by which the pupil sees it
    # Store of the scene's wave, from which more samples can be had; None if a wavefront was
    # given.
    seen: PointOptics | None = None

    def refined(self, use: Callable[[Residual], Found]) -> Found:
        """Apply a function to the wave; for a scene, repeat it with more samples as needed."""
        if self.seen is None:
            return use(self.residual)
        return self.seen.refined(lambda aimed: use(aimed.residual))[1]


def rough_source(
    source: Wavefront | Scene | SceneOptics,
    roughness: Roughness | Relief,
    footprint: ArrayLike | None,
    cos_sum: float | None,
    effective_distance: ArrayLike | None = None,
    *,
    pattern: bool = False,
) -> RoughSource:
    """Return smooth wave and roughness view, from a scene or from a wavefront and its geometry."""
    given = {
        "footprint": footprint,
        "cos_sum": cos_sum,
        "effective_distance": effective_distance,
    }
    if isinstance(source, Scene | SceneOptics):
        for name, value in given.items():
            if value is not None:
                raise SceneError(f"{name} is given with a scene, which defines it; leave it out")
        seen = optics_of(source).reference
        return RoughSource(
            seen.first.residual,
            rough_view(seen.first.wave, seen.view, roughness, pattern=pattern),
            seen,
        )
    if not isinstance(source, Wavefront):
        raise SceneError(
            f"source is a {type(source).__name__}; give a Scene, or a Wavefront with its footprint "
            "and cos_sum"
        )
    for name in ("footprint", "cos_sum"):
        if given[name] is None:
            raise SceneError(
                f"{name} is missing, but a wavefront does not hold the wall's geometry; take it "
                "from psf.wall_view"
            )
    m = _matrix("footprint", footprint)
    cosines = in_range("cos_sum", cos_sum, 0.0, 2.0, open_low=True)
    distance = None
    if effective_distance is not None:
        distance = _matrix("effective_distance", effective_distance)
        if abs(distance[0, 1] - distance[1, 0]) > 1e-9 * np.abs(distance).max():
            raise SceneError(
                f"effective_distance = {distance.tolist()} m is not symmetric; take it from "
                "psf.wall_view"
            )
    view = _view(roughness, m, 2 * math.pi / source.wavelength * cosines, distance, pattern)
    return RoughSource(split(source), view)


def rough_view(
    wave: Wavefront, seen: WallView, roughness: Roughness | Relief, *, pattern: bool = False
) -> RoughView:
    """Return the view of a roughness on a wall from its geometry."""
    per_metre = 2 * math.pi / wave.wavelength * seen.cos_sum
    place = seen.point[:2], seen.tangents[:, :2]
    return _view(roughness, seen.footprint, per_metre, seen.effective_distance, pattern, *place)


def _view(
    roughness: Roughness | Relief,
    footprint: Array,
    per_metre: float,
    distance: Array | None,
    pattern: bool,
    origin: ArrayLike = (0.0, 0.0),
    axes: ArrayLike = ((1.0, 0.0), (0.0, 1.0)),
) -> RoughView:
    """Return the view of a roughness; ``per_metre`` is the phase per height, rad/m."""
    if pattern and isinstance(roughness, Relief):
        s = per_metre * roughness.height_rms
        places = np.array(origin, dtype=np.float64), np.array(axes, dtype=np.float64)
        return ReliefView(roughness, footprint, s, distance, *places)
    if isinstance(roughness, FacetWall):
        return FacetView(roughness, footprint, per_metre * roughness.height_rms, distance)
    if isinstance(roughness, GaussianWall):
        roughness = Roughness(roughness.height_rms, roughness.correlation_length)
    if isinstance(roughness, HeightMapWall):
        # Gaussian heights with the rms height and slope of the map
        height, slope = roughness.height_rms, roughness.slope_rms
        length = math.sqrt(2) * height / slope if slope > 0 else roughness.pitch
        roughness = Roughness(height, length)
    if not isinstance(roughness, Roughness):
        raise SceneError(
            f"roughness is a {type(roughness).__name__}; give a Roughness, a FacetWall, a "
            "GaussianWall or a HeightMapWall"
        )
    return RoughView(roughness, footprint, per_metre * roughness.height_rms, distance)


def _matrix(name: str, value: ArrayLike | None) -> Array:
    """Check a 2 x 2 matrix; one number stands for a multiple of the unit matrix."""
    matrix = np.asarray(value, dtype=np.float64)
    if matrix.ndim == 0:
        matrix = float(matrix) * np.eye(2)
    if matrix.shape != (2, 2) or not np.isfinite(matrix).all():
        raise SceneError(f"{name} has shape {matrix.shape}; give a number or a finite (2, 2)")
    if abs(np.linalg.det(matrix)) <= 1e-12 * np.linalg.norm(matrix) ** 2:
        raise SceneError(f"{name} = {matrix.tolist()} is singular; give an invertible matrix")
    return matrix
