"""Stages of a run: which a scene needs, with their predicted time, memory and error."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .._checks import counted
from ..errors import SamplingError
from ..imaging.image_fields import (
    CHECKED,
    COUNTS,
    expected_counts,
    interpolation_errors,
    picture_frame,
)
from ..imaging.images import BYTES_PER_PIXEL as IMAGE_BYTES
from ..imaging.objects import object_patches, plate
from ..imaging.radiometry import background_work, has_highlight
from ..imaging.shadows import SHADOW_BYTES
from ..psf.pupil.exit_pupil import ExitPupil
from ..psf.pupil.obstruction import check_cone
from ..psf.pupil.paraxial import change_over_object
from ..psf.pupil.scene_optics import PointOptics, SceneOptics
from ..psf.transform.models import predicted_model_error, wide_pixel_error
from ..psf.walls.field import picture_point
from ..psf.walls.rough_wall import Cost
from ..psf.walls.scene_costs import grid_samples
from ..psf.walls.scene_psf import point_window, wall_image
from ..raytrace import ray_plan
from ..raytrace.intersection.meshes import threads
from ..scene import MeshWall, PlanarObject, Scene
from .refusals import check_cones, overexposure, wall_pixels

FIELD = "field of point spreads"  # name of the stage
MEAN = "mean point spread"  # name of the stage
MOST_NODES = 27  # most nodes along each side of a field of point spreads


CELLS, BINS = 32, 64  # cells of the object and bins of the image, along the longer side


def is_matt(scene: Scene) -> bool:
    """Return whether the wall forms no image, so that only shadows show the object."""
    return scene.wall_material.specular_reflectance == 0.0


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One step of a plan."""

    name: str  # such as "point spread"
    runs: bool  # whether `simulate` carries it out
    reason: str  # why it runs or is skipped
    seconds: float = 0.0  # predicted, on one core of a machine of 2024, without compilation, s
    error: str = ""  # predicted error and the quantity that it refers to
    memory: float = 0.0  # predicted peak that the stage itself allocates, bytes
    nodes: int = 0  # most object points along each side of a field of point spreads


@dataclass(frozen=True, eq=False)
class Look:
    """Waves at a few object points and the window sizes of their point spreads."""

    seen: PointOptics  # at the object's reference point
    others: tuple[PointOptics, ...]  # at the picture's corners and edges; empty if never needed
    side: int  # of the point spread's window at the centre, pixels
    field_side: int  # of the largest window over the whole picture, pixels
    samples: tuple[int, ...]  # cells across the pupil grids tried in turn; empty for polar nodes

    @classmethod
    def at(cls, optics: SceneOptics, tol: float) -> Look:
        """Compute the waves; raises the same errors as the run if a wave is undefined."""
        scene, seen = optics.scene, optics.reference
        pitch = scene.camera.image_pitch
        side = point_window(seen, pitch, tol)
        if not seen.first.residual.has_series:
            samples = grid_samples(seen.first.residual, pitch, side, tol)
            return cls(seen, (), side, side, samples)
        others: tuple[PointOptics, ...] = ()
        if isinstance(scene.hidden, PlanarObject) and scene.wall_material.mirror_lobes:
            places = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if x or y]
            others = tuple(optics.at(picture_point(scene.hidden, x, y)) for x, y in places)
        sides = (point_window(one, pitch, tol / 2) for one in others)
        return cls(seen, others, side, max(sides, default=side), ())

    @property
    def change(self) -> tuple[float, float]:
        """Estimated image error with a single point spread (rms over rms), and wave change, rad.

        The wave change is the largest peak-to-valley difference between the waves at the picture's
        corners and edges and the wave at its centre, less where pixels are wide. The error
        estimate was fitted to random scenes and is good to a factor of about three. Its terms are
        the wave change and the change of the lobe's blur if that is larger than a pixel.
        """
        scene, first = self.seen.scene, self.seen.first.residual
        unit, pitch = first.airy_unit, scene.camera.image_pitch
        own = self.seen.first.wave
        rough = max(scene.mirror_slopes)
        swing = turned = 0.0
        for one in self.others:
            other = one.first.residual
            if other.aberration.shape == first.aberration.shape:
                change = other.aberration - first.aberration
                swing = max(swing, first.wavenumber * float(np.ptp(change)))
            if rough > 0:
                turns = [v.cos_sum * v.footprint for v in (self.seen.view, one.view)]
                off = float(np.linalg.norm(turns[1] - turns[0]) / np.linalg.norm(turns[0]))
                turned = max(turned, off)
        blurred = 1.0 + first.rays.reach / unit
        # a pixel n lambda N wide resolves phase differences across about 1/n of the pupil
        swing /= max(1.0, pitch / (4 * unit))
        waves = 2e-3 * swing * min(blurred, 4.0)
        if rough > 0:
            turn = self.seen.view.cos_sum * float(np.linalg.norm(self.seen.view.footprint, 2))
            halo = rough * turn * abs(own.image_distance) / pitch
            waves += 0.2 * turned * min(1.0, (halo / 2) ** 4)
        return min(0.3, waves), swing

    @property
    def cut(self) -> float:
        """Fraction of the corner and edge points whose cone of light the wall's edge cuts."""
        grids = [not one.first.residual.has_series for one in self.others]
        return sum(grids) / len(grids) if grids else 0.0


def skipped(name: str, reason: str) -> Stage:
    """Return a stage that is left out, with the reason."""
    return Stage(name=name, runs=False, reason=reason)


def mesh_stage(scene: Scene) -> Stage:
    """Return the stage that fits a smooth surface through a mesh wall."""
    if not isinstance(scene.wall, MeshWall):
        return skipped("mesh surface", "the wall is analytic")
    return Stage(
        name="mesh surface",
        runs=True,
        reason="smooth bicubic surface through the mesh, fitted during planning",
        seconds=0.001,
        error=f"{1e9 * scene.wall.fit_residual:.2g} nm; "
        f"the triangles {1e9 * scene.wall.mesh_error:.2g} nm",
    )


def wave_stages(scene: Scene, pupil: ExitPupil, look: Look, waves: float) -> Iterator[Stage]:
    """Yield the stages of aiming and of the wave aberration."""
    flat = scene.wall.is_flat
    if flat:
        yield skipped("aiming", "flat wall: hits in closed form")
    reason = "zero except defocus" if flat else f"rays aimed by Newton; {waves:.2g} waves"
    nodes = float(look.seen.first.wave.u.size)
    if look.samples:
        cut = "the wall's outline is the stop"
        if pupil.stop == "lens":
            cut = f"the wall's edge cuts {100 * pupil.vignetting:.2g} % of the cone"
        reason += f"; on a grid, because {cut}"
        nodes = float(sum(n**2 for n in look.samples))
    yield Stage(
        name="wave aberration",
        runs=True,
        reason=reason,
        seconds=(1 + len(look.others)) * _aiming_seconds(scene, nodes),
        error="the mesh surface's" if isinstance(scene.wall, MeshWall) else "1e-9 wave",
        memory=400.0 * max((*look.samples, 48)) ** 2,
    )


def _aiming_seconds(scene: Scene, nodes: float) -> float:
    """Predicted seconds of aiming a wave at ``nodes`` pupil nodes."""
    return 2e-3 + nodes * (1e-6 if scene.wall.is_flat else 3e-6 if scene.wall.is_compiled else 1e-5)


def spread_cost(scene: Scene, look: Look, side: int, tol: float) -> Cost:
    """Predicted cost of one point spread, including the coarser grids that are tried first."""
    way = wall_image(look.seen, scene.camera.image_pitch, (side, side), tol)
    found = [way.cost(n) for n in look.samples or (0,)]
    return Cost(sum(c.seconds for c in found), found[-1].n_bytes)


def point_seconds(scene: Scene, tol: float) -> float:
    """Predicted seconds of the wave and the point spread of the object's reference point."""
    look = Look.at(SceneOptics(scene), tol)
    aiming = _aiming_seconds(scene, look.seen.first.wave.u.size)
    return aiming + spread_cost(scene, look, look.side, tol).seconds


def model_error(scene: Scene, look: Look) -> float:
    """Predict the error of scalar diffraction, relative to the peak of the point spread."""
    residual = look.seen.first.residual
    if scene.wall_roughness is not None or any(slope > 0 for slope in scene.mirror_slopes):
        return wide_pixel_error(residual)
    return predicted_model_error(residual, scene.camera.image_pitch)


def point_spread_stage(scene: Scene, pupil: ExitPupil, look: Look, tol: float) -> Stage:
    """Return the stage of the point spread at the object's centre."""
    core, pitch = scene.laser.wavelength * pupil.f_number, scene.camera.image_pitch
    slope = max(scene.mirror_slopes, default=0.0)
    blur = f", blurred by the lobe's slopes of {slope:g} rad" if slope > 0 else ""
    if scene.wall_roughness is not None:
        blur = f"; {wall_image(look.seen, pitch, (look.side, look.side), tol).reason}"
    cost, error = spread_cost(scene, look, look.side, tol), f"{tol:g} of the peak"
    model = model_error(scene, look)
    if model > tol:
        error += f", scalar model {model:.1g}"
        blur += "; the scalar model errs by more than tol: stop the lens down, use a larger tol"
        if scene.wall_roughness is None and slope == 0:
            blur += ", or compare psf.scene_point_spread(scene, model='auto')"
    return Stage(
        name="point spread",
        runs=True,
        reason=f"at the object's centre, {look.side} x {look.side} pixels; a pixel is "
        f"{pitch / core:.3g} lambda N wide{blur}",
        seconds=cost.seconds,
        error=error,
        memory=cost.n_bytes,
    )


def field_stage(scene: Scene, pupil: ExitPupil, look: Look, tol: float) -> Stage:
    """Decide whether point spreads at several object points are needed, and estimate how many."""
    if not isinstance(scene.hidden, PlanarObject):
        return skipped(FIELD, "one point spread is used for the whole mesh; positions are exact")
    if not scene.wall_material.mirror_lobes:
        return skipped(FIELD, "a wall without a mirror-like lobe forms no image")
    if look.samples:
        return skipped(
            FIELD, "one point spread, on a grid, is used for the object; positions are exact"
        )
    change = change_over_object(scene, pupil)
    if change <= tol:
        return skipped(
            FIELD, f"one point spread is enough: it changes over the object by {change:.1g} at most"
        )
    error, swing = look.change
    decay = interpolation_errors(scene)
    # the error estimate is uncertain by a factor of 3 either way; take the geometric mean
    found = [expected_counts(doubt * error, swing, tol, decay) for doubt in (1 / 3, 1.0, 3.0)]
    ends = [counts for counts, _ in found]
    # a fast change of phase may average out within wide pixels; that of the curvature does not
    left = expected_counts(error, 0.0, tol, decay)[1]
    if left > tol:
        wider = f"use tol = {1.1 * left:.2g}, or" if 1.1 * left < 0.1 else "use"
        raise SamplingError(
            f"the wall's shape changes too fast over the picture: with {COUNTS[-1]} x "
            f"{COUNTS[-1]} point spreads its image would still have an error of about {left:.2g} "
            f"of its rms, limit tol = {tol:g}; {wider} a smaller picture"
        )
    spreads = math.prod(float(sum(n**2 for n in counts)) for counts in ends) ** (1 / 3)
    spreads += CHECKED**2
    waves = spreads + 5  # those of the corners and of the centre determine the window
    counts = ends[-1]
    check_cones(scene, counts)
    one = spread_cost(scene, look, look.field_side, tol / 2)
    each = one.seconds + 0.9 * look.cut  # s of a wave on a grid and its point spread
    aimed = _aiming_seconds(scene, look.seen.first.wave.u.size)
    area = look.field_side**2
    held = (40.0 * counts[-1] ** 2 + 24.0 * CHECKED**2) * area
    # the picture's autocorrelation, and a point spread's
    compared = 80.0 * picture_frame(scene).size + 200.0 * area
    powers = 1.5e-7 * area * CHECKED**2 * (1 + len(ends[1]))
    return Stage(
        name=FIELD,
        runs=True,
        reason=f"point spreads change over the object; about {ends[1][-1]} x {ends[1][-1]} of "
        f"them, {look.field_side} x {look.field_side} pixels",
        seconds=spreads * each + waves * aimed + powers + 2e-8 * area * counts[-1] ** 4,
        error=f"{tol:g} of the image, rms",
        memory=held + compared + one.n_bytes * threads(),
        nodes=counts[-1],
    )


def left_out(scene: Scene) -> Iterator[Stage]:
    """Yield the effects that `simulate` does not compute for this scene."""
    yield skipped(
        "interreflection",
        "wall-to-wall light is not part of the image; nlosoptics trace (raytrace.trace) computes it"
        if ray_plan(scene).wall_to_wall
        else "no part of the wall sees another",
    )
    if not ray_plan(scene).embree:
        yield skipped("embree", "no triangles: the object is a flat picture, without occluders")


def shadow_stage(scene: Scene) -> Stage:
    """Return the stage of the shadow rays."""
    if not scene.occluders:
        return skipped("shadow rays", "no occluders")
    count = len(scene.occluders)
    reason = f"{counted(count, 'occluder')} between spot, object, wall and lens"
    if not is_matt(scene) and check_cone(scene):
        reason += "; the object's reference point is hidden"
    ny, nx = scene.camera.shape
    plain = is_matt(scene) and scene.wall.is_flat
    return Stage(
        name="shadow rays",
        runs=True,
        reason=reason,
        seconds=0.02 + 1e-5 * nx * ny if plain else 0.1 + 4e-5 * nx * ny,
        error="1e-3 of the diffuse light; some hundredths at edges in the image",
        memory=SHADOW_BYTES * nx * ny,
    )


def image_stage(scene: Scene) -> Stage:
    """Return the stage of the camera image."""
    camera = scene.camera
    ny, nx = camera.shape
    reason = f"{nx} x {ny} pixels by reverse chief rays"
    if (n := camera.binning) > 1:
        across, up = camera.pixels
        reason += f"; each sums {n} x {n} of the sensor's {across} x {up} (camera.binning = {n})"
    if scene.wall_material.specular_reflectance == 0:
        reason += "; background only, because the wall has no mirror-like lobe"
    return Stage(
        name="image",
        runs=True,
        reason=reason,
        seconds=_image_seconds(scene),
        error="1e-3 of the background",
        memory=IMAGE_BYTES * nx * ny
        + 6e7,  # the latter for diffuse transport from a block of patches,
    )


def _image_seconds(scene: Scene) -> float:
    """Predicted seconds of `form_image`: diffuse transport from the object patches, and pixels."""
    pixels = float(math.prod(scene.camera.shape))
    pairs, groups = background_work(scene, object_patches(scene.hidden))
    if scene.wall.is_flat:
        return 0.004 + 2e-7 * pairs + 5e-7 * pixels
    return 0.016 + 2.2e-4 * groups + 1.4e-7 * pairs + 2.4e-7 * groups * pixels + 1.6e-6 * pixels


def _deconvolution_seconds(scene: Scene) -> float:
    """Predicted seconds of a fit that detects an object; one that detects none ends sooner.

    The number of iterations is not known before: it is 40 to 700, fewer for large images.
    """
    pixels = float(math.prod(scene.camera.shape))
    fit = 4e-5 * pixels / (1.0 + pixels / 2e4) + 4e-6 * pixels
    # the veil of many parts of the object
    lit = not isinstance(scene.hidden, PlanarObject) or has_highlight(scene)
    return 0.15 + fit + (0.2 if lit else 0.0)


def joined_pixels(scene: Scene) -> int:
    """Return how many pixels along each side are added up for a picture from shadows."""
    shape = scene.camera.shape
    most = max(1, -(-max(shape) // BINS))
    return next(k for k in range(most, 0, -1) if math.gcd(k, *shape) == k)


def shadow_cells(scene: Scene) -> tuple[int, int]:
    """Return rows and columns of the object's cells in a picture from shadows."""
    size = plate(scene)[2]
    columns, rows = (max(1, round(CELLS * side / max(size))) for side in size)
    return rows, columns


def reconstruction_stage(scene: Scene, wanted: bool, nodes: int = 0) -> Stage:
    """Return the stage of the reconstruction, with ``nodes`` of patterns along the object."""
    if not wanted:
        return skipped("reconstruction", "not requested")
    if full := overexposure(scene):
        return skipped("reconstruction", full)
    ny, nx = scene.camera.shape
    if is_matt(scene):
        if not scene.occluders:
            return skipped(
                "reconstruction",
                "a wall without a mirror-like lobe shows detail by shadows only",
            )
        k = joined_pixels(scene)
        seen = wall_pixels(scene, traced=False).reshape(ny // k, k, nx // k, k).all(axis=(1, 3))
        if (count := np.count_nonzero(seen)) < 64:  # those that `shadow_fit` needs
            return skipped(
                "reconstruction",
                f"{count} squares of {k} x {k} pixels see the wall with their whole cone of light, "
                "limit 64; aim the camera at the wall, or enlarge the wall",
            )
        cells, bins = shadow_cells(scene), ny // k * (nx // k)
        unknowns, faces = math.prod(cells), 0
        if scene.occluding_mesh is not None:
            faces = len(scene.occluding_mesh.faces)
        # eigenvectors of the cells and products with the operator; its lattice is finer at edges
        return Stage(
            name="reconstruction",
            runs=True,
            reason="total-variation fit of the shadows, with known occluders",
            seconds=4.2e-10 * unknowns**3
            + 7e-8 * unknowns * bins
            + (0.4 + 7e-3 * faces + 1.5e-4 * bins),
            memory=8.0 * 6 * CELLS**2 * max(CELLS**2, BINS**2),
            error="status and score are reported",
        )
    if scene.burst is not None:
        return Stage(
            name="reconstruction",
            runs=True,
            reason="phase retrieval from the mean power of the exposures",
            seconds=2e-3 * nx * ny,
            memory=2000.0 * nx * ny + 100.0 * scene.burst.images * nx * ny,
            error="status and score are reported",
        )
    return Stage(
        name="reconstruction",
        runs=True,
        reason="total-variation deconvolution with known pose and point spread",
        seconds=_deconvolution_seconds(scene) * (2.5 if nodes > 1 else 1.0),
        memory=2000.0 * nx * ny,
        error="status and score are reported",
    )
