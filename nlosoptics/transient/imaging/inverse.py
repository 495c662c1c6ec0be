"""Albedo of a hidden scene by a penalised likelihood of a confocal capture's counts."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect
from ..._progress import Progress
from ..._random import checked_seed
from ...errors import SamplingError
from ..capture.capture import TransientCapture
from ..capture.hidden_light import counts_photons, hidden_light
from ..capture.preprocessing import downsampled, gated
from .advice import Advice, advise
from .confocal_grids import confocal_grid
from .confocal_model import ConfocalModel, direct_pulse
from .volume import Volume, VolumeImage

Array = NDArray[np.floating]

#: Binary logarithm of the weight of the total variation that is tried first, and least and largest
#: one, in standard deviations of the noise of the likelihood's gradient.
FIRST, LEAST, MOST = 1, 0, 7
#: Iterations before the choice of a gain, at each weight, and with all photons.
BRANCH, EACH, LAST = 24, 40, 40
#: Distance of planes and width of bins (of path), in pitches of the wall points.
PLANES, BINS = 0.45, 0.8
#: Least albedo of a surface, relative to the mean over the picture weighted by its square.
PLATEAU = 0.45
#: Albedo that an iteration begins with where the phasor field shows nothing.
FLOOR = 0.03
#: Standard error of depths without noise, in distances of planes, and cells over which noise is
#: averaged.
SYSTEMATIC, NEAR = 0.25, 2.0
#: Cells at the rim that take up light from beyond the grid and are not shown.
RIM = 2


def inverse_image(
    capture: TransientCapture,
    *,
    advice: Advice | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> VolumeImage:
    """Fit the albedo of a hidden scene to the photon counts of a confocal capture.

    The albedo is the one with the largest likelihood of the counts, minus the total variation along
    x and y, common to all planes. The weight of the latter is the one whose fit to half of the
    photons has the largest likelihood of the other half.

    Parameters
    ----------
    capture : TransientCapture
        Confocal capture of photon counts on an even grid, with or without direct light. Direct
        light in it is taken as the response of laser and detector.
    advice : Advice, optional
        Result of `advise` for this capture: begin of the scene's light, background, and the depths
        at which its image has light. None: `advise` is called.
    seed : int
        Seed of the split of the photons.
    progress : callable(str, float), optional
        Called with a line of text and the completed fraction, 0 to 1.

    Returns
    -------
    VolumeImage
        Albedo in arbitrary units, averaged over z by a triangle of two planes' half width.
        ``details["threshold"]`` is the least confidence of a surface for `depth_map`,
        ``details["strength"]`` the weight of the total variation in standard deviations of the
        noise of the likelihood's gradient, and ``details["misfit"]`` the mean squared residual of
        the counts divided by their variance. ``details["standard_error"]`` (ny, nx) is that of the
        depths, m, which `depth_map` passes on.

    Raises
    ------
    SamplingError
        If the capture is not confocal, does not hold counts, or has no object above the noise.

    See Also
    --------
    advise : Phasor-field image, faster and for any capture.

    Notes
    -----
    The model is that of matt surfaces that face the wall. A factor that is an exponential of a
    quadratic polynomial of the wall point, such as for retroreflective or tilted surfaces, is
    fitted too if that increases the likelihood of the other half of the photons. The two outermost
    cells take up light of objects beside the grid, and are 0 in the image.

    The standard error of depths is that of an image of half of the photons, from the difference of
    two, root mean square over a few cells, and a quarter of the distance of planes. The total
    variation flattens slanted surfaces, the more the fewer the photons, which is not in it.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import TransientCapture, depth_map, inverse_image, wall_grid
    >>> wall = wall_grid(side=1.0, count=16)
    >>> path = 2 * np.linalg.norm(wall - (0.1, 0.0, 0.6), axis=-1)  # echo of one point
    >>> capture = TransientCapture(
    ...     H=np.stack([40.0 * (path // 0.02 == k) for k in range(120)]),
    ...     laser_points=wall,
    ...     sensor_points=wall,
    ...     delta_t=0.02,
    ...     pairing="confocal",
    ... )
    >>> image = inverse_image(capture)
    >>> depths = depth_map(image, threshold=image.details["threshold"])
    >>> print(np.nanmedian(depths.depth).round(2))  # m, of bins and points 1 and 6 cm apart
    0.61
    """
    begun = time.perf_counter()
    capture = expect("capture", capture, "TransientCapture")
    seed = checked_seed(seed)
    if not (capture.is_confocal and counts_photons(capture)):
        raise SamplingError(
            "inverse_image needs a confocal capture of photon counts, this one has pairing = "
            f"{capture.pairing!r} and values down to {capture.H.min():g}, or not whole numbers; "
            "use phasor_image"
        )
    chosen = advise(capture, seed=seed) if advice is None else expect("advice", advice, "Advice")
    fit, volume = _prepared(capture, chosen)
    half = np.random.default_rng(seed).binomial(fit.counts.astype(int), 0.5).astype(np.float32)
    fit, halves, strength = _chosen(fit.with_noise(half), half, progress)
    albedo = fit.albedo(LAST, strength, halves[0] + halves[1])
    mean = fit.mean(albedo)
    misfit = float(np.mean((fit.counts - mean) ** 2 / mean))
    image, *parts = (
        VolumeImage(intensity=_surfaces(a), volume=volume, method="inverse")
        for a in (albedo, *halves)
    )
    front = image.projection()
    plateau = float((front**3).sum() / (front**2).sum())
    threshold = min(PLATEAU * plateau / float(front.max()), 1.0)
    details = {
        "threshold": threshold,
        "strength": strength,
        "misfit": misfit,
        "standard_error": _standard_error(parts, front >= threshold * front.max()),
    }
    return replace(image, seconds=time.perf_counter() - begun, details=details)


def _surfaces(albedo: Array) -> Array:
    """Return the albedo (nz, ny, nx) without rims, and summed over near planes.

    A surface between two planes is split among them, each with a part of its albedo.
    """
    from scipy.ndimage import correlate1d

    kept = np.zeros_like(albedo)
    kept[:, RIM:-RIM, RIM:-RIM] = albedo[:, RIM:-RIM, RIM:-RIM]
    return np.asarray(correlate1d(kept, np.array([1, 2, 3, 2, 1]) / 3.0, axis=0, mode="constant"))


def _standard_error(parts: list[VolumeImage], seen: NDArray[np.bool_]) -> Array:
    """Return that of the depths of the cells ``seen``, (ny, nx), from images of both halves."""
    from scipy.ndimage import gaussian_filter

    z = parts[0].volume.z
    apart = parts[0].peak_depth() - parts[1].peak_depth()
    square = gaussian_filter(np.where(seen, 0.5 * apart**2, 0.0), NEAR)
    share = gaussian_filter(seen.astype(np.float64), NEAR)
    error = np.sqrt(square / np.maximum(share, 1e-9) + (SYSTEMATIC * (z[1] - z[0])) ** 2)
    return np.where(seen, error, np.nan)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Counts with their model, and what is known beside the albedo."""

    model: ConfocalModel
    counts: Array  # (bins, ny, nx)
    background: Array  # (bins, ny, nx)
    noise: float  # Standard deviation of the likelihood's gradient over the albedo
    gain: Array  # (ny, nx): factor of each wall point
    view: Array  # (ny, nx): front view of the phasor field, from above 0 to 1

    def mean(self, albedo: Array) -> Array:
        """Return the expected counts."""
        return np.maximum(self.model.light(albedo) * self.gain + self.background, 1e-6)

    def likelihood(self, albedo: Array) -> float:
        """Return the logarithm of the likelihood, without a constant."""
        mean = self.mean(albedo)
        return float((self.counts * np.log(mean) - mean).sum(dtype=np.float64))

    def with_noise(self, half: Array) -> _Fit:
        """Return the fit with the noise of the gradient, from half of the photons at random."""
        level = np.maximum(self.counts.mean(axis=(1, 2), keepdims=True), self.background) + 1e-6
        # the difference of both halves has the noise of their sum, and no signal
        noise = self.model.adjoint((2.0 * half - self.counts) / level)
        # the nearest planes have many times the noise of others
        return replace(self, noise=float(np.sqrt(np.median(np.mean(noise**2, axis=(1, 2))))))

    def part(self, counts: Array) -> _Fit:
        """Return the fit of a random half of the photons."""
        noise = self.noise / 2.0**0.5
        return replace(self, counts=counts, background=0.5 * self.background, noise=noise)

    @cached_property
    def seen(self) -> Array:
        """Light of each voxel of albedo 1, at least some of that in the middle of most planes."""
        seen = self.model.adjoint(np.ones_like(self.counts) * self.gain)
        return np.asarray(np.maximum(seen, 0.15 * np.median(seen.max(axis=(1, 2)))))

    def start(self) -> Array:
        """Return an albedo that is even over z, with the phasor field's view."""
        even = np.repeat(self.view[None], len(self.model.planes), axis=0)
        light = max(float((self.counts - self.background).sum()), 1.0)
        return np.asarray(even * (light / float(self.model.light(even).sum())))

    def albedo(self, iterations: int, strength: float, start: Array) -> Array:
        """Return the albedo after some iterations: expectation maximisation with accelerated steps.

        Each step is followed by a step of the total variation in the metric of the former (Sawatzky
        et al., 2008), and extrapolated by the ratio of successive steps (Biggs, Andrews, 1997).
        """
        weight = strength * self.noise
        flow = np.zeros((2, *start.shape), dtype=np.float32)
        old, albedo, step, before = start, start, *np.zeros((2, *start.shape), dtype=np.float32)
        for _ in range(iterations):
            power = float((before**2).sum())
            along = min(max(float((step * before).sum()) / power, 0.0), 0.97) if power else 0.0
            ahead = np.maximum(albedo + along * (albedo - old), 1e-3 * albedo)
            ratio = self.model.adjoint(self.gain * (self.counts / self.mean(ahead)))
            scale = ahead / self.seen
            flow, new = _smoothed(np.maximum(ratio, 0.0) * scale, scale, weight, flow)
            new = np.maximum(new, 1e-9 * new.max())
            before, step = step, new - ahead
            old, albedo = albedo, new
        return albedo

    def refined(self, rounds: int, strength: float, albedo: Array) -> tuple[_Fit, Array]:
        """Return fit and albedo after rounds of gain and albedo in turn."""
        fit = self
        for _ in range(rounds):
            fit = fit.with_gain(albedo)
            albedo = fit.albedo(BRANCH // 4, strength, albedo)
        return fit, albedo

    def with_gain(self, albedo: Array) -> _Fit:
        """Return the fit with a factor exp(quadratic polynomial of the wall point), one step."""
        ny, nx = self.model.shape
        y, x = np.meshgrid(np.linspace(-1, 1, ny), np.linspace(-1, 1, nx), indexing="ij")
        terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y]).reshape(6, -1)
        light = self.model.light(albedo) * self.gain
        slopes = terms * light.sum(axis=0).ravel()
        weighted = slopes / (light + self.background).sum(axis=0).ravel()
        left = (self.counts - self.background - light).sum(axis=0).ravel()
        found = np.clip(np.linalg.solve(weighted @ slopes.T, weighted @ left), -0.3, 0.3)
        gain = np.log(self.gain) + (found @ terms).reshape(ny, nx)
        return replace(self, gain=np.exp(gain - gain.mean()).astype(np.float32))


def _prepared(capture: TransientCapture, advice: Advice) -> tuple[_Fit, Volume]:
    """Return counts and model of the scene's light, and the volume of the picture."""
    if advice.image is None:
        raise SamplingError("no object above the noise; give a capture of more photons")
    own = advice.light
    if own.H.shape != capture.H.shape or (own.sensor_points != capture.sensor_points).any():
        raise SamplingError(
            f"advice is that of another capture, with values of shape {own.H.shape} and not "
            f"{capture.H.shape} or at other points; give advise(capture), or leave it out"
        )
    if min(capture.sensor_shape) <= 2 * RIM:
        raise SamplingError(
            f"inverse_image leaves out {RIM} cells at each rim, and needs more than {2 * RIM} wall "
            f"points along x and y, the capture has {capture.sensor_shape}; use phasor_image"
        )
    facts, width = advice.light.details["hidden_light"], capture.delta_t
    first, end = (round((facts[name] - capture.t_start) / width) for name in ("start", "stop"))
    pulse, background = direct_pulse(capture, first, facts["background"])
    planes = advice.image.volume
    pitch = min(np.diff(planes.x[:2]), np.diff(planes.y[:2]))[0]
    group = max(1, int(BINS * pitch / width))
    n_bins = (end - first) // group
    last = first + n_bins * group
    light = gated(capture, start=capture.edges[first], stop=capture.edges[last])
    light = downsampled(light, bins=group)
    grid = confocal_grid(light, "inverse_image")
    amplitude = np.sqrt(advice.image.intensity.max(axis=(1, 2)))
    lit = planes.z[amplitude > 0.15 * amplitude.max()]
    margin = 0.5 * advice.image.wl_mean
    near = max(lit[0] - margin, 0.5 * facts["start"], PLANES * pitch)
    z = np.arange(near, max(lit[-1] + margin, near + 5 * PLANES * pitch), PLANES * pitch)
    model = ConfocalModel(grid, z, pulse)
    counts = light.H.astype(np.float32)
    dark = background[first:last].reshape(n_bins, group).sum(axis=1)[:, None, None]
    # the level of each pair, which hidden_light has subtracted from its bins
    middle = (first + last) // 2
    level = (capture.H - hidden_light(capture, start=facts["start"]).H)[middle]
    dark = np.maximum(dark + group * (level - facts["background"]), 0.0).astype(np.float32)
    seen = advice.image.intensity.max(axis=0)
    view = (FLOOR + seen / seen.max()).astype(np.float32)
    fit = _Fit(model, counts, dark, 0.0, np.ones_like(view), view)
    return fit, Volume(grid.x, grid.y, z)


def _chosen(
    fit: _Fit, half: Array, progress: Progress | None
) -> tuple[_Fit, tuple[Array, Array], float]:
    """Return gain, albedo by both halves, and the strength for all photons.

    Gain and strength are those whose fit of one half has the largest likelihood of the other.
    """
    first, other = fit.part(half), fit.part(fit.counts - half)
    begun = first.albedo(BRANCH, 2.0**FIRST, first.start())
    albedo = first.albedo(BRANCH, 2.0**FIRST, begun)
    gained, bright = first.refined(4, 2.0**FIRST, begun)
    if replace(other, gain=gained.gain).likelihood(bright) > other.likelihood(albedo):
        first = gained.refined(4, 2.0**FIRST, bright)[0]
        other = replace(other, gain=first.gain)

    @cache
    def tried(k: int) -> tuple[float, Array]:
        if progress is not None:
            progress(f"total variation {2.0**k:g}", 0.2 + 0.1 * tried.cache_info().currsize)
        albedo = first.albedo(EACH, 2.0**k, first.start())
        return other.likelihood(albedo), albedo

    best, step = FIRST, 1 if tried(FIRST + 1)[0] > tried(FIRST)[0] else -1
    while LEAST < best < MOST and tried(best + step)[0] > tried(best)[0]:
        best += step
    vertex = 0.0  # of the parabola through three likelihoods
    if LEAST < best < MOST:
        rise, fall = (tried(best)[0] - tried(near)[0] for near in (best - 1, best + 1))
        vertex = 0.5 * (rise - fall) / max(rise + fall, 1e-9)
    halves = tried(best)[1], other.albedo(EACH, 2.0**best, other.start())
    # the same weight for all photons, whose noise is larger
    return replace(fit, gain=first.gain), halves, 2.0 ** (best + vertex - 0.5)


def _smoothed(albedo: Array, scale: Array, weight: float, flow: Array) -> tuple[Array, Array]:
    """Return flow and minimum of ``sum (u - albedo)^2/(2 scale) + weight TV(u)``, six steps.

    The gradient's length is that over all planes at once, so that planes share their edges.
    """
    from scipy.ndimage import maximum_filter

    pace = 0.125 / np.maximum(maximum_filter(scale, (1, 3, 3)), 1e-20)
    for _ in range(6):
        now = albedo + scale * _divergence(flow)
        flow[0, :, :-1] += pace[:, :-1] * np.diff(now, axis=1)
        flow[1, :, :, :-1] += pace[:, :, :-1] * np.diff(now, axis=2)
        flow /= np.maximum(np.sqrt((flow**2).sum(axis=(0, 1))) / weight, 1.0)
    return flow, albedo + scale * _divergence(flow)


def _divergence(flow: Array) -> Array:
    """Return the negative adjoint of the forward differences along y and x."""
    along_y, along_x = flow
    total = along_y + along_x
    total[:, 1:] -= along_y[:, :-1]
    total[:, :, 1:] -= along_x[:, :, :-1]
    return np.asarray(total)
