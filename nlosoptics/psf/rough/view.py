"""Phase statistics of a rough wall in pupil coordinates."""

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
    """Roughness, with the geometry that maps pupil points to wall points.

    Parameters
    ----------
    roughness : Roughness
        Statistics of the heights.
    footprint : ndarray, (2, 2)
        Matrix M from a separation in the exit pupil to the separation on the wall.
    rayleigh_parameter : float
        s, rad: rms phase due to the heights.
    effective_distance : ndarray (2, 2) or None
        Matrix d_eff of `WallView`, m; not needed for the mean.
    """

    roughness: Roughness
    footprint: Array
    rayleigh_parameter: float
    effective_distance: Array | None = None

    def of(self, part: Roughness) -> RoughView:
        """Return the view of a part of the heights, such as from `Roughness.split`."""
        whole = self.roughness.height_rms
        share = part.height_rms / whole if whole > 0 else 0.0
        return replace(self, roughness=part, rayleigh_parameter=share * self.rayleigh_parameter)

    def lags(self, du: Array, dv: Array) -> Array:
        """Return the separation on the wall, m, for separations (du, dv) in the pupil, m."""
        m = self.footprint
        along, across = (m[i, 0] * du + m[i, 1] * dv for i in (0, 1))
        return np.asarray(np.hypot(along, across))

    def diffuse_transfer(self, lag: Array) -> Array:
        """Return the scattered part of the transfer function, ``exp(-s^2 [1 - C]) - exp(-s^2)``.

        ``lag`` holds separations on the wall, m, of any shape.
        """
        square = self.rayleigh_parameter**2
        if square < 1:
            # expm1 avoids the cancellation of two numbers near 1
            return np.asarray(
                math.exp(-square) * np.expm1(square * self.roughness.correlation(lag))
            )
        return np.exp(-square * self.roughness.structure(lag)) - math.exp(-square)

    def last_lag(self, cut: float) -> float:
        """Return the lag, m, beyond which `diffuse_transfer` is below ``cut`` times that at 0."""
        square = self.rayleigh_parameter**2
        if square > 500:  # exp would overflow
            level = 1 + math.log(cut) / square
        else:
            level = math.log1p(cut * math.expm1(square)) / square if square > 0 else cut
        return self.roughness.reach(level)

    def halo(self, wave: Wavefront) -> float:
        """Return the radius of the halo in the image, m: about 3 standard deviations.

        The standard deviation is that of a Gaussian with the same 1/e lag of `diffuse_transfer`.
        The halo of an exponential C has wider tails.
        """
        if self.rayleigh_parameter == 0:
            return 0.0
        lag = min(self.last_lag(math.exp(-1)), 1e3 * self.roughness.correlation_length)
        step = lag / float(np.linalg.norm(self.footprint, 2))
        return 3 * math.sqrt(2) * wave.wavelength * abs(wave.image_distance) / (2 * math.pi * step)


@dataclass(frozen=True, eq=False)
class RoughSource:
    """Smooth wave of a rough wall, and the view of its roughness.

    Parameters
    ----------
    residual : Residual
        Wave of the smooth wall. For a scene, at the first set of nodes.
    view : RoughView
        View of the roughness from the pupil.
    seen : PointOptics or None
        Optics of the scene's reference point; None if a wavefront was given.
    """

    residual: Residual
    view: RoughView
    seen: PointOptics | None = None

    def refined(self, use: Callable[[Residual], Found]) -> Found:
        """Return ``use(residual)``; for a scene, refine the pupil nodes until it succeeds."""
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
    """Return smooth wave and roughness view, from a scene or from a wavefront and its geometry.

    Parameters
    ----------
    source : Wavefront, Scene or SceneOptics
        Wave of the smooth wall, or the scene from which it is computed.
    roughness : Roughness
        Statistics of the heights.
    footprint, cos_sum, effective_distance
        Geometry of wall and pupil, see `WallView`; with a wavefront only.

    Returns
    -------
    RoughSource

    Raises
    ------
    SceneError
        If geometry is missing, given with a scene, or not an invertible matrix.
    """
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
    s = 2 * math.pi / source.wavelength * cosines * roughness.height_rms
    return RoughSource(split(source), RoughView(roughness, m, s, distance))


def rough_view(wave: Wavefront, seen: WallView, roughness: Roughness) -> RoughView:
    """Return the view of a roughness on a wall from its geometry.

    Parameters
    ----------
    wave : Wavefront
        Wave of the smooth wall.
    seen : WallView
        Geometry of wall and pupil.
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
