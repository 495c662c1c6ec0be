"""Laser class of a continuous beam: an estimate by the limits of IEC 60825-1:2014."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from .._checks import in_range, one_of
from .._nouns import Noun
from ..errors import SceneError
from ..scene import Scene

#: Classes with a limit, from the safest; class 4 is above the limit of class 3B.
CLASSES: Final = ("1", "2", "3R", "3B")
SHORTEST, LONGEST = 400e-9, 4e-6  # wavelengths for which the limits are implemented, m
VISIBLE: Final = 700e-9  # end of class 2, m
RETINAL: Final = 1400e-9  # end of the range in which light reaches the retina, m


@dataclass(frozen=True, eq=False, kw_only=True)
class LaserClass(Noun):
    """Estimated laser class, with the limits of all classes, as returned by `laser_class`.

    This is an estimate for the design of an experiment and no classification. A classification
    needs measurements on the product, also with optical instruments and with single faults.

    Parameters
    ----------
    name : {"1", "2", "3R", "3B", "4"}
        Safest class whose limit the beam meets.
    power : float
        Largest power through the aperture that stands for the pupil of the eye, W.
    aperture : float
        Diameter of this aperture, m.
    limits : mapping of str to float
        Accessible emission limit of each class at the laser's wavelength, W. Class 2 exists from
        400 nm to 700 nm only. Class 4 has no limit.

    See Also
    --------
    laser_class : Estimate the class of a scene's laser.
    """

    name: str
    power: float
    aperture: float
    limits: Mapping[str, float]

    def ratio(self, laser_class: str = "1") -> float:
        """Return the power through the aperture divided by the limit of a class.

        At most 1 if the beam meets the limit. In contrast to the class, the ratio is a continuous
        function of power and beam diameter, as an optimisation needs it.

        Parameters
        ----------
        laser_class : {"1", "2", "3R", "3B"}
            Class with the limit.

        Raises
        ------
        SceneError
            If there is no such class at the laser's wavelength.
        """
        one_of("laser_class", laser_class, CLASSES)
        if laser_class not in self.limits:
            raise SceneError(
                f"laser_class = {laser_class!r} has no limit at this wavelength, must be one of "
                f"{', '.join(self.limits)}; class 2 exists from 400 nm to 700 nm"
            )
        return self.power / self.limits[laser_class]

    def __str__(self) -> str:
        """Return class, power and limits as text."""
        limits = ", ".join(f"class {name} {1e3 * w:.3g} mW" for name, w in self.limits.items())
        return (
            f"class {self.name} (estimate): {1e3 * self.power:.3g} mW through "
            f"{1e3 * self.aperture:.2g} mm; limits: {limits}"
        )


def laser_class(scene: Scene) -> LaserClass:
    """Estimate the laser class of a scene's continuous laser from wavelength, power and diameter.

    This is an estimate for the design of an experiment and no classification. It covers the bare
    beam as it leaves the laser, seen without optical instruments. It does not distinguish classes
    1M, 2M and 1C. A beam wider than the aperture can be more dangerous through binoculars.

    Parameters
    ----------
    scene : Scene
        Scene with the laser, whose wavelength is 400 nm to 4 um.

    Returns
    -------
    LaserClass
        Class, power through the aperture of the eye, and limits of all classes.

    Raises
    ------
    SceneError
        If the wavelength is outside 400 nm to 4 um, or the scene is time-resolved, so that its
        laser is pulsed.

    See Also
    --------
    feasibility : What an image of the scene shows.

    Notes
    -----
    Limits are those of [1]_ for a point source (C6 = 1) that emits continuously, in W, with the
    wavelength L in nm:

    ==================  ================================  ===========  =============  =====
    wavelength          class 1 (table 3)                 2 (table 5)  3R (table 6)   3B
    ==================  ================================  ===========  =============  =====
    400 nm to 700 nm    3.9e-4, at most 3.9e-5 C3         1e-3         5e-3           0.5
    700 nm to 1400 nm   3.9e-4 C4 C7, at most 0.5         none         5 x class 1    0.5
    1400 nm to 4000 nm  1e-2                              none         5e-2           0.5
    ==================  ================================  ===========  =============  =====

    Limits of class 3B are in table 8 of [1]_; those of class 3R do not exceed them. The factors are
    those of table 9: C3 = 1 up to 450 nm, then 10^(0.02 (L - 450)); C4 = 10^(0.002 (L - 700)) up to
    1050 nm, then 5; C7 = 1 up to 1150 nm, then 10^(0.018 (L - 1150)) up to 1200 nm, then
    8 + 10^(0.04 (L - 1250)). The limit with C3 is the photochemical one, 3.9e-3 C3 J in 100 s; it
    is below the thermal one up to 500 nm. The time base is 0.25 s for class 2 and visible light of
    class 3R, and 100 s otherwise.

    The aperture is that of table 10 of [1]_ for the unaided eye (condition 3): 7 mm up to 1400 nm,
    3.5 mm beyond. Of a beam of diameter D, an aperture of diameter a is taken to pass the fraction
    ``min(1, 2 (a/D)^2)``. This is an upper bound for a uniform beam, ``min(1, (a/D)^2)``, and for a
    Gaussian beam whose irradiance at D/2 is 1/e^2 of its maximum, ``1 - exp(-2 (a/D)^2)``.

    References
    ----------
    .. [1] IEC 60825-1:2014, Safety of laser products, part 1: Equipment classification and
       requirements, edition 3.

    Examples
    --------
    >>> from nlosoptics import Scene, limits
    >>> found = limits.laser_class(Scene.load("examples/scenes/letter_flat.toml"))
    >>> found.name, round(found.ratio("2"), 2)
    ('3R', 5.0)
    """
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    if scene.transient is not None:
        raise SceneError(
            "the laser class of a scene with the table [transient] needs the limits of pulses, "
            "which are not implemented; remove the table for a continuous laser"
        )
    laser = scene.laser
    limits = _limits(laser.wavelength)
    aperture = 7e-3 if laser.wavelength < RETINAL else 3.5e-3
    power = laser.power * min(1.0, 2 * (aperture / laser.beam_diameter) ** 2)
    return LaserClass(
        name=next((name for name, limit in limits.items() if power <= limit), "4"),
        power=power,
        aperture=aperture,
        limits=MappingProxyType(limits),
    )


def _limits(wavelength: float) -> dict[str, float]:
    """Return the accessible emission limit of each class at a wavelength in m, W."""
    in_range(
        "laser.wavelength",
        wavelength,
        SHORTEST,
        LONGEST,
        unit="m",
        remedy="the limits of the laser class are implemented for these wavelengths only",
    )
    nm = 1e9 * wavelength
    if wavelength < VISIBLE:
        c3 = 10 ** (0.02 * max(0.0, nm - 450))
        return {"1": min(3.9e-4, 3.9e-5 * c3), "2": 1e-3, "3R": 5e-3, "3B": 0.5}
    if wavelength < RETINAL:
        c4 = 10 ** (0.002 * (nm - 700)) if nm < 1050 else 5.0
        first = min(3.9e-4 * c4 * _c7(nm), 0.5)
        return {"1": first, "3R": min(5 * first, 0.5), "3B": 0.5}
    return {"1": 1e-2, "3R": 5e-2, "3B": 0.5}


def _c7(nm: float) -> float:
    """Return the factor C7, by which the front of the eye absorbs, at a wavelength in nm."""
    if nm < 1200:
        return float(10 ** (0.018 * max(0.0, nm - 1150)))
    return float(8 + 10 ** (0.04 * (nm - 1250)))
