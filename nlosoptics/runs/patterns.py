"""Speckle patterns of a rough wall in a run: where they hold, and where the mean replaces them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..psf.pupil.exit_pupil import ExitPupil
from ..psf.pupil.scene_optics import PointOptics, SceneOptics
from ..psf.rough.relief import ReliefView
from ..psf.walls.rough_wall import roughness_view
from ..raytrace.intersection.meshes import threads
from ..scene import PlanarObject, Scene
from .stages import FIELD, MEAN, MOST_NODES, Look, Stage, field_stage, skipped, spread_cost

CHECKS = 6  # object points at which a field of patterns is compared with patterns computed there


def own_pattern(scene: Scene) -> bool:
    """Return whether the wall has a roughness whose own speckle pattern is wanted."""
    rough = scene.wall_roughness
    return rough is not None and rough.realisation == "pattern"


def uses_mean(scene: Scene, pattern_nodes: int) -> bool:
    """Return whether the image uses the mean over walls instead of this wall's own patterns."""
    return own_pattern(scene) and pattern_nodes == 0


def mean_optics(optics: SceneOptics) -> SceneOptics:
    """Return the optics of the same scene with the mean over all walls of its roughness."""
    rough = optics.scene.wall_roughness
    assert rough is not None
    scene = replace(optics.scene, wall_roughness=replace(rough, realisation="mean"))
    return SceneOptics(scene, optics.exit_pupil)


@dataclass(frozen=True)
class Pattern:
    """Change of a rough wall's speckle pattern over the picture."""

    nodes: int  # object points along each side at which it is computed; 0 if too many
    needed: int  # points that would resolve its change
    reach: float  # distance on the object at which its correlation has fallen to one half, m
    error: float  # expected difference of the images by the mean and by this wall, relative

    @classmethod
    def at(cls, look: Look, tol: float, seconds: float) -> Pattern:
        """Compare the shift of the pattern in the pupil with the pupil's diameter."""
        seen, scene = look.seen, look.seen.scene
        hidden = scene.hidden
        if not isinstance(hidden, PlanarObject) or not look.others:
            return cls(0, 0, math.nan, math.nan)
        wave, view = seen.first.wave, seen.view
        back = np.linalg.inv(view.footprint) @ view.tangents
        shifts = [
            float(np.linalg.norm(back @ (one.view.point - view.point))) for one in look.others
        ]
        far = [float(np.linalg.norm(one.object_point - seen.object_point)) for one in look.others]
        relative = max(shifts) / (2 * wave.pupil_radius)
        rate = max(s / d for s, d in zip(shifts, far, strict=True)) / (2 * wave.pupil_radius)
        # shifted by this part of the pupil's diameter, intensities have the correlation 1/2
        reach = 0.231 / rate
        # a shift of at most 0.12 pupil diameters between two points
        needed = max(1, math.ceil(math.pi * relative / 0.12))
        one = spread_cost(scene, look, look.field_side, tol / 2)
        fits = needed <= MOST_NODES and (needed**2 + CHECKS) * one.seconds <= seconds / 2
        return cls(needed if fits else 0, needed, reach, _mean_error(seen, hidden))


def _mean_error(seen: PointOptics, hidden: PlanarObject) -> float:
    """Estimate the rms difference of the images by one wall and by the mean, over the image's rms.

    Seen from a pixel, each of the N facets within the lens's patch of the wall shows a point of the
    picture, at random within the blur. The variance of their mean is that of the picture within the
    blur, over N.
    """
    from scipy import ndimage

    scene, wave, view = seen.scene, seen.first.wave, roughness_view(seen, pattern=True)
    assert isinstance(view, ReliefView)
    patch = math.pi * wave.pupil_radius**2 * abs(float(np.linalg.det(view.footprint)))
    picture = np.asarray(hidden.reflectance, dtype=np.float64)
    sides = np.array(hidden.size[::-1]) / picture.shape
    blur = view.halo(wave) / 3 * scene.focus_distance / abs(wave.image_distance) / sides
    mean = ndimage.gaussian_filter(picture, blur, mode="constant")
    square = ndimage.gaussian_filter(picture**2, blur, mode="constant")
    varied = float(np.mean(np.maximum(square - mean**2, 0.0)))
    facets = max(1.0, patch / view.length**2)
    return math.sqrt(varied / facets / max(float(np.mean(mean**2)), 1e-300))


def image_spread_stages(
    pupil: ExitPupil, look: Look, imaged: Look, pattern: Pattern | None, tol: float
) -> Iterator[Stage]:
    """Yield the stages that compute the point spreads of the image."""
    scene = look.seen.scene
    if pattern is None:
        yield field_stage(scene, pupil, look, tol)
        return
    if pattern.nodes == 1:
        yield skipped(FIELD, "one pattern holds over the whole picture")
        return
    within = f"the wall's pattern holds within {1e3 * pattern.reach:.2g} mm of the object"
    if pattern.nodes:
        one = spread_cost(scene, look, look.field_side, tol / 2)
        n = pattern.nodes
        yield Stage(
            name=FIELD,
            runs=True,
            reason=f"{within}; {n} x {n} patterns, {look.field_side} x {look.field_side} pixels",
            seconds=(n * n + CHECKS) * one.seconds,
            error="that of interpolated patterns is measured",
            memory=40.0 * n * n * look.field_side**2 + one.n_bytes * threads(),
        )
        return
    why = "the object is a mesh"
    if isinstance(scene.hidden, PlanarObject):  # no waves of other object points are compared
        why = "the wall's edge cuts off a part of the cone of light"
    if pattern.needed:
        why = f"{within}, so that {pattern.needed} x {pattern.needed} patterns would be needed"
    cost = spread_cost(imaged.seen.scene, imaged, imaged.side, tol)
    yield Stage(
        name=MEAN,
        runs=True,
        reason=f"the image uses the mean over all walls of this roughness: {why}",
        seconds=cost.seconds,
        error=f"this wall's image differs by about {100 * pattern.error:.1g} % of its rms"
        if pattern.needed
        else "",
        memory=cost.n_bytes,
    )
    yield field_stage(imaged.seen.scene, pupil, imaged, tol)
