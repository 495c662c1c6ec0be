"""Choice of wavelength and volume for an image, from the capture alone."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import expect
from ..._nouns import Noun
from ..._progress import Progress
from ..._random import checked_seed
from ...errors import SamplingError, ValidityWarning
from ..capture.capture import TransientCapture
from ..capture.hidden_light import counts_photons, hidden_light, pitch
from .depth import DepthMap, depth_map
from .phasor_camera import phasor_image
from .volume import PhasorImage, Volume

Array = NDArray[np.floating]

#: Wavelengths that are tried, in units of the shortest one that the wall points can sample.
WAVELENGTHS = (1.0, 1.5, 2.0, 3.0, 4.0)
#: Least correlation of the front views of two halves of the photons.
AGREEMENT = 0.75
#: Least amplitude of a cell with a surface, relative to the brightest cell.
AMPLITUDE = 0.3


@dataclass(frozen=True, eq=False, kw_only=True)
class Advice(Noun):
    """Settings for an image of a capture, and the image that they give; `advise` finds them.

    Parameters
    ----------
    light : TransientCapture
        Light of the hidden scene, from `hidden_light`, ready for every method of imaging: smoothed
        over time by a Gaussian with a standard deviation of an eighth of the wavelength, since the
        halves do not agree on finer structure.
    agreement : mapping of float to float
        Correlation of the front views of two halves of the photons, for each wavelength tried, m.
    image : PhasorImage, optional
        Image at the shortest wavelength at which the halves agree. None: no object above the noise.
    depths : DepthMap, optional
        Depths of ``image``; its confidence is how well the halves agree in each cell, -1 to 1, and
        its ``standard_error`` is that of photon noise and of surfaces wider than the resolution.

    See Also
    --------
    advise : Find them.
    """

    light: TransientCapture
    agreement: Mapping[float, float]
    image: PhasorImage | None
    depths: DepthMap | None

    @property
    def status(self) -> str:
        """Whether there is an image: "converged", or "no object above the noise"."""
        return "no object above the noise" if self.image is None else "converged"


def advise(capture: TransientCapture, *, seed: int = 0, progress: Progress | None = None) -> Advice:
    """Choose gate, wavelength and volume for a phasor-field image of a capture, and form it.

    The photons are split at random into two independent captures. Both are imaged at wavelengths of
    4, 6, 8, 12 and 16 pitches of the wall points (half of these if laser and sensor points differ).
    The shortest wavelength at which both front views correlate by 0.75 gives the image.

    Parameters
    ----------
    capture : TransientCapture
        Capture with a grid of sensor points, or of laser points if there is a single sensor point.
    seed : int
        Seed of the split.
    progress : callable(str, float), optional
        Called with a line of text and the completed fraction, 0 to 1.

    Returns
    -------
    Advice
        Prepared light, image, depths and agreement of the halves.

    Raises
    ------
    SamplingError
        If the wall points are not an even grid.

    See Also
    --------
    hidden_light : Gate and background.
    phasor_image : The image, with all settings given.

    Notes
    -----
    A capture whose values are not whole numbers has no photon noise, and its halves agree fully.
    Planes lie a quarter of a wavelength apart. Intervals of 1.96 standard errors of the depths hold
    about 95 % of the true ones, more with many photons. A cell has a depth if its amplitude is at
    least 0.3 of the largest one.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.transient import TransientCapture, advise, wall_grid
    >>> wall = wall_grid(side=1.0, count=16)
    >>> path = 2 * np.linalg.norm(wall - (0.1, 0.0, 0.6), axis=-1)  # echo of one point
    >>> capture = TransientCapture(
    ...     H=np.stack([40.0 * (path // 0.02 == k) for k in range(120)]),
    ...     laser_points=wall,
    ...     sensor_points=wall,
    ...     delta_t=0.02,
    ...     pairing="confocal",
    ... )
    >>> advice = advise(capture)
    >>> advice.status, advice.image.wl_mean
    ('converged', 0.25)
    """
    from scipy.ndimage import gaussian_filter1d

    capture = expect("capture", capture, "TransientCapture")
    seed = checked_seed(seed)
    try:
        light = hidden_light(capture)
    except SamplingError:
        return Advice(light=capture, agreement={}, image=None, depths=None)
    facts: Any = light.details["hidden_light"]
    shortest = shortest_wavelength(capture)
    halves = _halves(capture, light, seed)
    agreement: dict[float, float] = {}
    for k, wl_mean in enumerate(shortest * np.array(WAVELENGTHS)):
        if progress is not None:
            progress(f"wavelength {wl_mean:.3g} m", k / len(WAVELENGTHS))
        step = 0.25 * wl_mean
        # one plane before the light, between which and the next a depth is interpolated
        near = max(0.5 * facts["start"] - step, step)
        far = max(0.5 * facts["stop"], near)
        volume = Volume.facing(grid_of(capture), (near, far, step))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ValidityWarning)  # far planes are darker at the rim
            images = [phasor_image(h, volume, wl_mean=wl_mean) for h in halves]
        views = [image.projection().ravel() for image in images]
        agreement[float(wl_mean)] = float(np.corrcoef(views[0], views[-1])[0, 1])
        if agreement[float(wl_mean)] >= AGREEMENT:
            image = _sum(images)
            smooth = gaussian_filter1d(light.H, 0.125 * wl_mean / light.delta_t, axis=0)
            light = replace(light, H=smooth)
            depths = _depths(image, images)
            return Advice(light=light, agreement=agreement, image=image, depths=depths)
    return Advice(light=light, agreement=agreement, image=None, depths=None)


def shortest_wavelength(capture: TransientCapture) -> float:
    """Return the shortest wavelength that wall points and bins of a capture can sample, m."""
    ways = 4.0 if capture.pairing == "confocal" else 2.0
    return max(ways * pitch(capture), 4.0 * capture.delta_t)


def grid_of(capture: TransientCapture) -> Array:
    """Return the grid of wall points that a volume faces: the sensor's, or else the laser's."""
    sensors, lasers = capture.sensor_points, capture.laser_points
    # some files store a single point as a grid
    alone = sensors.ndim < 3 or (sensors.size == 3 and lasers.ndim == 3)
    return lasers if alone else sensors


def _halves(
    capture: TransientCapture, light: TransientCapture, seed: int
) -> list[TransientCapture]:
    """Return two independent halves of the photons; the capture itself if it does not count any."""
    if not counts_photons(capture):
        return [light]
    counts = capture.H.astype(np.int64)
    first = np.random.default_rng(seed).binomial(counts, 0.5)
    # the background is subtracted in equal parts, and the same bins are 0
    surplus = 0.5 * (light.H - counts)
    kept = light.H != 0.0
    return [
        replace(light, H=np.where(kept, half + surplus, 0.0)) for half in (first, counts - first)
    ]


def _sum(images: list[PhasorImage]) -> PhasorImage:
    """Return the image of all photons: the fields of the halves add."""
    field = images[0].field if len(images) == 1 else images[0].field + images[1].field
    intensity = field.real**2 + field.imag**2
    seconds = sum(image.seconds for image in images)
    return replace(images[0], field=field, intensity=intensity, seconds=seconds)


def _depths(image: PhasorImage, images: list[PhasorImage]) -> DepthMap:
    """Return the depths of an image, and the agreement of its halves at each depth."""
    depths = depth_map(image, threshold=AMPLITUDE**2)
    first, last = (one.field for one in (images[0], images[-1]))
    best = image.intensity.argmax(axis=0)[None]
    a, b = (np.take_along_axis(field, best, axis=0)[0] for field in (first, last))
    power = np.abs(a) ** 2 + np.abs(b) ** 2
    agreement = 2.0 * (a * b.conj()).real / np.where(power > 0.0, power, 1.0)
    noise = _depth_noise(image, first - last, np.isfinite(depths.depth))
    # light from beside a voxel comes later: letters F and O lie 1/40 wavelength off, rms
    error = np.hypot(noise, image.wl_mean / 40.0)
    return replace(depths, confidence=agreement.astype(np.float64), standard_error=error)


def _depth_noise(
    image: PhasorImage, noise: NDArray[np.complexfloating], seen: NDArray[np.bool_]
) -> Array:
    """Return the standard deviation of interpolated depths due to photon noise, (ny, nx), m.

    ``noise`` is the difference of the fields of both halves: it has the noise of their sum, without
    its signal. To first order, a depth changes by the real part of ``sum_j c_j noise_j/field_j``
    over the brightest plane and its neighbours, with c_j from the vertex of the parabola. The
    median over the cells ``seen`` gives the level of this noise, which is inversely proportional to
    the amplitude.
    """
    z = image.volume.z
    if len(z) < 3 or not seen.any():
        return np.full(seen.shape, np.nan)
    best = np.clip(image.intensity.argmax(axis=0), 1, len(z) - 2)
    planes = best + np.array([-1, 0, 1])[:, None, None]
    field, other = (np.take_along_axis(a, planes, axis=0)[:, seen] for a in (image.field, noise))
    light = np.log(np.abs(field) ** 2)
    bend = 2.0 * light[1] - light[0] - light[2]
    shift = 0.5 * (light[2] - light[0]) / bend
    slopes = np.stack([shift - 0.5, -2.0 * shift, shift + 0.5]) / bend
    changes = np.abs((2.0 * slopes * other / field).sum(axis=0)) * np.abs(field[1])
    # half of a squared modulus is that of a real part, and its mean the median over log(2)
    level = np.sqrt(0.5 * np.median(changes**2) / np.log(2.0)) * (z[1] - z[0])
    amplitude = np.sqrt(image.intensity.max(axis=0))
    return np.asarray(level / np.where(seen, amplitude, np.nan), dtype=np.float64)
