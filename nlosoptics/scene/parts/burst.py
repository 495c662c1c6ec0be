"""Burst of exposures of one still object, each through another part of a rough wall."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..._checks import positive, whole
from ...errors import SceneError
from ._quantities import Length

#: Shift of the lens, over its diameter, at which the correlation of two patterns is one half.
HALF = 0.231


@dataclass(frozen=True, kw_only=True)
class Burst:
    """Exposures of one still object from camera positions on a square raster.

    A rough wall blurs the object by a speckle pattern. From each position the camera sees the
    object by another part of the wall, so that the object stays the same and the pattern changes.
    `nlosoptics.plan`, `nlosoptics.simulate` and `nlosoptics.inverse.burst_fit` use the burst; all
    other computations are about the first exposure.

    Parameters
    ----------
    images : int
        Number of exposures, 4 to 1000.
    camera_step : float
        Pitch of the raster, m. The exposures are taken at the points of the raster nearest to
        ``camera.position``, beginning there. The raster is perpendicular to the optical axis, and
        the camera is turned so that its axis passes through the same point in focus.

    Raises
    ------
    SceneError
        If a value is out of range. A `Scene` also refuses a burst without a rough wall, and a step
        that leaves more than half of the speckle pattern unchanged.

    See Also
    --------
    Scene.exposures : Scene of each exposure.
    WallRoughness : Roughness of the wall.

    Notes
    -----
    The lens sees each object point in a part of the wall that is as wide as its stop, reduced by
    the distances. A shift of the camera moves this part by the same ratio. The intensity patterns
    before and after a shift s of a stop of diameter D have the correlation of their overlap,
    ``[2/pi (acos t - t sqrt(1 - t^2))]^2`` with t = s/D, once the wall's heights change within the
    part: 0.5 at 0.23 D, 0.05 at 0.66 D. Steps of millimetres are therefore enough only for stops of
    millimetres, however fine the roughness is.

    Moving the laser spot changes the light on the object but not the pattern. A change of the
    wavelength by a fraction q changes the pattern once q times the rms phase of the roughness
    exceeds 1 rad. For walls whose pattern fits on a detector this takes a third of the wavelength.

    Examples
    --------
    >>> from nlosoptics.scene import Burst
    >>> burst = Burst(images=16, camera_step=10e-3)
    >>> (1e3 * burst.offsets[:3]).round().tolist()
    [[0.0, 0.0], [-10.0, 0.0], [0.0, -10.0]]
    >>> round(burst.independent(stop_diameter=15e-3), 1)
    14.1
    """

    images: int
    camera_step: Length

    def __post_init__(self) -> None:
        object.__setattr__(self, "images", whole("burst.images", self.images, 4, 1000))
        step = positive("burst.camera_step", self.camera_step, unit="m")
        object.__setattr__(self, "camera_step", step)

    @property
    def offsets(self) -> NDArray[np.float64]:
        """Shift of the camera along its axes e1 and e2 in each exposure, (images, 2), m."""
        reach = math.ceil(math.sqrt(self.images / math.pi)) + 1
        raster = product(range(-reach, reach + 1), repeat=2)
        nearest = sorted(raster, key=lambda point: (point[0] ** 2 + point[1] ** 2, point))
        return self.camera_step * np.array(nearest[: self.images], dtype=np.float64)

    def independent(self, stop_diameter: float) -> float:
        """Return the number of independent patterns whose mean power varies as little.

        It is ``images^2`` over the sum of the correlations of all pairs, 1 to ``images``.

        Parameters
        ----------
        stop_diameter : float
            Diameter of the camera's lens, m.
        """
        shifts = np.linalg.norm(self.offsets[:, None] - self.offsets, axis=-1)
        t = np.minimum(shifts / stop_diameter, 1.0)
        overlap = 2.0 / math.pi * (np.arccos(t) - t * np.sqrt(1.0 - t * t))
        return float(self.images**2 / np.sum(overlap**2))

    def check_step(self, stop_diameter: float, length: float) -> None:
        """Raise `SceneError` if the patterns of neighbouring exposures are too similar.

        Parameters
        ----------
        stop_diameter : float
            Diameter of the camera's lens, m.
        length : float
            Shift of the camera, m, that moves the part of the wall by the scale of its heights.
        """
        least = max(HALF * stop_diameter, length)
        if self.camera_step < least:
            why = "the correlation length of the wall, seen from the camera"
            if length < HALF * stop_diameter:
                why = f"{HALF} camera.stop_diameter, below which the patterns correlate by half"
            raise SceneError(
                f"burst.camera_step = {self.camera_step:g} m gives dependent speckle, limit "
                f"{least:.3g} m ({why}); use a longer step or a smaller stop"
            )
