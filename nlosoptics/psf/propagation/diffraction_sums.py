"""Transfer-function and direct sums for the propagation between planes, with error bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import ducc0
import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from ..transform.mdft import chirp_pass
from ..window.grids import ComplexArray, Pass

Array = NDArray[np.float64]

#: Relative error of the sums apart from those that are estimated.
ROUNDING: Final = 1e-11
#: Distance of the band limit's centre from the farthest needed ray, in Fresnel widths sqrt(S)
#: with S = ds/df. Both the diffraction at the soft limit and its replicas are then below 1e-11.
MARGIN: Final = 4.0
#: Largest FFT, whose arrays fit into no memory.
LARGEST: Final = 2.0**40


@dataclass(frozen=True)
class Axis:
    """Samples of the field and of the output along one axis.

    Parameters
    ----------
    first, n : int
        Index of the first sample, counted from the axis, and number of samples.
    dx : float
        Distance between samples, m.
    count : int
        Number of output samples; sample ``count//2`` is on the axis.
    pitch : float
        Distance between output samples, m.
    """

    first: int
    n: int
    dx: float
    count: int
    pitch: float

    @property
    def reach(self) -> float:
        """Largest distance between an input and an output sample, m."""
        low, high = self.first * self.dx, (self.first + self.n - 1) * self.dx
        below = -(self.count // 2) * self.pitch
        return max(high - below, below + (self.count - 1) * self.pitch - low)

    @property
    def same(self) -> bool:
        """Whether the output samples coincide with samples of the input lattice."""
        return abs(self.pitch / self.dx - 1) < 1e-12

    def indices(self) -> Array:
        """Return the indices of the input samples, counted from the axis, (n,)."""
        return np.arange(self.first, self.first + self.n, dtype=np.float64)


class Spectrum:
    """Energy of a sampled field at each spatial frequency, as a fraction of the total energy.

    Parameters
    ----------
    samples : ndarray, (ny, nx)
        Complex amplitudes.
    dx : float
        Pitch of the samples, m.
    pad : bool
        Whether to add zeros up to at least twice the extent, which samples the spectrum more
        finely; False for a periodic field.
    """

    def __init__(self, samples: ComplexArray, dx: float, pad: bool) -> None:
        sizes = [int(ducc0.fft.good_size(max(2 * n, 256))) if pad else n for n in samples.shape]
        waves = np.zeros(sizes, dtype=np.complex128)
        waves[: samples.shape[0], : samples.shape[1]] = samples
        energy = np.abs(ducc0.fft.c2c(waves, nthreads=1)) ** 2
        self.energy: Array = energy / energy.sum()
        self.nyquist = 0.5 / dx
        fy, fx = (np.fft.fftfreq(n, dx).astype(np.float64) for n in sizes)
        self.frequency: tuple[Array, Array] = (fy[:, None], fx[None, :])

    @cached_property
    def edge(self) -> tuple[float, float]:
        """Largest energy per frequency along y and x in the outer tenth of the band, m."""
        found = []
        for k, f in enumerate(self.frequency):
            lines = self.energy.sum(axis=1 - k)[np.abs(f.ravel()) > 0.9 * self.nyquist]
            found.append(float(lines.max()) / (2 * self.nyquist / f.size))
        return found[0], found[1]


def transfer(fy: Array, fx: Array, wavelength: float, z: float, paraxial: bool) -> ComplexArray:
    """Return the transfer function over a distance z >= 0 without its factor exp(ikz).

    It is ``exp(ikz (root - 1))`` with ``root = sqrt(1 - (lambda f)^2)``, or the parabola of the
    Fresnel approximation, on frequencies fy (ky, 1) and fx (1, kx), 1/m.
    """
    turns = -2j * math.pi * wavelength * z
    if paraxial:
        return np.asarray(np.exp(turns / 2 * fy**2) * np.exp(turns / 2 * fx**2))
    return np.asarray(np.exp(turns * (fy**2 + fx**2) / (1 + _root(fy, fx, wavelength))))


def _root(fy: Array, fx: Array, wavelength: float) -> Array:
    """Return the cosine of each plane wave's angle with z; complex if a wave is evanescent."""
    square = 1 - wavelength**2 * (fy**2 + fx**2)
    return np.asarray(np.sqrt(square if square.min() >= 0 else square.astype(np.complex128)))


@dataclass(frozen=True)
class Band:
    """Frequencies along one axis at which a transfer function is summed.

    Parameters
    ----------
    axis : Axis
        Input and output samples.
    limit : float
        Displacement of rays at which the soft band limit has its centre, m.
    width : float
        Width of the soft band limit, m.
    period : int
        Number of input samples after which the sum repeats; odd, so that the band is symmetric.
    count : int
        Number of frequencies, odd.
    tail : float
        Bound of the relative error from the sharp edge of the sampled band.
    """

    axis: Axis
    limit: float
    width: float
    period: int
    count: int
    tail: float

    @property
    def f(self) -> Array:
        """Frequencies (count,), 1/m."""
        return (np.arange(self.count) - self.count // 2) / (self.period * self.axis.dx)


def is_near(reach: float, wavelength: float, z: float) -> bool:
    """Whether a distance is so short that a band limit would be wider than the output.

    The rays from all of the input to all of the output are then almost parallel to the planes.
    """
    limit, _ = _soft_limit(reach, math.inf, wavelength, z)
    return 0 < z < reach and limit > 5 * reach


def band(
    axis: Axis,
    edge: float,
    wavelength: float,
    z: float,
    paraxial: bool,
    tol: float,
    near: float = 0.0,
) -> Band:
    """Choose the frequencies of a transfer-function sum along one axis.

    Waves of a frequency f are displaced by ``s(f)``. Those displaced by more than the reach of
    the output never arrive there, and are removed by a soft band limit (Matsushima & Shimobaba
    2009 have a hard one). The sum repeats with a period that is long enough for all that remains
    to miss the window.

    Parameters
    ----------
    axis : Axis
        Input and output samples.
    edge : float
        Energy per frequency at the band's edge, from `Spectrum.edge`, m.
    wavelength, z : float
        Wavelength and distance, at least 0, m.
    paraxial : bool
        Whether the kernel is that of the Fresnel approximation.
    tol : float
        Largest relative error from waves at the sharp edge of the sampled band.
    near : float
        Reach, m, if `is_near`: there is no limit then, and evanescent waves are kept. 0 otherwise.

    Returns
    -------
    Band
    """
    nyquist, reach = 0.5 / axis.dx, axis.reach
    sine = wavelength * nyquist
    nearest = farthest = z * sine
    if not paraxial and z > 0:  # along the band's edge, from its middle to the corner
        nearest = z * sine / math.sqrt(1 - sine**2) if sine < 1 else math.inf
        farthest = z * sine / math.sqrt(1 - 2 * sine**2) if 2 * sine**2 < 1 else math.inf
    limit, spread = _soft_limit(reach, 0.0 if paraxial else farthest, wavelength, z)
    gap = MARGIN * spread
    # Waves at the sharp edge of the sampled band leave tails ~ 1/(distance from their ray), at
    # both ends of the window.
    strength = math.sqrt(2 * axis.count * axis.pitch * edge) / math.pi
    if near > 0 and farthest > 2 * near:
        decay = math.exp(-2 * math.pi * z / wavelength * math.sqrt(max(sine**2 - 1, 0.0)))
        period = _odd_size(max(4 * near / axis.dx, axis.n))
        return Band(axis, math.inf, 1.0, period, period, decay * strength / (2 * near))
    if strength == 0 or (axis.same and z == 0):  # the samples themselves, one period apart
        tail, gap = 0.0, max(gap, axis.dx)
    elif farthest < limit + gap:
        # The tails repeat. On the lattice those of opposite edges cancel up to the difference
        # of their distances. A longer period helps, within reason.
        half = farthest if axis.same else 0.0
        need = 2 * half * strength if axis.same else strength
        enough = math.sqrt(half**2 + need / tol) - half if axis.same else need / tol
        gap = max(gap, min(enough, 4 * reach + farthest))
        tail = need / (gap * (gap + 2 * half)) if axis.same else need / gap
    else:  # removed, or within the soft limit
        tail = strength / max(gap, nearest - reach)
    last = min(farthest, limit + MARGIN * spread)
    period = _odd_size(max((reach + last + gap) / axis.dx, axis.n))
    highest = nyquist
    if last < farthest:
        highest = last / (wavelength * (z if paraxial else math.hypot(z, last)))
    count = min(period, 2 * math.ceil(highest * period * axis.dx) + 1)
    return Band(axis, limit, spread / math.sqrt(math.pi), period, count, tail)


def _soft_limit(reach: float, farthest: float, wavelength: float, z: float) -> tuple[float, float]:
    """Return the displacement at the centre of the band limit, and the Fresnel width there, m.

    ``farthest`` bounds the displacements from which the slope of rays is taken; 0 if paraxial.
    """
    limit, spread = reach, 0.0
    for _ in range(2):
        slope = min(limit, farthest) / z if z > 0 else 0.0
        spread = math.sqrt(wavelength * z * (1 + slope**2) ** 1.5)
        limit = reach + MARGIN * spread
    return limit, spread


def _odd_size(least: float) -> int:
    """Return an odd FFT size of at least ``least``."""
    size = int(ducc0.fft.good_size(math.ceil(min(least, LARGEST))))
    while size % 2 == 0:
        size = int(ducc0.fft.good_size(size + 1))
    return size


def by_transfer(
    samples: ComplexArray, bands: tuple[Band, Band], wavelength: float, z: float, paraxial: bool
) -> ComplexArray:
    """Propagate by a product with the transfer function.

    Parameters
    ----------
    samples : ndarray, (ny, nx)
        Complex amplitudes.
    bands : (Band, Band)
        Frequencies along y and x.
    wavelength, z : float
        Wavelength and distance, at least 0, m.
    paraxial : bool
        Whether to use the Fresnel approximation.

    Returns
    -------
    ndarray
        Output samples without the factor exp(ikz), complex.
    """
    ahead, back = zip(*map(_transfer_passes, bands), strict=True)
    waves = _along_both(samples, *ahead)
    fy, fx = bands[0].f[:, None], bands[1].f[None, :]
    root = np.ones(()) if paraxial else _root(fy, fx, wavelength)
    waves *= transfer(fy, fx, wavelength, z, paraxial)
    real = root.real
    for f, b in zip((fy, fx), bands, strict=True):
        sine = wavelength * np.abs(f)
        # 6 widths: erfc has decayed to 2e-17
        if b.limit < math.inf and np.max(sine) * z > np.min(real) * (b.limit - 6 * b.width):
            place = z * sine / np.maximum(real, 1e-9)
            waves *= 0.5 * erfc((place - b.limit) / b.width)
    return _along_both(waves, *back) / (bands[0].period * bands[1].period)


def _transfer_passes(b: Band) -> tuple[Pass, Pass]:
    """Return the transforms to the frequencies of a band and from them to the output."""
    a = b.axis
    return (
        dft(a.n, -a.first, b.count, 1 / b.period),
        dft(b.count, b.count // 2, a.count, -a.pitch / (a.dx * b.period)),
    )


def by_impulse(
    samples: ComplexArray, axes: tuple[Axis, Axis], wavelength: float, z: float
) -> ComplexArray:
    """Propagate by the Fresnel integral as a sum over the samples.

    Parameters
    ----------
    samples : ndarray, (ny, nx)
        Complex amplitudes.
    axes : (Axis, Axis)
        Input and output samples along y and x.
    wavelength, z : float
        Wavelength and distance, above 0, m.

    Returns
    -------
    ndarray
        Output samples without the factor exp(ikz), complex.
    """
    scale = wavelength * z
    before, after, passes = [], [], []
    for a in axes:
        out = (np.arange(a.count) - a.count // 2) * a.pitch
        before.append(np.exp(1j * math.pi / scale * (a.indices() * a.dx) ** 2))
        after.append(np.exp(1j * math.pi / scale * out**2) * a.dx / np.sqrt(1j * scale))
        passes.append(dft(a.n, -a.first, a.count, a.dx * a.pitch / scale))
    field = _along_both(samples * before[0][:, None] * before[1], *passes)
    return np.asarray(field * after[0][:, None] * after[1])


def impulse_error(
    samples: ComplexArray, axis: Axis, along: int, edge: float, wavelength: float, z: float
) -> float:
    """Bound the relative error of the Fresnel sum along one axis due to the pitch of the input.

    Samples at a pitch dx have diffraction orders 1/dx apart. The bound is the energy of the two
    first orders whose rays reach the output, from the spectra of overlapping tiles of the field,
    and the tail of the sharp edge of the sampled band.

    Parameters
    ----------
    samples : ndarray, (ny, nx)
        Complex amplitudes.
    axis : Axis
        Input and output samples.
    along : int
        Array axis of the samples.
    edge : float
        Energy per frequency at the band's edge, from `Spectrum.edge`, m.
    wavelength, z : float
        Wavelength and distance, above 0, m.
    """
    scale = wavelength * z
    # tiles of a Fresnel width: position and landing point of their rays are equally uncertain
    hop = int(np.clip(2 * math.sqrt(scale) / axis.dx, 8, max(8, axis.n)))
    count = math.ceil(axis.n / hop) + 1  # Hann windows with half overlap, whose sum is 1
    lines = np.zeros((samples.shape[1 - along], (count + 1) * hop), dtype=np.complex128)
    lines[:, hop : hop + axis.n] = np.moveaxis(samples, along, -1)
    hann = np.sin(math.pi * (np.arange(2 * hop) + 0.5) / (2 * hop)) ** 2
    frequency = np.fft.fftfreq(4 * hop, axis.dx)
    low = -(axis.count // 2) * axis.pitch
    high = low + (axis.count - 1) * axis.pitch
    folded = 0.0
    for tile in range(count):
        part = lines[:, tile * hop : (tile + 2) * hop] * hann
        energy = np.sum(np.abs(np.fft.fft(part, 4 * hop)) ** 2, axis=0) / (4 * hop)
        centre = (axis.first + tile * hop) * axis.dx
        for order in (-1, 1):
            land = centre + scale * (frequency + order / axis.dx)
            beyond = np.maximum(low - land, land - high) - hop * axis.dx
            folded += float(energy[beyond < math.sqrt(scale)].sum())
    gap = max(scale / (2 * axis.dx) - axis.reach, math.sqrt(scale))
    tail = math.sqrt(2 * axis.count * axis.pitch * edge) / (math.pi * gap)
    # neighbouring tiles overlap and may add up
    return math.sqrt(2 * folded / float(np.sum(np.abs(samples) ** 2))) + tail


def leak(beyond: Array, scale: float) -> Array:
    """Bound the relative amplitude in the window of waves whose rays miss it.

    Parameters
    ----------
    beyond : ndarray, any shape
        Distance by which the rays miss the window, m; negative if they do not.
    scale : float
        Wavelength times distance, m^2.
    """
    width = max(math.sqrt(scale), np.finfo(np.float64).tiny)
    return np.asarray(width / np.maximum(beyond, width), dtype=np.float64)


def dft(n: int, centre: int, count: int, step: float) -> Pass:
    """Return a function that maps rows g (rows, n) to ``sum_j g_j exp(-2 pi i j l step)``.

    j counts from ``centre``, and l from ``count//2`` of ``count`` samples. An FFT is used if the
    step is one over a suitable size, else a chirp-z transform.
    """
    size = round(1 / abs(step)) if step else 0
    if max(n, count) <= size <= 3 * (n + count) and abs(size * abs(step) - 1) < 1e-12:
        into = (np.arange(n) - centre) % size
        out = (np.arange(count) - count // 2) % size

        def transform(rows: ComplexArray) -> ComplexArray:
            padded = np.zeros((rows.shape[0], size), dtype=np.complex128)
            padded[:, into] = rows
            ducc0.fft.c2c(padded, axes=(1,), forward=step > 0, out=padded, nthreads=1)
            return np.asarray(padded[:, out])

        return transform
    chirp = chirp_pass(n, centre, count, step, 0.0)
    phase = np.exp(-1j * math.pi * step * (np.arange(count) - count // 2) ** 2)
    return lambda rows: chirp(rows) * phase


def _along_both(values: ComplexArray, along_y: Pass, along_x: Pass) -> ComplexArray:
    """Transform the rows and then the columns of an array."""
    return np.ascontiguousarray(along_y(along_x(values).T).T)
