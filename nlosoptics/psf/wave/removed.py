"""Terms that were subtracted from the aberration of a wavefront."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Removed:
    """Piston, tilt and defocus that were subtracted from the aberration of a wavefront.

    `Wavefront.removed` holds them. To restore the full aberration, add
    ``piston + tilt[0] * u + tilt[1] * v + defocus * (u**2 + v**2)/2`` to it.

    Parameters
    ----------
    piston : float
        Constant path, m.
    tilt : (float, float)
        Slopes dW/du and dW/dv of the aberration W, rad. They shift the image by
        ``tilt * image_distance``, m. `point_spread` does not apply this shift.
    defocus : float
        Coefficient c of (u^2 + v^2)/2, 1/m. A positive c moves the focus by about
        ``c * image_distance**2``, m, along the direction of the light.

    See Also
    --------
    Wavefront : Sampled wave in the exit pupil.
    wavefront : Wave aberration of a scene.
    """

    piston: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    defocus: float = 0.0
