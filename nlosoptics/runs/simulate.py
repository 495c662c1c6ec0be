"""Simulation of a scene: runs the stages of its plan."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._checks import within
from .._progress import Progress
from .._random import checked_seed, generator
from ..errors import NlosError, SceneError, ValidityWarning
from ..imaging.detector import full_reading
from ..scene import MeshWall, PlanarObject, Scene
from .noise import electron_noise
from .patterns import BURST, CHECKS, mean_optics, uses_mean
from .plan import MOST_SECONDS, Plan, looked_at
from .refusals import check_errors, fillable, wall_pixels
from .results import Result
from .stages import FIELD, MEAN, MOST_NODES, joined_pixels, shadow_cells
from .veil import fitted_veil

if TYPE_CHECKING:
    from ..imaging import ForwardModel, Shadows, SpeckleImage
    from ..inverse import Reconstruction
    from ..psf import PointSpread, PointSpreadField, SceneOptics

Array = NDArray[np.float64]
_log = logging.getLogger(__name__)

OUTSIDE: Final = 0.25  # energy of a point spread outside its window, relative to the tolerance
#: Deviation of the point spreads from their mean up to which a reconstruction uses the mean.
MOST_DEVIATION: Final = 0.05


def simulate(
    scene: Scene,
    tol: float = 1e-3,
    seed: int = 0,
    reconstruct: bool = False,
    *,
    memory: float | None = None,
    max_seconds: float = MOST_SECONDS,
    progress: Progress | None = None,
) -> Result:
    """Simulate the camera image of a scene: exit pupil, wave aberration, PSF and image with noise.

    It runs the stages that `plan` selects. The logger "nlosoptics" tells the seconds of each at the
    level DEBUG.

    Parameters
    ----------
    scene, tol, memory, max_seconds
        Scene, tolerance and limits, as for `plan`.
    seed : int, default 0
        Seed of the random numbers, 0 to 2^64 - 1. The same seed gives the same results bit for bit.
    reconstruct : bool, default False
        Whether to reconstruct the object from the image as well, with known PSF.
    progress : callable(str, float), optional
        Function that is called with the name of the current stage and the completed fraction of the
        run, 0 to 1.

    Returns
    -------
    Result
        Exit pupil, wave, PSF, image and, if requested, the reconstructed object.

    Raises
    ------
    NlosError
        If the scene cannot be simulated. The subclass depends on the cause; see `plan`,
        `psf.scene_point_spread` and `imaging.form_image`.

    See Also
    --------
    plan : Predict stages, time, memory and error without running them.
    load_result : Read a saved result.

    Examples
    --------
    >>> from nlosoptics import Scene, simulate
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(32)
    >>> result = simulate(scene, tol=1e-2, seed=0)
    >>> result.image.electrons.shape, round(result.exit_pupil.f_number, 3)
    ((32, 32), 2.077)
    """
    seed = checked_seed(seed)
    todo, optics = looked_at(scene, tol, reconstruct, memory, max_seconds)
    return carried_out(todo, scene, optics, seed, progress)


def carried_out(
    todo: Plan,
    scene: Scene,
    optics: SceneOptics | None,
    seed: int,
    progress: Progress | None = None,
) -> Result:
    """Run a plan within its budget; ``optics`` are the waves computed for it by `looked_at`."""
    with within(todo.budget):
        return _stages(todo, scene, optics, seed, progress)


def _stages(
    todo: Plan, scene: Scene, optics: SceneOptics | None, seed: int, progress: Progress | None
) -> Result:
    """Run the stages of a plan in order."""
    tol = todo.tol
    from .. import imaging, inverse, psf

    begun: dict[str, float] = {}  # start of each stage, s
    total = todo.seconds

    def tell(name: str, share: float) -> None:
        """Report that a fraction ``share`` of stage ``name`` is done."""
        if progress is not None:
            done = sum(s.seconds for s in todo.stages if s.name in begun and s.name != name)
            done += share * sum(s.seconds for s in todo.stages if s.name == name)
            progress(name, min(1.0, done / total))

    def begin(name: str, share: float = 0.0) -> None:
        """Record the start of a stage, which is also the end of the previous one."""
        log()
        begun[name] = time.perf_counter()
        tell(name, share)

    def log() -> None:
        """Log the seconds of the stage that ends."""
        if name := next(reversed(begun), ""):
            _log.debug("%s: %.2f s", name, time.perf_counter() - begun[name])

    formed: psf.ScenePointSpread | None = None
    spread: PointSpread | None = None
    spreads: PointSpreadField | PointSpread | None = None
    shadows: Shadows | None = None
    errors: dict[str, float] = {}
    if optics is not None:
        if isinstance(scene.wall, MeshWall):
            begin("mesh surface")
            scene.wall.fit_residual  # noqa: B018  (fits and caches the surface)
        begin("exit pupil")
        formed = psf.scene_point_spread(optics, tol, progress=begin)
        spread = formed.point_spread
        errors = {"point spread": spread.error_estimate}
        spreads, field_errors = image_spreads(todo, optics, spread, seed, begin, tell)
        check_errors({} if scene.wall_roughness else errors, tol)  # rough walls plan other errors
        errors |= field_errors
    if todo.runs("shadow rays"):
        begin("shadow rays")
        shadows = imaging.cast_shadows(scene)
    begin("image")
    image = _image(todo, scene, spreads, seed, shadows)
    burst = None
    if todo.runs(BURST):
        begin(BURST)
        burst = _burst(todo, scene, image, seed, lambda share: tell(BURST, share))
    reconstruction = None
    if todo.runs("reconstruction") and fillable(scene, image.electrons):
        begin("reconstruction")
        try:
            if spreads is None:
                reconstruction = _from_shadows(scene, image)
            elif burst is None:
                reconstruction = _reconstruct(scene, image, spreads, shadows)
            elif spread is not None:
                reconstruction = inverse.burst_fit(burst, spread, seed=seed)
        except NlosError as refusal:  # the run keeps its image
            text = f"no object is reconstructed: {refusal}"
            warnings.warn(text, ValidityWarning, stacklevel=4)
    log()
    ends = [*list(begun.values())[1:], time.perf_counter()]
    if progress is not None:
        progress("done", 1.0)
    timings = {name: end - begun[name] for name, end in zip(begun, ends, strict=True)}
    return Result(
        scene=scene,
        plan=todo,
        exit_pupil=None if formed is None else formed.exit_pupil,
        wavefront=None if formed is None else formed.wavefront,
        point_spread=spread,
        field=spreads if isinstance(spreads, psf.PointSpreadField) else None,
        pupil_field=None if formed is None else formed.pupil_field,
        image=image,
        burst=burst,
        reconstruction=reconstruction,
        errors=errors,
        timings=timings,
        seed=seed,
    )


def _image(
    todo: Plan,
    scene: Scene,
    spreads: PointSpreadField | PointSpread | None,
    seed: int,
    shadows: Shadows | None = None,
) -> SpeckleImage:
    """Return the camera image by the point spreads of `image_spreads`, None for a matt wall."""
    from .. import imaging, psf

    if spreads is None:
        return imaging.form_image(scene, None, seed=seed, shadows=shadows)
    wide = psf.widened(spreads, tol=todo.tol * OUTSIDE, shape=scene.camera.shape)
    return imaging.form_image(scene, wide, seed=seed, shadows=shadows)


def _burst(
    todo: Plan, scene: Scene, first: SpeckleImage, seed: int, tell: Callable[[float], None]
) -> Array:
    """Return the readings (images, ny, nx), electrons, of a burst that begins with ``first``.

    The random heights of the wall depend on the place only, so that all exposures see one wall.
    Each exposure has noise of its own, whose seed follows from ``seed``.
    """
    from .. import psf

    scenes = scene.exposures
    seeds = generator(seed, 901).integers(2**63, size=len(scenes))
    readings = [first.electrons]
    for k, exposure in enumerate(scenes[1:], 1):
        tell(k / len(scenes))
        optics = psf.SceneOptics(exposure, psf.exit_pupil(exposure))
        spreads, _ = image_spreads(todo, optics, checks=0)
        readings.append(_image(todo, exposure, spreads, int(seeds[k])).electrons)
    return np.stack(readings)


def image_spreads(
    todo: Plan,
    optics: SceneOptics,
    spread: PointSpread | None = None,
    seed: int = 0,
    begin: Callable[[str], None] = lambda _: None,
    tell: Callable[[str, float], None] = lambda _, share: None,
    *,
    anywhere: bool = False,
    checks: int = CHECKS,
) -> tuple[PointSpreadField | PointSpread, dict[str, float]]:
    """Compute the point spreads with which a plan forms the image, and their estimated errors.

    The result is a field over the object, or a single point spread that suffices: ``spread`` at the
    reference point, which is computed if needed, or the mean over all walls of a roughness.
    ``begin`` is called at the start of each stage, and ``tell`` with its name and completed
    fraction. If ``anywhere``, the object may differ from the scene's picture, see
    `imaging.image_field`. Patterns are checked at ``checks`` points of the object.
    """
    from .. import imaging, psf

    nodes = todo.pattern_nodes
    if nodes > 1:
        begin(FIELD)
        field = psf.point_spread_field(
            optics,
            nodes,
            tol=todo.tol,
            checks=checks,
            seed=seed,
            progress=lambda _, share: tell(FIELD, share),
        )
        return field, {FIELD: field.error_estimate}
    if uses_mean(optics.scene, nodes):
        optics, spread = mean_optics(optics), None
        begin(MEAN)
    if not todo.runs(FIELD):
        one = spread or psf.scene_point_spread(optics, todo.tol).point_spread
        scattered = isinstance(one, psf.RoughPointSpread | psf.HybridPointSpread)
        if scattered and 1.0 - float(one.intensity.sum()) > todo.tol * OUTSIDE:
            # scattered light has no diffraction tail; it is computed as far as the image reaches
            wide = 2 * max(optics.scene.camera.shape) - 1
            if wide > max(one.shape):
                one = psf.scene_point_spread(optics, todo.tol, shape=wide).point_spread
        return one, {}
    begin(FIELD)
    field, error = imaging.image_field(
        optics,
        tol=todo.tol,
        most_nodes=MOST_NODES,
        planned_nodes=next(stage.nodes for stage in todo.stages if stage.name == FIELD),
        anywhere=anywhere,
        progress=lambda _, share: tell(FIELD, share),
    )
    check_errors({FIELD: error}, todo.tol)
    return field, {FIELD: error}


def image_model(
    scene: Scene, spreads: PointSpreadField | PointSpread, *, mean: bool = False
) -> ForwardModel:
    """Return the image model for a reconstruction with known wall and pose of the object.

    The point spreads of `image_spreads` are averaged over the object if ``mean``, or if their
    deviation from the mean is at most `MOST_DEVIATION`; else the modes that make up less than 0.5 %
    of them (rms) are left out. Both make a fit several times faster.
    """
    from ..imaging import ForwardModel
    from ..imaging.geometry import chief_rays, picture_positions, pixel_centres
    from ..psf import PointSpreadField

    shape = scene.camera.shape
    if not isinstance(spreads, PointSpreadField):
        return ForwardModel(spreads.intensity, shape=shape)
    hidden = scene.hidden
    if mean or not isinstance(hidden, PlanarObject) or spreads.deviation() <= MOST_DEVIATION:
        return ForwardModel(spreads.mean(), shape=shape)
    rays = chief_rays(scene, *pixel_centres(scene.camera))
    return ForwardModel(spreads.compressed(0.005), shape=shape, at=picture_positions(hidden, rays))


def _reconstruct(
    scene: Scene,
    image: SpeckleImage,
    spreads: PointSpreadField | PointSpread,
    shadows: Shadows | None,
) -> Reconstruction:
    """Reconstruct the object; its pose and the point spreads are known."""
    from .. import inverse

    model = image_model(scene, spreads)
    dark = image.ledger["dark"] / image.electrons.size
    noise = electron_noise(scene, image.electrons - dark)
    full = image.electrons >= full_reading(scene.camera)
    veil = fitted_veil(
        scene, image.electrons, model, noise_sigma=noise, background=dark, shadows=shadows
    )
    measured = inverse.Measurement(
        image.electrons,
        noise_sigma=noise,
        saturated=full,
        background=dark,
        background_shape=veil,
    )
    return inverse.tv_deconvolve(measured, model)


class ShadowOperator(NamedTuple):
    """Light in the pixels of an image due to cells of the object, as `inverse.shadow_fit` takes it.

    ``matrix`` is (pixels, cells); the shapes are rows and columns.
    """

    matrix: Array
    pixel_shape: tuple[int, int]
    cell_shape: tuple[int, int]


def shadow_operator(scene: Scene) -> ShadowOperator:
    """Return the light in bins of the image due to cells of the object, for all light of a scene.

    An object is a multiple of the reflectance, or of the radiance, of a white picture. The longer
    side has `CELLS` cells, and at most `BINS` bins of a whole number of pixels.
    """
    from ..imaging.lit_walls import lit_transports

    (rows, columns), shape = shadow_cells(scene), scene.camera.shape
    joined = joined_pixels(scene)
    pixels = shape[0] // joined, shape[1] // joined
    sources = lit_transports(scene, cells=(rows, columns), pixels=pixels)
    if not sources:
        raise SceneError(
            "the scene has no light: laser.power = 0 W, no hidden.luminous and no [ambient]; "
            "add one of them"
        )
    matrix = np.sum([scale * one.matrix for one, scale in sources], axis=0)
    return ShadowOperator(matrix, pixels, (rows, columns))


def _from_shadows(scene: Scene, image: SpeckleImage) -> Reconstruction:
    """Reconstruct the object from its shadows; the occluders are known."""
    from .. import inverse

    light = image.electrons - image.ledger["dark"] / image.electrons.size
    used = wall_pixels(scene) & (image.electrons < full_reading(scene.camera))
    noise = electron_noise(scene, light)
    return inverse.shadow_fit(np.where(used, light, np.nan), shadow_operator(scene), noise=noise)
