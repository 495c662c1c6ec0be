"""Image formed by mirror-like lobes: modulation and noise at every spatial frequency."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from .._checks import expect
from ..imaging.geometry import chief_rays, plane_coordinates
from ..scene import PlanarObject, Scene
from .relay import CELLS, CONTRAST

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class FitModel:
    """A total-variation fit as a filter, and the scatter of such fits about the prediction c.

    Values are fitted to the scenes of `benchmarks/inverse/feasibility.py --tune`.
    """

    # variance against which it weighs the signal and variance that it leaves, in units of the true
    # noise times grain^grain_power/sqrt(fill)
    smoothed: float = 5.7
    left: float = 1.3
    grain_power: float = 1.5
    weak_light: float = 0.024  # variance of image over noise below which both grow
    prior_power: float = 3.0  # power of the frequency by which the spectrum of such a fit falls
    spread: float = 0.06  # scatter over sqrt(1 - c^2)
    least_spread: float = 0.006  # scatter that is always added
    weak_spread: float = 0.04  # scatter in weak light
    weak_excess: float = 0.03  # variance of image over noise at which half of it is added


TV_FIT = FitModel()


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Mean noise variance of an image pixel by cause, electrons^2."""

    photons: float  # Shot noise of all light and of the dark current
    readout: float  # Noise of readout and analogue-to-digital converter
    speckle: float  # Variance of the speckle

    @property
    def variance(self) -> float:
        """Total variance, electrons^2."""
        return self.photons + self.readout + self.speckle

    def figures(self) -> dict[str, float]:
        """Return the rms noise of each cause and in total, electrons."""
        parts = {"photons": self.photons, "readout": self.readout, "speckle": self.speckle}
        return {name: math.sqrt(v) for name, v in {**parts, "total": self.variance}.items()}

    def exposed(self, factor: float) -> Noise:
        """Return the noise at ``factor`` times the exposure, for an unchanged signal.

        The signal and its noise are divided by the factor.
        """
        return Noise(
            photons=self.photons / factor, readout=self.readout / factor**2, speckle=self.speckle
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Picture:
    """Spectra of an expected image on a half-plane FFT grid."""

    # (rows, columns): Power spectrum of the unblurred image without its mean, electrons^2, averaged
    # over rings
    power: Array
    transfer: Array  # (rows, columns): Modulus of the transfer function
    frequency: Array  # (rows, columns): Spatial frequency on the object, cycles/m
    # (columns,): Multiplicity of each column of the half spectrum in the full spectrum, 1 or 2
    twice: Array
    grid: tuple[int, int]  # (int, int): Samples of the full spectrum along y and x
    samples: int  # Number of image pixels
    noise: Noise  # Noise of an image pixel
    # (mean |grad|)^2 / mean |grad|^2 of the unblurred image: small for few sharp edges
    grain: float
    fill: float  # (mean)^2 / mean square of the unblurred image: small for few bright pixels

    @property
    def excess(self) -> float:
        """Variance of the blurred image divided by that of the noise, averages over the image."""
        blurred = self.transfer**2 * self.power * self.twice
        varied = float(blurred.sum()) / math.prod(self.grid)
        noise = self.noise.variance * self.samples
        return varied / noise if noise > 0.0 else math.inf

    def score(self) -> float:
        """Return the predicted correlation between a fit and the true object.

        A fit of least total variation acts like a Wiener filter that does not know the object's
        power P, but expects one Q that falls as a power of the frequency and has the same gradients
        in the blurred image. With the signal's power S = H^2 Q, transfer H and a noise power N, it
        passes ``w = S/(S + N)``. With the noise power M that is left, the correlation is
        ``c = sum P w/sqrt(sum P sum w^2 (P + M/H^2))`` over all frequencies. N and M are the true
        noise times ``smoothed`` or ``left`` of `FitModel`, and ``grain^grain_power/sqrt(fill) (1 +
        weak_light/excess)``: the fewer edges an object has, the better total variation tells it
        from noise.
        """
        total = float((self.power * self.twice).sum())
        if total <= 0.0:
            return 0.0
        passed = self.transfer**2
        # one cycle in the frame, of which the grid is twice as wide
        lowest = 2.0 * float(self.frequency[0, 1])
        expected = (self.frequency**2 + lowest**2) ** (-TV_FIT.prior_power / 2)
        slopes = passed * self.frequency**2 * self.twice
        scale = float((slopes * self.power).sum()) / max(float((slopes * expected).sum()), 1e-300)
        # by Parseval, white noise has this power at each frequency of an unnormalised FFT
        noise = (
            self.noise.variance * self.samples * (1.0 + TV_FIT.weak_light / max(self.excess, 1e-30))
        )
        noise *= self.grain**TV_FIT.grain_power / math.sqrt(self.fill)
        signal = passed * scale * expected
        weight = signal / np.maximum(signal + TV_FIT.smoothed * noise, 1e-300)
        kept = float((self.power * weight * self.twice).sum())
        left = TV_FIT.left * noise * weight**2 / np.maximum(passed, 1e-300)
        power = float(((weight**2 * self.power + left) * self.twice).sum())
        return kept / math.sqrt(total * power) if power > 0.0 else 0.0

    def spread(self) -> float:
        """Return the expected error of `score`: at least 68 % of fits are within it."""
        strong = TV_FIT.spread * math.sqrt(max(1.0 - self.score() ** 2, 0.0)) + TV_FIT.least_spread
        return strong + TV_FIT.weak_spread / (1.0 + (self.excess / TV_FIT.weak_excess) ** 2)

    def with_noise(self, noise: Noise) -> Picture:
        """Return a copy with another noise."""
        return replace(self, noise=noise)

    def with_lobe(self, blur: float, *, instead: Array) -> Picture:
        """Return a copy in which the wall's lobe is replaced by a Gaussian one."""
        lobe = np.exp(-2.0 * (math.pi * blur * self.frequency) ** 2)
        return replace(self, transfer=instead * lobe)


def object_scale(scene: Scene) -> float:
    """Return the scale of the image: metres on the hidden object per metre on the detector.

    It is the inverse magnification at the middle of the object's image.

    Parameters
    ----------
    scene : Scene
        Scene to evaluate. For a flat wall, or a mesh as hidden object, the scale is that of a plane
        mirror. For a curved wall and a planar object, chief rays are traced, and the scale is the
        square root of the ratio of areas on object and detector.

    Returns
    -------
    float
        Scale, dimensionless.

    See Also
    --------
    feasibility : Predict what an image can show.
    nlosoptics.views.image : Camera image.

    Examples
    --------
    Side of an image pixel on the object, in millimetres:

    >>> import nlosoptics as nlos
    >>> from nlosoptics import limits
    >>> scene = nlos.Scene.load("examples/scenes/letter_flat.toml")
    >>> round(1e3 * limits.object_scale(scene) * scene.camera.image_pitch, 2)
    2.84
    """
    scene = expect("scene", scene, "Scene")
    depth = float(
        (scene.mirrored_object_point - np.array(scene.camera.position)) @ scene.camera.axis
    )
    flat = depth / scene.image_distance
    hidden = scene.hidden
    if scene.wall.is_flat or not isinstance(hidden, PlanarObject):
        return flat
    line = scene.mirrored_object_point - np.array(scene.camera.position)
    x, y, _ = (float(line @ axis) * scene.image_distance / depth for axis in scene.camera.frame)
    # a curved wall magnifies: differentiate coordinates on the object over the detector
    step = 1e-3 * scene.image_distance
    at = np.array([-step, 0.0, step])
    on_object = plane_coordinates(hidden, chief_rays(scene, -x + at, -y + at))
    turn = [(a[1, 2] - a[1, 0], a[2, 1] - a[0, 1]) for a in on_object]
    area = abs(turn[0][0] * turn[1][1] - turn[0][1] * turn[1][0])
    scale = math.sqrt(area) / (2 * step)
    return scale if math.isfinite(scale) and scale > 0.0 else flat


def spectra(ideal: Array, transfer: Array, pitch: float, noise: Noise) -> Picture:
    """Return power spectrum and transfer function of an expected image."""
    rows, columns = padded(ideal.shape)
    frequency = _frequencies((rows, columns), pitch)
    # a correlation ignores the mean, which would leak if the grid is wider than the frame
    varied = ideal - ideal.mean()
    return Picture(
        power=_ring_average(np.abs(scipy.fft.rfft2(varied, (rows, columns))) ** 2, frequency),
        transfer=transfer,
        frequency=frequency,
        twice=_twice(columns),
        grid=(rows, columns),
        samples=ideal.size,
        noise=noise,
        grain=_grain(ideal),
        fill=float(ideal.mean()) ** 2 / max(float((ideal**2).mean()), 1e-300),
    )


def padded(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return a grid of at least twice the rows and columns, on which light does not wrap around."""
    rows, columns = (scipy.fft.next_fast_len(2 * n, real=True) for n in shape)
    return rows, columns


def stroke_width(picture: Array, pixel: float) -> float:
    """Return the mean width of a picture's bright parts: twice their area over their perimeter.

    Returns the width, m; 0 for a dark picture.
    """
    bright = picture > 0.5 * float(picture.max(initial=0.0))
    if not bright.any():
        return 0.0
    padded = np.pad(bright, 1)
    sides = sum(int(np.count_nonzero(np.diff(padded.astype(np.int8), axis=i))) for i in (0, 1))
    # averaged over directions, an outline is 4/pi times as long when it follows pixel sides
    return 2.0 * int(bright.sum()) / (math.pi / 4 * sides) * pixel


def picture_modes(
    modulation: Array, frequency: Array, size: tuple[float, float], snr: float
) -> int:
    """Count the object's Fourier modes that an image with a given modulation shows above the noise.

    Returns the number of modes, counted as by `relay.count_modes` for a shift-invariant response.
    """
    longer = max(size)
    counts = [max(1, round(CELLS * side / longer)) for side in size]
    cycles = [np.fft.fftfreq(n) * n / side for n, side in zip(counts, size, strict=True)]
    radial = np.hypot(cycles[0][:, None], cycles[1])
    # Fourier transform of a square cell
    cell = np.sinc(cycles[0] * size[0] / counts[0])[:, None] * np.sinc(
        cycles[1] * size[1] / counts[1]
    )
    passed = np.interp(radial, frequency, modulation, right=0.0) * cell
    return int(np.count_nonzero(CONTRAST * snr / math.sqrt(math.prod(counts)) * passed > 1.0))


def _grain(image: Array) -> float:
    steps = np.hypot(image - np.roll(image, 1, axis=0), image - np.roll(image, 1, axis=1))
    return float(steps.mean()) ** 2 / max(float((steps**2).mean()), 1e-300)


def _frequencies(grid: tuple[int, int], step: float) -> Array:
    rows, columns = np.fft.fftfreq(grid[0], step), np.fft.rfftfreq(grid[1], step)
    return np.asarray(np.hypot(rows[:, None], columns))


def _twice(columns: int) -> Array:
    twice = np.full(columns // 2 + 1, 2.0)
    twice[0] = 1.0
    if columns % 2 == 0:
        twice[-1] = 1.0
    return twice


def _ring_average(power: Array, frequency: Array, rings: int = 64) -> Array:
    """Replace power by its mean over rings of equal width, which removes the object's details."""
    ring = np.minimum((frequency / frequency.max() * rings).astype(np.intp), rings - 1).ravel()
    count = np.maximum(np.bincount(ring, minlength=rings), 1)
    means = np.bincount(ring, weights=power.ravel(), minlength=rings) / count
    return np.asarray(means[ring].reshape(power.shape))
