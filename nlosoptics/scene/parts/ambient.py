"""Ambient light of the room."""

from __future__ import annotations

from dataclasses import dataclass

from ..._checks import in_range
from ._quantities import Irradiance


@dataclass(frozen=True, kw_only=True)
class Ambient:
    """Light of the room that reaches wall and hidden object without the laser.

    It lights the object, and adds to the image of a matt wall a background that varies slowly.
    `nlosoptics.imaging.WallTransport` uses it; computations of laser light refuse it.

    Parameters
    ----------
    irradiance : float
        Irradiance of wall and object, W/m^2, 0 to 1e18.

    Raises
    ------
    SceneError
        If the value is out of range.

    See Also
    --------
    PlanarObject : Hidden object, which may be luminous itself.

    Examples
    --------
    >>> from nlosoptics.scene import Ambient
    >>> Ambient(irradiance=0.5)
    Ambient(irradiance=0.5)
    """

    irradiance: Irradiance

    def __post_init__(self) -> None:
        value = in_range("ambient.irradiance", self.irradiance, 0.0, 1e18, unit="W/m^2")
        object.__setattr__(self, "irradiance", value)
