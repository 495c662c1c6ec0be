"""Images of the detector, and histograms of path lengths, by Monte Carlo light transport."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..._checks import counted, fits_memory, positive, real, whole
from ..._html import Figures, Shown
from ..._nouns import Noun
from ..._photons import photon_rate
from ..._progress import Progress
from ..._xarray import Labelled, Labels, pixels, variable
from ...errors import SceneError
from ...kernels.codes import GROUPS
from ...scene import Scene
from ..fans.paths import RayPaths
from ..light.trace import group_means, job_of, mean_map, until_done

if TYPE_CHECKING:
    from ..light.blocks import Job
    from .image_blocks import Film

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class PathHistogram(Noun):
    """Histogram of the path lengths of the detected light, weighted by power.

    `trace_image` computes it if bins are given.

    Parameters
    ----------
    t_start, delta_t : float
        Start of bin 0 and width of a bin, m of optical path.
    outer_legs : bool
        Whether path lengths include the first leg, from the laser to the first reflection, and the
        last leg, from the last reflection to the lens.
    power, power_error : ndarray, (n_bins,)
        Power in each bin of light that met the hidden object, and its standard error, W.
    by_bounce, by_bounce_error : ndarray, (max_bounces + 1, n_bins)
        Row j is the part of ``power`` that was reflected j times, and its standard error, W.
    stray, stray_error : ndarray, (n_bins,)
        Power in each bin of light that never met the hidden object, and its standard error, W.
    before, after : float
        Power of light that met the hidden object and arrives before the first bin or after the
        last one, W.

    See Also
    --------
    trace_image : Image and histogram of path lengths.
    nlosoptics.transient.render : Intensity at the wall in bins of path length.
    nlosoptics.views.path_lengths : Curves of a histogram.
    """

    t_start: float
    delta_t: float
    outer_legs: bool
    power: Array
    power_error: Array
    by_bounce: Array
    by_bounce_error: Array
    stray: Array
    stray_error: Array
    before: float
    after: float

    def __post_init__(self) -> None:
        for name in ("power", "by_bounce", "stray"):
            getattr(self, name).flags.writeable = False
            getattr(self, f"{name}_error").flags.writeable = False

    @property
    def edges(self) -> Array:
        """Edges of the bins, (n_bins + 1,), m of optical path."""
        return np.asarray(self.t_start + self.delta_t * np.arange(len(self.power) + 1))

    @property
    def times(self) -> Array:
        """Centres of the bins, (n_bins,), m of optical path."""
        return np.asarray(self.t_start + self.delta_t * (np.arange(len(self.power)) + 0.5))


@dataclass(frozen=True, eq=False, kw_only=True)
class TracedImage(Noun, Shown, Labelled):
    """Camera image by Monte Carlo ray tracing, with the standard error of every pixel.

    `trace_image` computes it. The arrays are read-only and ordered [y, x], with row 0 at the lowest
    y of the detector. The lens inverts the image, so that the scene appears upright if row 0 is
    drawn on top. The x and y axes of the detector are the first two rows of ``camera.frame``.

    Parameters
    ----------
    expected, expected_error : ndarray, (ny, nx)
        Mean number of electrons of each pixel in one exposure, and its standard error. All detected
        light and the dark current are included. Glare (light scattered in the lens) is not.
    power, power_error : ndarray, (ny, nx)
        Power on each pixel of light that met the hidden object, and its standard error, W.
    by_bounce, by_bounce_error : ndarray, (max_bounces + 1, ny, nx)
        Image j is the part of ``power`` that was reflected j times, and its standard error, W.
    stray, stray_error : ndarray, (ny, nx)
        Power on each pixel of light that never met the hidden object, and its standard error, W.
    group_power : ndarray, (32,)
        Power of light that met the hidden object, on all pixels, for each of the 32 groups of rays
        from which the standard errors come, W; for `ratio`.
    pitch : float
        Side of an image pixel, m: that of a detector pixel times ``camera.binning``.
    exposure : float
        Exposure time that ``expected`` refers to, s.
    histogram : PathHistogram or None
        Detected power in bins of path length; None if no bins were given.
    paths : RayPaths
        Flux, power balance and number of the rays that formed the image. The pixels of ``power``
        add up to ``paths.flux``. Single paths are not kept.
    colours : tuple of TracedImage
        Image at each of the ``wavelengths`` of `trace_image`; empty if none were given.

    See Also
    --------
    trace_image : Image and histogram of path lengths.
    nlosoptics.imaging.SpeckleImage : Image by waves, with the noise of the camera.
    nlosoptics.views.traced_image : Image and its relative error.
    """

    expected: Array
    expected_error: Array
    power: Array
    power_error: Array
    by_bounce: Array
    by_bounce_error: Array
    stray: Array
    stray_error: Array
    group_power: Array
    pitch: float
    exposure: float
    histogram: PathHistogram | None
    paths: RayPaths
    colours: tuple[TracedImage, ...] = ()

    def __post_init__(self) -> None:
        for name in ("expected", "power", "by_bounce", "stray"):
            getattr(self, name).flags.writeable = False
            getattr(self, f"{name}_error").flags.writeable = False
        self.group_power.flags.writeable = False

    def ratio(self, to: TracedImage) -> tuple[float, float]:
        """Return the ratio of the object's light in two images by the same rays, and its error.

        Parameters
        ----------
        to : TracedImage
            Image in the denominator, another one of the same ``colours``.

        Returns
        -------
        ratio, error : float
            Ratio of the powers ``paths.flux``, and its standard error, which takes into account
            that the rays are the same.
        """
        groups = min(self.paths.n_rays, GROUPS)
        one, other = self.group_power[:groups], to.group_power[:groups]
        mean = float(other.mean())
        if mean <= 0.0 or to.paths.n_rays != self.paths.n_rays:
            raise SceneError(
                f"a ratio needs light of the object and equally many rays, but the image in the "
                f"denominator has {mean:.3g} W and {to.paths.n_rays} rays against "
                f"{self.paths.n_rays}; give n_rays, without tol or max_seconds"
            )
        ratio = float(one.mean()) / mean
        if groups < 4:
            return ratio, math.inf
        # the factor of Student's distribution as for all other errors
        spread = float(((one - ratio * other) ** 2).sum()) / (groups * (groups - 3))
        return ratio, math.sqrt(spread) / mean

    def _labels(self) -> Labels:
        names = {
            "expected": ("electrons", "mean reading of one exposure"),
            "power": ("W", "light that met the hidden object"),
            "by_bounce": ("W", "light that met the hidden object, by number of reflections"),
            "stray": ("W", "light that never met the hidden object"),
        }
        bounces = np.arange(len(self.by_bounce))
        axes = {"bounces": variable(["bounces"], bounces, "1", "number of reflections")}
        axes |= pixels(self.expected.shape, self.pitch)
        if self.histogram is not None:
            middles = self.histogram.edges[:-1] + self.histogram.delta_t / 2
            axes["path"] = variable(["path"], middles, "m", "optical path")
        arrays = {}
        for prefix, noun, its in ("", self, "yx"), ("path_", self.histogram, ["path"]):
            for name, suffix in itertools.product(names, ("", "_error")):
                values = getattr(noun, name + suffix, None)
                if values is not None:  # a histogram has no electrons
                    dimensions = ["bounces"][: values.ndim - len(its)] + list(its)
                    unit, meaning = names[name]
                    meaning += ", standard error" if suffix else ""
                    arrays[prefix + name + suffix] = variable(dimensions, values, unit, meaning)
        return Labels(arrays, axes, {"pitch": self.pitch, "exposure": self.exposure})

    def _figures(self) -> Figures:
        ny, nx = self.expected.shape
        paths = self.paths
        figures = {
            "electrons": f"{self.expected.max():.3g} at most, mean {self.expected.mean():.3g}",
            "standard error": f"{self.expected_error.mean():.2g} electrons on average",
            "of the object": f"{paths.flux:.3g} ± {paths.standard_error:.1g} W",
            "stray light": f"{paths.stray:.3g} ± {paths.stray_error:.1g} W",
            "rays": f"{paths.n_rays}, up to {counted(len(self.by_bounce) - 1, 'reflection')}",
            "exposure": f"{1e3 * self.exposure:.3g} ms",
            "image": f"{nx} x {ny} pixels of {1e6 * self.pitch:.3g} µm",
        }
        if self.histogram is not None:
            edges = self.histogram.edges
            figures["path lengths"] = (
                f"{counted(len(edges) - 1, 'bin')} of {1e3 * self.histogram.delta_t:.4g} mm, "
                f"{edges[0]:.4g} to {edges[-1]:.4g} m"
            )
        alt = f"Traced image, {nx} x {ny} pixels, brighter where there are more electrons"
        return Figures("Traced image", figures, alt)


def trace_image(
    scene: Scene,
    *,
    wavelengths: Sequence[float] | None = None,
    n_rays: int | None = None,
    tol: float | None = None,
    max_seconds: float | None = None,
    max_bounces: int = 5,
    t_start: float | None = None,
    delta_t: float | None = None,
    n_bins: int | None = None,
    outer_legs: bool = True,
    exposure: float | None = None,
    analog: bool = False,
    sampler: Literal["sobol", "philox"] = "sobol",
    seed: int = 0,
    progress: Progress | None = None,
) -> TracedImage:
    """Compute the camera image by Monte Carlo ray tracing of the laser's light.

    A histogram of the path lengths of the detected light is computed too, if bins are given.

    Parameters
    ----------
    scene : Scene
        Scene to trace; its camera defines the pixels.
    wavelengths : sequence of float, optional
        Vacuum wavelengths, m, at each of which the laser has its power in turn. The image is that
        at the first one, and ``colours`` has one image for each. By default the laser's.
    n_rays, tol, max_seconds, max_bounces, analog, sampler, seed, progress
        Number of rays, its limits, and random numbers, as for `trace`. Single pixels have larger
        errors than ``tol``, which is that of the light on all pixels.
    t_start, delta_t : float, optional
        Start of bin 0 and width of a bin of the histogram, m of optical path.
    n_bins : int, optional
        Number of bins of the histogram, at most 2^20. Give all three of ``t_start``, ``delta_t``
        and ``n_bins``, or none for no histogram.
    outer_legs : bool
        Start and end of the path lengths in the histogram. True: from the laser to the lens.
        False: from the first to the last reflection, that is from wall to wall for three
        reflections.
    exposure : float, optional
        Exposure time of the expected electrons, s; by default the camera's.

    Returns
    -------
    TracedImage
        Electrons and power of every pixel with standard errors, the histogram, and the power
        balance.

    Raises
    ------
    SceneError
        As for `trace`, or if some but not all of ``t_start``, ``delta_t`` and ``n_bins`` are given,
        or a material's albedo is not known at a wavelength.
    MemoryLimitError
        If the sums would not fit in memory. They take ``304 (max_bounces + 2)`` bytes per pixel
        and ``304 (max_bounces + 1)`` per bin.

    See Also
    --------
    trace : Power without an image, for the same rays.
    nlosoptics.scene.Spectrum : Albedo that depends on the wavelength.
    trace_point : Light of a single object point, resolved by pixels.
    nlosoptics.imaging.form_image : Image by waves, with the noise of the camera.
    nlosoptics.transient.render : Intensity at the wall in bins of path length.

    Notes
    -----
    The rays are those of `trace`, whose notes describe the method. For the same options, ``paths``
    is the result of `trace`, and the sums over pixels agree with it to rounding.

    The camera has an ideal thin lens. A ray that enters the lens at any point of the stop is
    extended back to the plane in focus, and that point is projected through the centre of the lens
    onto the detector. Walls and objects out of focus are blurred accordingly. Path lengths end
    where the light enters the lens.

    The standard errors come from 32 groups of rays. At the edge of a bright area, such as a letter
    seen in a mirror, a pixel receives bright light from few rays. Until enough of them have hit the
    pixel, its value and its standard error are too small.

    Images at several ``wavelengths`` are by the same rays, up to the fourth reflection. Then weak
    rays are ended at random, which is decided by their power. If all materials have a single lobe
    and ``max_bounces`` is 3, the ratio of two powers (`TracedImage.ratio`) is therefore exact.
    Otherwise it depends on the mix of paths. Quantum efficiency and transmission of the camera are
    the same at all wavelengths, but the same power has more photons at longer ones.

    `nlosoptics.imaging.form_image` computes the image from point spread functions. It includes
    diffraction and glare, but takes the lens as small and the laser spot as a point, and stops at
    three reflections. The ray trace has none of these limits, but no diffraction and no glare.

    Examples
    --------
    >>> from nlosoptics import Scene, raytrace
    >>> scene = Scene.load("examples/scenes/letter_flat.toml").resized(16)
    >>> bins = {"t_start": 3.0, "delta_t": 0.1, "n_bins": 40}
    >>> image = raytrace.trace_image(scene, n_rays=4096, max_bounces=3, seed=0, **bins)
    >>> image.expected.shape, image.by_bounce.shape, image.histogram.power.shape
    ((16, 16), (4, 16, 16), (40,))
    >>> bool(abs(image.power.sum() / image.paths.flux - 1.0) < 1e-12)
    True

    A hidden object whose albedo depends on the wavelength:

    >>> from dataclasses import replace
    >>> from nlosoptics.scene import Lambert, Spectrum
    >>> red = Lambert(Spectrum((450e-9, 650e-9), (0.2, 0.8)))
    >>> scene = replace(scene, hidden=replace(scene.hidden, material=red))
    >>> both = (450e-9, 650e-9)
    >>> blue, red = raytrace.trace_image(
    ...     scene, wavelengths=both, n_rays=1024, max_bounces=3
    ... ).colours
    >>> ratio, error = red.ratio(blue)
    >>> round(ratio, 6), error < 1e-9
    (4.0, True)
    """
    exposure = None if exposure is None else positive("exposure", exposure, unit="s")
    bins = *_bins(t_start, delta_t, n_bins), bool(outer_legs)
    scenes = [scene] if wavelengths is None else _coloured(scene, wavelengths)
    images: list[TracedImage] = []

    def advance(stage: str, share: float) -> None:
        if progress is not None:
            progress(stage, (len(images) + share) / len(scenes))

    for one in scenes:
        job = job_of(one, max_bounces, sampler, seed, analog=analog)
        one.check_laser_light()
        film = _film(job, bins)
        paths = until_done(job, film.exposed, n_rays, tol, max_seconds, advance)
        images.append(_image(film, paths, exposure))
    return images[0] if wavelengths is None else replace(images[0], colours=tuple(images))


def _film(job: Job, bins: tuple[float, float, int, bool]) -> Film:
    """Return an empty film for the detector, if it fits in memory."""
    from .image_blocks import Film

    (ny, nx), layers, n_bins = job.scene.camera.shape, job.max_bounces + 1, bins[2]
    fits_memory(
        f"a traced image of {nx} x {ny} pixels (camera.pixels, camera.binning) with max_bounces = "
        f"{job.max_bounces} and {counted(n_bins, 'bin')}",
        8.0 * (GROUPS + 6) * ((layers + 1) * nx * ny + layers * n_bins),
        "bin more pixels, or lower max_bounces or n_bins",
    )
    return Film(job, (ny, nx), bins)


def _image(film: Film, paths: RayPaths, exposure: float | None) -> TracedImage:
    """Return the image of a film that ``paths`` have exposed."""
    scene, n_rays = film.job.scene, paths.n_rays
    camera = scene.camera
    exposure = camera.exposure if exposure is None else exposure
    everything, variance = mean_map(film.image.sum(axis=1), n_rays)
    gain = exposure * camera.quantum_efficiency * photon_rate(1.0, scene.laser.wavelength)
    return TracedImage(
        expected=gain * everything + camera.dark_current * exposure * camera.binning**2,
        expected_error=gain * np.sqrt(variance),
        **_means(film.image, n_rays),
        group_power=group_means(film.image[:, 1:].sum(axis=(1, 2, 3)), n_rays),
        pitch=camera.image_pitch,
        exposure=exposure,
        histogram=_histogram(film.histogram, n_rays, film.bins) if film.bins[2] else None,
        paths=paths,
    )


def _coloured(scene: Scene, wavelengths: Sequence[float]) -> list[Scene]:
    """Return the scene at each wavelength; raise `SceneError` for anything else."""
    if not isinstance(scene, Scene):
        raise SceneError(f"scene is a {type(scene).__name__}; give a Scene, such as Scene.load()")
    if not isinstance(wavelengths, Sequence | np.ndarray) or not len(wavelengths):
        raise SceneError(f"wavelengths is {wavelengths!r}; give a list of wavelengths in m")
    scenes = []
    for index, wavelength in enumerate(wavelengths):
        try:
            scenes.append(replace(scene, laser=replace(scene.laser, wavelength=wavelength)))
        except SceneError as error:
            raise SceneError(f"wavelengths[{index}]: {error}") from None
    return scenes


def _bins(
    t_start: float | None, delta_t: float | None, n_bins: int | None
) -> tuple[float, float, int]:
    """Return start and width, m, and number of the bins, checked; no bins if none is given."""
    given = {"t_start": t_start, "delta_t": delta_t, "n_bins": n_bins}
    missing = [name for name, value in given.items() if value is None]
    if len(missing) == 3:
        return 0.0, 1.0, 0
    if missing:
        present = next(name for name in given if name not in missing)
        raise SceneError(
            f"{' and '.join(missing)} missing for the histogram that {present} = "
            f"{given[present]!r} asks for; give t_start, delta_t and n_bins, or none of them"
        )
    return (
        real("t_start", t_start),
        positive("delta_t", delta_t, unit="m"),
        whole("n_bins", n_bins, 1, 1 << 20),
    )


def _means(sums: Array, rays: int) -> dict[str, Any]:
    """Return the means of `Film` sums (groups, layers, ...), W, and their errors, by field."""
    power, variance = mean_map(sums[:, 1:].sum(axis=1), rays)
    layers = [mean_map(sums[:, k], rays) for k in range(sums.shape[1])]
    stray, stray_variance = layers[0]
    nothing = np.zeros_like(stray)  # no light is detected without a reflection
    return {
        "power": power,
        "power_error": np.sqrt(variance),
        "by_bounce": np.stack([nothing, *(mean for mean, _ in layers[1:])]),
        "by_bounce_error": np.stack([nothing, *(np.sqrt(square) for _, square in layers[1:])]),
        "stray": stray,
        "stray_error": np.sqrt(stray_variance),
    }


def _histogram(sums: Array, rays: int, bins: tuple[float, float, int, bool]) -> PathHistogram:
    """Return the histogram of `Film` sums (groups, layers, n_bins + 2) and its bins."""
    means = _means(sums, rays)
    before, after = (float(means["power"][k]) for k in (0, -1))
    return PathHistogram(
        t_start=bins[0],
        delta_t=bins[1],
        outer_legs=bins[3],
        before=before,
        after=after,
        **{name: values[..., 1:-1].copy() for name, values in means.items()},
    )
