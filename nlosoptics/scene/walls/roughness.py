"""Roughness of a scene's wall: a relief on the mean wall, as one pattern or as its mean."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..._checks import in_range, one_of
from ..._nouns import Noun
from ...errors import SceneError
from ..parts._material import Material, MirrorLobe
from ..parts.materials import SpecularMicrofacet, SumMaterial
from .analytic import SumWall, Wall
from .height_maps import CallableWall, HeightMapWall
from .relief import FacetWall, GaussianWall


@dataclass(frozen=True)
class WallRoughness(Noun):
    """Roughness of the relay wall: heights that are added to the mean wall `Scene.wall`.

    The slopes of these heights spread the mirror-like reflection of the wall. So that no slope is
    counted twice, the mirror-like lobes of `Scene.wall_material` must have slope zero or the rms
    slope of these heights; `Scene` checks this.

    Parameters
    ----------
    heights : FacetWall, GaussianWall or HeightMapWall
        Heights relative to the mean wall. Do not give them the argument ``size``; a height map
        must be at least as large as the wall.
    realisation : {"pattern", "mean"}
        "pattern": one rough surface, given by the seed or the height map. "mean": the average over
        all surfaces with the same statistics. Waves use the mean point spread function of these
        surfaces. Rays use the mean wall with a microfacet lobe of the same rms slope.

    Raises
    ------
    SceneError
        If a part has the wrong type, the heights have a size, or with the realisation "mean" the
        rms slope exceeds 0.7 rad.

    See Also
    --------
    Scene.with_relief : Scene in which the roughness is part of wall and material.

    Notes
    -----
    The microfacet lobe of "mean" has Gaussian slopes, also for a height map. It is a model of
    geometrical optics and valid if the heights exceed the wavelength.

    Examples
    --------
    >>> from nlosoptics.scene import FacetWall, WallRoughness
    >>> roughness = WallRoughness(FacetWall(1e-3, 2e-3, seed=1))
    >>> roughness.slope_rms, roughness.realisation
    (0.002, 'pattern')
    """

    heights: FacetWall | GaussianWall | HeightMapWall
    realisation: Literal["pattern", "mean"] = "pattern"

    def __post_init__(self) -> None:
        if not isinstance(self.heights, FacetWall | GaussianWall | HeightMapWall):
            raise SceneError(
                f"wall_roughness.heights is a {type(self.heights).__name__}; give a FacetWall, "
                "GaussianWall or HeightMapWall"
            )
        own = None
        if isinstance(self.heights, HeightMapWall):
            own = HeightMapWall(self.heights.heights, self.heights.pitch).size
        if self.heights.size != own:
            raise SceneError(
                f"wall_roughness.heights has the size {self.heights.size} m, but the wall's size "
                "limits it; leave out its size"
            )
        one_of("wall_roughness.realisation", self.realisation, ("pattern", "mean"))
        if self.realisation == "mean" and self.slope_rms > 0.0:
            in_range(
                "wall_roughness.slope_rms",
                self.slope_rms,
                0.0,
                0.7,
                unit="rad",
                remedy='use realisation = "pattern", or other slopes',
            )

    @property
    def slope_rms(self) -> float:
        """Rms slope along each axis, rad; for a height map the rms over its grid points."""
        return self.heights.slope_rms

    @property
    def steepest(self) -> float:
        """Largest slope to expect, rad: six times the rms, or the maximum of a height map."""
        if not isinstance(self.heights, HeightMapWall):
            return 6.0 * self.slope_rms
        return float(np.hypot(*self.heights.node_slopes()).max())

    def check_material(self, material: Material) -> None:
        """Check that no slope of the wall's mirror-like lobes is counted twice.

        Parameters
        ----------
        material : Material
            Material of the wall.

        Raises
        ------
        SceneError
            If a mirror-like lobe has a slope that is neither zero nor that of the roughness, or a
            GGX lobe has a slope.
        """
        slope = self.slope_rms
        for lobe in _mirrors(material):
            if lobe.slope_rms == 0.0:
                continue
            if getattr(lobe, "distribution", "") == "ggx":
                raise SceneError(
                    f"wall_material has a GGX lobe of slope_rms = {lobe.slope_rms:g} rad, but the "
                    "slopes of wall_roughness are Gaussian; give the lobe slope_rms = 0, or "
                    'distribution = "beckmann"'
                )
            if lobe.mirror_lobes and not _same(lobe.slope_rms, slope):
                raise SceneError(
                    f"wall_material has a mirror-like lobe of slope_rms = {lobe.slope_rms:.10g} "
                    f"rad, but wall_roughness carries its slope and has {slope:.10g} rad; give the "
                    "lobe the same slope_rms, or 0"
                )

    def check_wall(self, wall: Wall) -> None:
        """Check that the heights can be added to the mean wall.

        With the realisation "mean" nothing is added, and every wall is accepted.

        Parameters
        ----------
        wall : Wall
            Mean wall.

        Raises
        ------
        SceneError
            If the wall is a `CallableWall`, or a height map does not cover it.
        """
        if self.realisation == "mean":
            return
        if isinstance(wall, CallableWall):
            raise SceneError(
                "wall_roughness cannot be added to a CallableWall; sample its heights into a "
                'HeightMapWall, or use realisation = "mean"'
            )
        if not isinstance(self.heights, HeightMapWall):
            return
        covered = self.heights.size
        if wall.size is None or any(
            w > c * (1 + 1e-12) for w, c in zip(wall.size, covered, strict=True)
        ):
            has = "no size" if wall.size is None else f"the size {wall.size} m"
            raise SceneError(
                f"wall_roughness.heights covers {covered} m, but the wall has {has}; give more "
                "heights or a smaller wall"
            )

    def added_to(self, wall: Wall, material: Material) -> tuple[Wall, Material]:
        """Return a wall and a material that include the roughness.

        Parameters
        ----------
        wall : Wall
            Mean wall.
        material : Material
            Material of the wall.

        Returns
        -------
        wall : Wall
            For "pattern", the sum of mean wall and heights; for "mean", the mean wall.
        material : Material
            Material whose mirror-like lobes have slope zero for "pattern", and the rms slope of
            the roughness for "mean".
        """
        self.check_wall(wall)
        if self.realisation == "mean":
            return wall, self._relobed(material, self.slope_rms)
        return SumWall(wall, self.heights, size=wall.size), self._relobed(material, 0.0)

    def mean_lobe(self, lobe: MirrorLobe) -> MirrorLobe:
        """Return a lobe with the rms slope of the roughness: the mean over many such walls.

        Parameters
        ----------
        lobe : MirrorLobe
            Mirror-like lobe of the wall's material, of slope 0 or the slope of the roughness.
        """
        found = self._relobed(lobe, self.slope_rms)
        assert isinstance(found, MirrorLobe)
        return found

    def _relobed(self, material: Material, slope: float) -> Material:
        """Return a material whose lobes carried by the roughness have another slope."""
        if isinstance(material, SumMaterial):
            return SumMaterial(*(self._relobed(part, slope) for part in material.parts))
        # a lobe needs a slope of 1e-6 rad or more; rays do not tell less from a smooth mirror
        slope = 0.0 if slope < 1e-6 else slope
        if not isinstance(material, MirrorLobe) or _same(material.slope_rms, slope):
            return material
        if not (material.slope_rms == 0.0 or _same(material.slope_rms, self.slope_rms)):
            return material  # a rough lobe that forms no image
        if isinstance(material, SpecularMicrofacet):
            return replace(material, slope_rms=slope, distribution="beckmann")
        # a Ward lobe has no limit of slope zero of its own: it is a mirror of the same albedo
        return SpecularMicrofacet(material.spectrum or float(material.lobe_table()[0, 1]), slope)


def _mirrors(material: Material) -> Iterator[MirrorLobe]:
    """Yield the lobes about the mirror direction, of any slope."""
    for part in material.parts if isinstance(material, SumMaterial) else (material,):
        if isinstance(part, MirrorLobe):
            yield part


def _same(slope: float, other: float) -> bool:
    """Return whether two slopes are equal to within rounding."""
    return math.isclose(slope, other, rel_tol=1e-9)
