"""The light source."""

from __future__ import annotations

from dataclasses import dataclass

from ..._checks import Vector, in_range, positive, vector, whole
from ...errors import SceneError


@dataclass(frozen=True, kw_only=True)
class Laser:
    """Collimated beam that lights one spot of the relay wall.

    Parameters
    ----------
    wavelength : float
        In vacuum, m.
    power : float
        Continuous power on the wall, W.
    beam_diameter : float
        Diameter of the beam, m, uniform.
    position, aim : (float, float, float)
        Where the beam starts and the point of the mean wall plane that it is aimed at, m.
    independent_patterns : int or None
        Number of independent speckle patterns that one exposure averages; None for light made
        spatially incoherent (a fast diffuser in the beam), which shows no speckle.
    """

    wavelength: float
    power: float
    beam_diameter: float
    position: Vector
    aim: Vector = (0.0, 0.0, 0.0)
    independent_patterns: int | None = None

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(
            self,
            "wavelength",
            in_range(
                "laser.wavelength",
                self.wavelength,
                1e-8,
                1e-4,
                unit="m",
                remedy="was it given in nanometres?",
            ),
        )
        put(self, "power", positive("laser.power", self.power, unit="W"))
        put(self, "beam_diameter", positive("laser.beam_diameter", self.beam_diameter, unit="m"))
        put(self, "position", vector("laser.position", self.position))
        put(self, "aim", vector("laser.aim", self.aim))
        if self.independent_patterns is not None:
            patterns = whole("laser.independent_patterns", self.independent_patterns)
            put(self, "independent_patterns", patterns)
        if self.position[2] <= 0:
            raise SceneError(
                f"laser.position has z = {self.position[2]:g} m, behind the wall; must be above 0"
            )
