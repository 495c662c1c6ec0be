"""Speckle patterns of a rough wall in a run: where they hold, and where the mean replaces them.

A burst has another pattern in each exposure; the number of exposures that it needs is planned here.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import SamplingError
from ..imaging.images import mirror_image
from ..psf.pupil.exit_pupil import ExitPupil, exit_pupil
from ..psf.pupil.scene_optics import PointOptics, SceneOptics
from ..psf.rough.relief import ReliefView
from ..psf.walls.rough_wall import roughness_view
from ..raytrace.intersection.meshes import threads
from ..scene import PlanarObject, Scene
from .refusals import check_sight
from .stages import FIELD, MEAN, MOST_NODES, Look, Stage, field_stage, skipped, spread_cost

Array = NDArray[np.float64]

BURST = "burst"  # name of the stage
ENOUGH = 0.9  # correlation with the object for which a plan states the number of exposures
PHASED = 8  # least exposures from which phases are found; with 4 a bright letter was not
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
    scene = replace(optics.scene, wall_roughness=replace(rough, realisation="mean"), burst=None)
    return SceneOptics(scene, optics.exit_pupil)


@dataclass(frozen=True)
class Pattern:
    """Change of a rough wall's speckle pattern over the picture."""

    nodes: int  # object points along each side at which it is computed; 0 if too many
    needed: int  # points that would resolve its change
    reach: float  # distance on the object at which its correlation has fallen to one half, m
    error: float  # expected difference of the images by the mean and by this wall, relative; NaN
    # if the mean is not used

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
        error = math.nan if fits else _mean_error(seen, hidden)
        return cls(needed if fits else 0, needed, reach, error)


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


def burst_stages(
    scene: Scene, look: Look, pattern: Pattern | None, tol: float, seconds: float
) -> Iterator[Stage]:
    """Yield the stage of the exposures after the first, whose images take ``seconds`` each."""
    burst = scene.burst
    if burst is None:
        return
    if pattern is None or not pattern.nodes:
        held = (
            "is not known (a mesh, no mirror-like lobe, or the wall's edge cuts the cone of light)"
        )
        if pattern is not None and pattern.needed:
            held = f"holds within {1e3 * pattern.reach:.2g} mm"
        raise SamplingError(
            f"burst: a fit needs a pattern that holds over the object, and this wall's {held}; "
            "use a smaller hidden.size, a wider camera.stop_diameter or a larger max_seconds"
        )
    for exposure in scene.exposures:
        check_sight(exposure, exit_pupil(exposure))
    one = spread_cost(scene, look, look.field_side if pattern.nodes > 1 else look.side, tol)
    power, error, share = power_errors(scene, look)
    independent = burst.independent(scene.camera.stop_diameter)
    count = 1 + bisect_left(
        range(1, 1000), ENOUGH, key=lambda n: fitted_correlation(power, error, n / share)
    )
    needed = max(PHASED, math.ceil(count * burst.images / independent))
    correlation = fitted_correlation(power, error, independent / share)
    yield Stage(
        name=BURST,
        runs=True,
        reason=f"{burst.images} exposures through other parts of the wall, as good as "
        f"{independent:.3g} independent ones; a correlation of {ENOUGH} takes "
        f"{f'at least {needed}' if count < 1000 else 'more light'}",
        seconds=(burst.images - 1) * (pattern.nodes**2 * one.seconds + seconds),
        error=f"correlation {correlation:.3f} if the phases are found",
        memory=8.0 * burst.images * math.prod(scene.camera.shape),
    )


def power_errors(scene: Scene, look: Look) -> tuple[Array, Array, float]:
    """Return an object's power spectrum, the relative error of its estimate, and a share.

    The first two are of the camera's pixels and one exposure, (ny, nx), electrons^2 and 1. The
    share is that of the frame's area in which the object lies. As many of the frequencies determine
    its spectrum, so that the variance of a fit is smaller by this factor.

    An exposure has the spectrum ``Y = O H + n``. With developed speckle, Y is a complex Gaussian
    variable whose mean power is ``S + N``, where ``S = |O|^2 T``, ``T = <|H|^2>`` and N is the
    power of the noise (all electrons and readouts of the frame). Its power then varies by its mean,
    so that the estimate ``(<|Y|^2> - N)/T`` of |O|^2 from K exposures has the relative error
    ``(1 + N/S)/sqrt(K)``.

    For a pattern with a Gaussian envelope of rms radius s (geometric mean of both axes) and n
    speckles, ``T = exp(-(2 pi s f)^2) + T_0/n`` with the transfer function T_0 of the lens: the
    squared mean transfer function, and the power of the speckle. A speckle has the area
    ``4 (lambda N)^2/pi``, hence ``n = pi^2 (s/(lambda N))^2``. Pixels multiply T by the square of
    their own transfer function.
    """
    camera, wave = scene.camera, look.seen.first.wave
    ideal = mirror_image(scene)[1]
    power = np.abs(np.fft.fft2(ideal)) ** 2
    fy, fx = np.meshgrid(
        *(np.fft.fftfreq(n, camera.image_pitch) for n in ideal.shape), indexing="ij"
    )
    unit = wave.wavelength * wave.f_number
    view = roughness_view(look.seen, pattern=True)
    oblong = abs(np.linalg.det(view.footprint)) / np.linalg.norm(view.footprint, 2) ** 2
    radius = math.sqrt(oblong) * view.halo(wave) / 3
    squared = fx**2 + fy**2
    t = np.minimum(unit * np.sqrt(squared), 1.0)
    lens = 2.0 / math.pi * (np.arccos(t) - t * np.sqrt(1.0 - t * t))
    transfer = np.exp(-((2.0 * math.pi * radius) ** 2) * squared)
    transfer += lens / (1.0 + (math.pi * radius / unit) ** 2)
    transfer *= (np.sinc(fx * camera.image_pitch) * np.sinc(fy * camera.image_pitch)) ** 2
    noise = ideal.sum() + ideal.size * (camera.binning * camera.read_noise) ** 2
    signal = np.maximum(power * transfer, 1e-30 * power[0, 0])
    sides = [np.ptp(np.flatnonzero(ideal.any(axis=axis))) + 1 for axis in (0, 1)]
    return power, 1.0 + noise / signal, math.prod(sides) / ideal.size


def fitted_correlation(power: Array, error: Array, count: float) -> float:
    """Return the correlation with the object that ``count`` independent exposures allow.

    Half the relative error e of the power spectrum is that of the modulus. Phases found from the
    modulus err as much, so that the spectrum's relative variance is ``v = e^2/(2 count)``. Weighted
    by ``1/(1 + v)``, as in a Wiener filter, it has the correlation c with the true spectrum P:
    ``c^2 = sum P/(1 + v) / sum P``, without the mean.
    """
    weight = power.copy()
    weight[0, 0] = 0.0
    return math.sqrt(float(np.sum(weight / (1.0 + error**2 / (2.0 * count))) / weight.sum()))
