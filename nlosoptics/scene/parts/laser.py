"""Light source: a collimated laser beam."""

from __future__ import annotations

from dataclasses import dataclass

from ..._checks import Vector, in_range, positive, vector, whole
from ...errors import SceneError
from ._quantities import Length, Power


@dataclass(frozen=True, kw_only=True)
class Laser:
    """Collimated laser beam that illuminates one spot of the relay wall.

    Parameters
    ----------
    wavelength : float
        Vacuum wavelength, m, 1e-8 to 1e-4.
    power : float
        Power of the continuous beam on the wall, W, up to 1e18. 0 is a scene without laser light,
        whose object is luminous or in ambient light; ``wavelength`` then applies to this light.
    beam_diameter : float, default 1e-3
        Diameter of the beam, m; the irradiance is uniform across it.
    position : (float, float, float)
        Start of the beam, world frame, m.
    aim : (float, float, float)
        Point of the mean wall plane z = 0 that the beam is aimed at, world frame, m.
    independent_patterns : int, optional
        Number of independent speckle patterns that are averaged in one exposure; 1 for a laser
        without averaging. By default the light is spatially incoherent, as behind a fast rotating
        diffuser, and the image shows no speckle.

    Raises
    ------
    SceneError
        If a value is out of range or ``position`` is behind the wall.

    See Also
    --------
    Scene : Complete scene.
    Camera : Lens and detector.

    Examples
    --------
    >>> from nlosoptics.scene import Laser
    >>> laser = Laser(
    ...     wavelength=632.8e-9, power=5e-3, beam_diameter=3e-3, position=(0.3, 0.0, 1.2)
    ... )
    >>> laser.aim
    (0.0, 0.0, 0.0)
    """

    wavelength: Length
    power: Power
    beam_diameter: Length = 1e-3
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
        # far above any laser, so that numbers of photons stay finite
        power = in_range("laser.power", self.power, 0.0, 1e18, unit="W")
        put(self, "power", power)
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


#: Laser of a scene file without one. The wavelength is that of green light.
NO_LASER = Laser(wavelength=550e-9, power=0.0, beam_diameter=1e-3, position=(0.0, 0.0, 1.0))
