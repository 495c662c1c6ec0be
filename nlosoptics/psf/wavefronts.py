"""The wave at the exit pupil, sampled."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Layout = Literal["polar", "grid", "scattered"]


@dataclass(frozen=True, kw_only=True)
class Removed:
    """Terms taken out of an aberration before it was sampled.

    Parameters
    ----------
    piston : float
        m.
    tilt : (float, float)
        Slopes dW/du and dW/dv; they shift the image by ``tilt * image_distance``.
    defocus : float
        Coefficient of (u^2 + v^2)/2, 1/m: a longitudinal shift of focus.
    """

    piston: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    defocus: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Wavefront:
    """Samples of the wave in the exit pupil.

    Parameters
    ----------
    u, v : ndarray
        Pupil coordinates, m, parallel to the image's x and y. Polar: (n_r, n_theta), radii at
        Gauss-Legendre nodes of r^2, angles 2 pi j/n_theta. Grid: (n, n), rows are v,
        ``(arange(n) - n//2) * pitch``. Scattered: (n,).
    aberration : ndarray
        W, m, positive where the wave has gone a longer path than the reference.
    amplitude : ndarray
        Relative, 1 for the unobstructed clear pupil.
    weights : ndarray
        Pupil area that each node stands for, m^2; edge cells of a grid count with the part that
        lies inside.
    wavelength : float
        m.
    image_distance : float
        From pupil to image, m; negative when the pupil lies behind the image.
    pupil_radius : float
        m.
    obscuration : float
        Inner radius of an annular pupil as a fraction of the outer.
    layout : {"polar", "grid", "scattered"}
    removed : Removed
        What ``aberration`` no longer holds.
    """

    u: Array
    v: Array
    aberration: Array
    amplitude: Array
    weights: Array
    wavelength: float
    image_distance: float
    pupil_radius: float
    obscuration: float = 0.0
    layout: Layout
    removed: Removed = field(default_factory=Removed)
