"""A rough wall as the pupil sees it: phases and their correlation between pupil points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import in_range
from ...errors import SceneError
from ...scene import Scene
from ..pupil.scene_optics import PointOptics, SceneOptics, optics_of
from ..pupil.wall_view import WallView
from ..wave.detilted import Residual, split
from ..wave.wavefront import Wavefront
from .roughness import Roughness

Array = NDArray[np.float64]
Found = TypeVar("Found")


@dataclass(frozen=True, eq=False)
class RoughView:
    """Roughness with the geometry by which the pupil sees it.

    Parameters
    ----------
    roughness : Roughness
    footprint : ndarray, (2, 2)
        M, from exit-pupil separation to separation on the wall.
    rayleigh_parameter : float
        s, rad.
    effective_distance : ndarray (2, 2) or None
        m, as of `WallView`; the mean does not need it.
    """

    roughness: Roughness
    footprint: Array
    rayleigh_parameter: float
    effective_distance: Array | None = None

    def of(self, part: Roughness) -> RoughView:
        """View of a part of the heights."""
        whole = self.roughness.height_rms
        share = part.height_rms / whole if whole > 0 else 0.0
        return replace(self, roughness=part, rayleigh_parameter=share * self.rayleigh_parameter)

    def lags(self, du: Array, dv: Array) -> Array:
        """Distance on the wall between the points that two pupil points see, m."""
        m = self.footprint
        along, across = (m[i, 0] * du + m[i, 1] * dv for i in (0, 1))
        return np.asarray(np.hypot(along, across))

    def diffuse_transfer(self, lag: Array) -> Array:
        """``exp(-s^2 [1 - C]) - exp(-s^2)``."""
        square = self.rayleigh_parameter**2
        if square < 1:
            # no difference of nearly equal numbers where both are near 1
            return np.asarray(
                math.exp(-square) * np.expm1(square * self.roughness.correlation(lag))
            )
        return np.exp(-square * self.roughness.structure(lag)) - math.exp(-square)

    def last_lag(self, cut: float) -> float:
        """Lag beyond which that has fallen to a share ``cut`` of its value at 0, m."""
        square = self.rayleigh_parameter**2
        if square > 500:  # exp would overflow
            level = 1 + math.log(cut) / square
        else:
            level = math.log1p(cut * math.expm1(square)) / square if square > 0 else cut
        return self.roughness.reach(level)

    def halo(self, wave: Wavefront) -> float:
        """Radius in the image, m, of about 3 standard deviations of the scattered light.

        Taken from the lag at which the diffuse transfer function has fallen to 1/e, as if it were
        Gaussian; an exponential C has wider tails.
        """
        if self.rayleigh_parameter == 0:
            return 0.0
        lag = min(self.last_lag(math.exp(-1)), 1e3 * self.roughness.correlation_length)
        step = lag / float(np.linalg.norm(self.footprint, 2))
        return 3 * math.sqrt(2) * wave.wavelength * abs(wave.image_distance) / (2 * math.pi * step)


@dataclass(frozen=True, eq=False)
class RoughSource:
    """Smooth wave of a rough wall, and how the pupil sees the roughness.

    Parameters
    ----------
    residual : Residual
        Wave of the smooth wall; of a scene, at the nodes that are tried first.
    view : RoughView
    seen : PointOptics or None
        Optics of the scene's reference point; None where a wavefront was given.
    """

    residual: Residual
    view: RoughView
    seen: PointOptics | None = None

    def refined(self, use: Callable[[Residual], Found]) -> Found:
        """Apply a function to the wave, of a scene with more pupil nodes where they are too few."""
        if self.seen is None:
            return use(self.residual)
        return self.seen.refined(lambda aimed: use(aimed.residual))[1]


def rough_source(
    source: Wavefront | Scene | SceneOptics,
    roughness: Roughness,
    footprint: ArrayLike | None,
    cos_sum: float | None,
    effective_distance: ArrayLike | None = None,
) -> RoughSource:
    """Wave of the smooth wall and the rough wall's view, from a scene or from what is given.

    Parameters
    ----------
    source : Wavefront, Scene or SceneOptics
    roughness : Roughness
    footprint, cos_sum, effective_distance
        How the pupil sees the wall, see `WallView`; with a wavefront only.

    Returns
    -------
    RoughSource

    Raises
    ------
    SceneError
        If geometry is missing, given with a scene, or not a matrix that can be inverted.
    """
    given = {
        "footprint": footprint,
        "cos_sum": cos_sum,
        "effective_distance": effective_distance,
    }
    if isinstance(source, Scene | SceneOptics):
        for name, value in given.items():
            if value is not None:
                raise SceneError(f"{name} is given with a scene, which has its own; leave it out")
        seen = optics_of(source).reference
        return RoughSource(
            seen.first.residual, rough_view(seen.first.wave, seen.view, roughness), seen
        )
    if not isinstance(source, Wavefront):
        raise SceneError(
            f"source is a {type(source).__name__}; give a Scene, or a Wavefront with its footprint "
            "and cos_sum"
        )
    for name in ("footprint", "cos_sum"):
        if given[name] is None:
            raise SceneError(
                f"{name} is missing; a wavefront does not say how it sees the wall, take it "
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
    s = 2 * math.pi / source.wavelength * cosines * roughness.height_rms
    return RoughSource(split(source), RoughView(roughness, m, s, distance))


def rough_view(wave: Wavefront, seen: WallView, roughness: Roughness) -> RoughView:
    """View of roughness on a wall.

    Parameters
    ----------
    wave : Wavefront
        Wave of the smooth wall.
    seen : WallView
        How its pupil sees the wall.
    roughness : Roughness
        Statistics of the heights.

    Returns
    -------
    RoughView
    """
    s = 2 * math.pi / wave.wavelength * seen.cos_sum * roughness.height_rms
    return RoughView(roughness, seen.footprint, s, seen.effective_distance)


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
