"""The picture that mirror-like lobes make: its modulation and noise at every frequency."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..imaging import ForwardModel, SpeckleImage
from ..imaging.geometry import chief_rays, picture_coordinates
from ..psf import PointSpread
from ..scene import PlanarObject, Scene
from .relay import CELLS, CONTRAST

Array = NDArray[np.float64]

RINGS = 64  # of the object's power spectrum
#: Noise that a total-variation fit overcomes as a Wiener filter would overcome this share of it.
#: From fits of other scenes than those that `benchmarks/inverse/feasibility.py` reports.
NOISE_SHARE = 0.05
#: Standard errors, and variance times samples, of the mean squared residual that
#: `inverse.tv_deconvolve` holds against the noise that it estimates.
ERRORS, FREEDOM = 3.0, 18.0


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Mean noise of an image pixel, electrons^2, by cause.

    Parameters
    ----------
    photons : float
        Of all light and the dark current.
    readout : float
        Of readout and converter.
    speckle : float
    """

    photons: float
    readout: float
    speckle: float

    @property
    def variance(self) -> float:
        """Sum of all."""
        return self.photons + self.readout + self.speckle

    def figures(self) -> dict[str, float]:
        """Root mean squares by name, electrons."""
        parts = {"photons": self.photons, "readout": self.readout, "speckle": self.speckle}
        return {name: math.sqrt(v) for name, v in {**parts, "total": self.variance}.items()}

    def exposed(self, factor: float) -> Noise:
        """The same at ``factor`` times the exposure, in units of the light then collected."""
        return Noise(
            photons=self.photons / factor, readout=self.readout / factor**2, speckle=self.speckle
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Picture:
    """Spectra of an expected image.

    Parameters
    ----------
    power : ndarray, (rows, columns)
        |spectrum|^2 of the unblurred image less its mean, electrons^2, averaged over rings; half
        spectrum.
    transfer : ndarray, (rows, columns)
        |transfer| of the point spread.
    frequency : ndarray, (rows, columns)
        On the object, cycles/m.
    twice : ndarray, (columns,)
        How often each column of the half spectrum counts.
    grid : (int, int)
        Samples of the whole spectrum along y and x.
    samples : int
        Pixels of the image that carry noise.
    noise : Noise
    """

    power: Array
    transfer: Array
    frequency: Array
    twice: Array
    grid: tuple[int, int]
    samples: int
    noise: Noise

    def excess(self) -> float:
        """Variance of the blurred picture over that of the noise, means over the frame."""
        blurred = self.transfer**2 * self.power * self.twice
        varied = float(blurred.sum()) / math.prod(self.grid)
        noise = self.noise.variance * self.samples
        return varied / noise if noise > 0.0 else math.inf

    def score(self) -> float:
        """Predicted correlation of a fit with the truth.

        That of the Wiener filter whose noise is `NOISE_SHARE` of the true one: with P the object's
        power, sqrt(sum P w/sum P) over all frequencies, w = S/(S + N). 0 where a fit that
        estimates the noise cannot tell the picture from none: its mean squared residual then lies
        within `ERRORS` standard errors of the noise's.
        """
        if self.excess() < ERRORS * math.sqrt(FREEDOM / self.samples):
            return 0.0
        power = self.power * self.twice
        total = float(power.sum())
        if total <= 0.0:
            return 0.0
        signal = self.transfer**2 * self.power
        # a spectrum's noise has the variance of all samples together
        noise = NOISE_SHARE * self.noise.variance * self.samples
        passed = power * signal / (signal + noise)
        return math.sqrt(float(passed.sum()) / total)

    def with_noise(self, noise: Noise) -> Picture:
        """The same picture in other noise."""
        return replace(self, noise=noise)

    def with_lobe(self, blur: float, *, instead: Array) -> Picture:
        """The same picture by a lobe that blurs by ``blur`` m rms on the object.

        Parameters
        ----------
        blur : float
        instead : ndarray
            |transfer| without any lobe.
        """
        lobe = np.exp(-2.0 * (math.pi * blur * self.frequency) ** 2)
        return replace(self, transfer=instead * lobe)


def object_scale(scene: Scene) -> float:
    """Return metres on the hidden object per metre on the detector, at the middle of its image.

    Parameters
    ----------
    scene : Scene
        Scene. A mesh or a flat wall has the scale of a plane mirror; for a curved wall and a planar
        object the scale is that of traced chief rays, the root of the ratio of areas.

    Returns
    -------
    float
        Scale, dimensionless.

    Examples
    --------
    A pixel's side on the object, in millimetres:

    >>> import nlosoptics as nlos
    >>> from nlosoptics import limits
    >>> scene = nlos.Scene.load("examples/scenes/letter_flat.toml")
    >>> round(1e3 * limits.object_scale(scene) * scene.camera.image_pitch, 2)
    2.89
    """
    depth = float(
        (scene.mirrored_object_point - np.array(scene.camera.position)) @ scene.camera.axis
    )
    flat = depth / scene.image_distance
    hidden = scene.hidden
    if scene.wall.is_flat or not isinstance(hidden, PlanarObject):
        return flat
    line = scene.mirrored_object_point - np.array(scene.camera.position)
    x, y, _ = (float(line @ axis) * scene.image_distance / depth for axis in scene.camera.frame)
    # a curved wall magnifies: the picture's coordinates a little apart on the detector
    step = 1e-3 * scene.image_distance
    at = np.array([-step, 0.0, step])
    column, row = picture_coordinates(hidden, chief_rays(scene, -x + at, -y + at))
    rows, columns = hidden.reflectance.shape
    across, up = column * hidden.size[0] / columns, row * hidden.size[1] / rows
    turn = [(a[1, 2] - a[1, 0], a[2, 1] - a[0, 1]) for a in (across, up)]
    area = abs(turn[0][0] * turn[1][1] - turn[0][1] * turn[1][0])
    scale = math.sqrt(area) / (2 * step)
    return scale if math.isfinite(scale) and scale > 0.0 else flat


def spectra(image: SpeckleImage, spread: PointSpread, scale: float, noise: Noise) -> Picture:
    """Spectra of an image.

    Parameters
    ----------
    image : SpeckleImage
    spread : PointSpread
        At the image's pitch.
    scale : float
        Metres on the object per metre on the detector.
    noise : Noise
    """
    model = ForwardModel(spread, shape=image.ideal.shape)
    rows, columns = model.grid
    frequency = _frequencies(model.grid, image.pitch * scale)
    # the mean is no part of a correlation, and would leak where the grid is wider than the frame
    varied = image.ideal - image.ideal.mean()
    return Picture(
        power=_ring_average(np.abs(fft.rfft2(varied, s=model.grid)) ** 2, frequency),
        transfer=np.abs(model.transfer),
        frequency=frequency,
        twice=_twice(columns),
        grid=(rows, columns),
        samples=image.ideal.size,
        noise=noise,
    )


def stroke_width(picture: Array, pixel: float) -> float:
    """Mean width of a picture's bright parts: twice their area over their outline.

    Parameters
    ----------
    picture : ndarray, (rows, columns)
    pixel : float
        Side of its pixels on the object, m.

    Returns
    -------
    float
        m; parts are what is above half of the brightest, 0 where nothing is bright.
    """
    bright = picture > 0.5 * float(picture.max(initial=0.0))
    if not bright.any():
        return 0.0
    padded = np.pad(bright, 1)
    sides = sum(int(np.count_nonzero(np.diff(padded.astype(np.int8), axis=i))) for i in (0, 1))
    # an outline of any direction crosses 4/pi times its length in pixel sides
    return 2.0 * int(bright.sum()) / (math.pi / 4 * sides) * pixel


def picture_modes(
    modulation: Array, frequency: Array, size: tuple[float, float], snr: float
) -> int:
    """Modes of the object's cells above the noise by a picture with a given modulation.

    Parameters
    ----------
    modulation, frequency : ndarray, (n,)
        Of the picture, at rising frequencies, cycles/m.
    size : (float, float)
        Of the object, m.
    snr : float
        Root of the sum over the object's pixels of (electrons of white)^2 over the noise^2.

    Returns
    -------
    int
        As `relay_modes` counts them, for a response that is the same everywhere.
    """
    longer = max(size)
    counts = [max(1, round(CELLS * side / longer)) for side in size]
    cycles = [np.fft.fftfreq(n) * n / side for n, side in zip(counts, size, strict=True)]
    radial = np.hypot(cycles[0][:, None], cycles[1])
    # a cell is a square, whose transform falls as its sine
    cell = np.sinc(cycles[0] * size[0] / counts[0])[:, None] * np.sinc(
        cycles[1] * size[1] / counts[1]
    )
    passed = np.interp(radial, frequency, modulation, right=0.0) * cell
    return int(np.count_nonzero(CONTRAST * snr / math.sqrt(math.prod(counts)) * passed > 1.0))


def transfer_on(spread: PointSpread, grid: tuple[int, int]) -> Array:
    """|transfer| of a point spread, cut to a grid, at the grid's frequencies; half spectrum."""
    side = [min(n, m - 1 + m % 2) for n, m in zip(spread.shape, grid, strict=True)]
    cut = spread.intensity[
        tuple(
            slice(n // 2 - k // 2, n // 2 - k // 2 + k)
            for n, k in zip(spread.shape, side, strict=True)
        )
    ]
    return np.asarray(np.abs(fft.rfft2(cut, s=grid)))


def _frequencies(grid: tuple[int, int], step: float) -> Array:
    rows, columns = np.fft.fftfreq(grid[0], step), np.fft.rfftfreq(grid[1], step)
    return np.asarray(np.hypot(rows[:, None], columns))


def _twice(columns: int) -> Array:
    twice = np.full(columns // 2 + 1, 2.0)
    twice[0] = 1.0
    if columns % 2 == 0:
        twice[-1] = 1.0
    return twice


def _ring_average(power: Array, frequency: Array) -> Array:
    """Mean power over rings of equal width; the object's own phases and gaps do not count."""
    ring = np.minimum((frequency / frequency.max() * RINGS).astype(np.intp), RINGS - 1).ravel()
    count = np.maximum(np.bincount(ring, minlength=RINGS), 1)
    means = np.bincount(ring, weights=power.ravel(), minlength=RINGS) / count
    averaged = np.asarray(means[ring].reshape(power.shape))
    return averaged
