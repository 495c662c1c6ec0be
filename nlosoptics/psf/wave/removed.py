"""Terms that were subtracted from an aberration before it was sampled."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Removed:
    """Terms subtracted from an aberration before it was sampled.

    Parameters
    ----------
    piston : float
        Constant path, m.
    tilt : (float, float)
        Slopes dW/du and dW/dv, rad. They shift the image by ``tilt * image_distance``.
    defocus : float
        Coefficient of (u^2 + v^2)/2, 1/m. It shifts the focus along the axis.

    See Also
    --------
    Wavefront : Sampled wave in the exit pupil.
    wavefront : Wave aberration of a scene.
    """

    piston: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    defocus: float = 0.0
