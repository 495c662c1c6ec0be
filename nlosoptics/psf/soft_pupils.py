"""Image of a polar wave whose aberration and amplitude are polynomials, by its softened grid.

A polynomial goes on smoothly beyond the rim, so that a rim softened for the grid (`rims`) leaves no
error but the far tails of its kernel, and the pupil costs a few nanoseconds a cell. Image samples
farther apart than Nyquist's fold the grid before the transform instead of a longer transform.
"""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import ducc0
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from .._checks import fits_memory
from . import estimates, rims
from .fits import projection
from .nodes import frozen, polar_nodes
from .pixels import PixelRule
from .residuals import Residual
from .spectra import PolarSpectrum
from .windows import Window
from .zernikes import zernike, zernike_order

Array = NDArray[np.float64]
#: What `_pupil_kernels.rim_errors` takes of a wave, see `rim_of`.
Rim = tuple[float, float, Array, Array, float]

#: Highest degree taken; beyond, a polynomial swings too wildly outside the rim.
DEGREE = 10
#: Table points of a softened rim per cell: six of them interpolate it to 2e-15.
STEPS = 256
#: Most that the amplitude may fall below its largest.
UNEVEN = 0.3
#: Field error for the kernel's cut at `rims.REACH`, measured at half of it from 26 cells a radius
#: on; below, it grows with the fourth power, 5e-10 at 5 cells.
CUT = 1e-12
#: Least ``tol`` for single precision, and its field error: 1e-7 measured.
SINGLE, SINGLE_ERROR = 1e-4, 1e-6
#: Shares of a window's reach at which errors are looked up.
RINGS = np.linspace(0.0, 1.0, 17)
#: Cells beyond the rim, and radii and angles of circles, at which slopes are looked up there.
BEYOND = np.arange(1.5, rims.REACH, 3.0)
#: The same, and the share of a ray's light there, times cells a radius.
ZONES = np.stack(
    [BEYOND, 6.0 * np.exp(-((math.pi * rims.STEP * BEYOND) ** 2)) / (math.pi * BEYOND)], axis=1
)
CIRCLES = np.concatenate([np.linspace(1.0, 1.5, 11), [1.75, 2.0, 3.0, 5.0]])
ANGLES = 2 * math.pi * np.arange(24) / 24
#: Blocks a side of a window of which the strongest and the farthest samples are looked up.
BLOCKS = 8
#: Share of ``tol`` that a period is chosen for: what it leaves is only known with the image.
AIM = 0.5
#: Largest array that is kept for the next call.
WORKSPACE_BYTES = 2**22
#: Memory of a block of columns, few enough to stay in the cache.
BLOCK_BYTES = 2**19


_own = threading.local()


@dataclass(frozen=True, eq=False)
class SoftWave:
    """A wave as polynomials of u/R and v/R, ``sum c[i, j] (u/R)^i (v/R)^j``.

    Parameters
    ----------
    aberration : ndarray
        m.
    amplitude : ndarray
        Relative to the largest; of no terms where it is the same everywhere.
    misfit : float
        Largest error of the pupil function at a node, over the largest amplitude.
    strength : float
        Bound of the amplitude at the rims over its mean.
    """

    aberration: Array
    amplitude: Array
    misfit: float
    strength: float


def soft_wave(residual: Residual, tol: float) -> SoftWave | None:
    """Polynomials of a polar wave without its piston and tilt.

    None for a wave that is not polar, whose amplitude varies by more than `UNEVEN`, or of too high
    a degree for an intensity error of ``tol``.
    """
    wave = residual.wavefront
    if wave.layout != "polar" or not isinstance(residual.series, PolarSpectrum):
        return None
    rounding = 1e-14 * float(np.abs(residual.aberration).max())
    threshold = max(1e-3 * tol / residual.wavenumber, rounding)
    fit = _polynomial(residual.series, residual.aberration, wave.obscuration, threshold)
    if fit is None:
        return None
    misfit = residual.wavenumber * fit[1]
    if residual.is_uniform:
        return SoftWave(fit[0], np.empty((0, 0)), misfit, 1.0)
    amplitude = wave.amplitude / float(wave.amplitude.max())
    if float(amplitude.min()) < 1 - UNEVEN:
        return None
    series = PolarSpectrum(amplitude, wave.pupil_radius, wave.obscuration)
    even = _polynomial(series, amplitude, wave.obscuration, max(1e-3 * tol, 1e-14))
    if even is None:
        return None
    # the nodes' range, as far again beyond it, over a mean that is no less than its low end
    strength = (1 + UNEVEN) / (1 - UNEVEN)
    return SoftWave(fit[0], even[0], misfit + even[1], strength)


def _polynomial(
    series: PolarSpectrum, values: Array, obscuration: float, threshold: float
) -> tuple[Array, float] | None:
    """Powers of values on polar nodes and the most they err by; None where the degree is too high.

    ``series`` tells the degree, by its terms above the threshold.
    """
    radial, angular = series.degrees(threshold)
    degree = max(2 * radial + 1, angular)
    if degree > DEGREE:
        return None
    project, powers, basis = _projection(*values.shape, obscuration, degree)
    # einsum without BLAS: the same bits for any thread count
    heights = np.einsum("tp,p->t", project, values.ravel())
    left = values.ravel() - np.einsum("tp,t->p", basis, heights)
    return np.einsum("t,tij->ij", heights, powers), float(np.abs(left).max())


@lru_cache(maxsize=8)
def _projection(
    n_r: int, n_theta: int, obscuration: float, degree: int
) -> tuple[Array, Array, Array]:
    """Least-squares weights of the nodes for each Zernike term, its powers of u and v, its values.

    (terms, nodes), (terms, degree + 1, degree + 1), (terms, nodes); unit radius.
    """
    u, v, weights = (nodes.ravel() for nodes in polar_nodes(1.0, n_r, n_theta, obscuration))
    count = (degree + 1) * (degree + 2) // 2
    basis = np.array([zernike(j, np.hypot(u, v), np.arctan2(v, u)) for j in range(1, count + 1)])
    powers = np.array([_powers(j, degree) for j in range(1, count + 1)])
    return frozen(projection(basis, weights)), frozen(powers), frozen(basis)


def _powers(index: int, degree: int) -> Array:
    """Noll's Zernike polynomial as powers of u and v, (degree + 1, degree + 1)."""
    n, m = zernike_order(index)
    table = np.zeros((degree + 1, degree + 1))
    scale = math.sqrt((n + 1) * (1 if m == 0 else 2))
    for s in range((n - abs(m)) // 2 + 1):
        k = (n - abs(m)) // 2 - s  # r^(n - 2 s) = r^2k r^|m|
        height = (-1) ** s * math.comb(n - s, s) * math.comb(n - 2 * s, k)
        for a in range(k + 1):  # (u^2 + v^2)^k
            for b in range(abs(m) + 1):  # (u + iv)^|m|, its real or imaginary part
                if b % 2 == (m < 0):
                    place = 2 * a + abs(m) - b, 2 * (k - a) + b
                    sign = (-1) ** (b // 2)
                    table[place] += scale * height * sign * math.comb(k, a) * math.comb(abs(m), b)
    return table


@lru_cache(maxsize=16)
def _rim_table(radius: float) -> tuple[float, float, Array]:
    """Where a softened rim begins and ends, cells, and its values, two points wider each way."""
    disc = rims.SoftDisc(radius)
    r = np.abs(disc.low + (np.arange(math.ceil((disc.high - disc.low) * STEPS) + 6) - 2) / STEPS)
    place = (2 * r - disc.low - disc.high) / (disc.high - disc.low)
    table = chebyshev.chebval(place, disc.series)
    table.setflags(write=False)
    return disc.low, disc.high, table


def padded_size(residual: Residual, rim: Rim, samples: Window, tol: float) -> int:
    """Padded size, a fast one, whose period is expected to leave an error of `AIM` times ``tol``.

    The widest that is of any use where none does.
    """
    from . import _pupil_kernels

    unit, reach = residual.airy_unit, residual.rays.reach / residual.airy_unit
    far = RINGS * (math.hypot(*samples.reach_from(residual.shift)) / unit)
    # The spot's peak by its rms aberration or its spread, and what is left of it farther out.
    rms = residual.heights.rms * residual.wavenumber
    peak = max(math.exp(-(rms**2)), _densest(residual) * 4 / math.pi * unit**2)
    light = np.minimum(math.sqrt(peak), estimates.tail(np.maximum(far - reach, 0.0)))
    least = (max(samples.reach_from(residual.shift)) * 2 + samples.pitch) / unit
    widest = 6 * (least + reach) + 400
    periods = least * np.exp(np.arange(0.0, math.log(widest / least), 0.04))
    goal = AIM * tol * peak
    period = _pupil_kernels.least_period(periods, light, goal, far, *rim) or widest
    # multiples of four are transformed fastest
    return 4 * int(ducc0.fft.good_size(math.ceil(period * unit / samples.pitch / 4)))


def _densest(residual: Residual) -> float:
    """Largest density of the rays, 1/m^2, in bins of a tenth of their reach."""
    from . import _pupil_kernels

    rays, unit = residual.rays, residual.airy_unit
    side = max(rays.reach / 10, 1.25 * unit)
    x, y, energy = rays.x.ravel(), rays.y.ravel(), rays.energy.ravel()
    return float(_pupil_kernels.densest(x, y, energy, rays.reach, side)) / side**2


def rim_of(residual: Residual, wave: SoftWave) -> Rim:
    """What `_pupil_kernels.rim_errors` takes of a wave, in Airy units.

    To the error of the rim is added what leaks from beyond it, where a polynomial is steeper and
    the softened rim, its kernel cut at each of `BEYOND`, is weaker.
    """
    from . import _pupil_kernels

    pupil = residual.wavefront
    landing = np.stack([CIRCLES, CIRCLES])
    _pupil_kernels.steepest(wave.aberration, CIRCLES, ANGLES, landing[1])
    landing[1] *= 2 / pupil.wavelength
    # length of both rims over area
    edges = wave.strength / (1 - pupil.obscuration)
    return residual.rays.reach / residual.airy_unit, edges, ZONES, landing, rims.STEP


def _field_error(residual: Residual, rim: Rim, distance: Array, period: float) -> Array:
    """Bound of the field's error up to each of the rising distances from the tilt's point, m."""
    from . import _pupil_kernels

    unit = residual.airy_unit
    error = np.empty_like(distance)
    _pupil_kernels.rim_errors(distance / unit, period / unit, *rim, error)
    return error + CUT * max(1.0, 60 * unit / period) ** 4


def block_errors(
    residual: Residual, rim: Rim, window: Window, intensity: Array, period: float, half: float
) -> tuple[Array, Array]:
    """Largest intensity and bound of the field's error in blocks of a window, of one shape.

    ``half`` is half a pixel's side, m, whose far edge errs the most; 0 for points.
    """
    from . import _pupil_kernels

    ny, nx = window.shape
    strongest = np.empty((min(ny, BLOCKS), min(nx, BLOCKS)))
    far = np.empty_like(strongest)
    first = tuple(a - b for a, b in zip(window.first, residual.shift, strict=True))
    _pupil_kernels.block_maxima(intensity, first, window.pitch, strongest, far)
    far += math.sqrt(2) * half
    rings = RINGS * far.max()
    ring = np.minimum(np.searchsorted(rings, far), RINGS.size - 1)
    return strongest, _field_error(residual, rim, rings, period)[ring]


def n_bytes(
    residual: Residual, samples: Window, size: int, rule: PixelRule | None, single: bool
) -> float:
    """Peak memory of `intensity_in`: the columns, and rows of the image averaged over pixels."""
    rows = min(size, 2 * (math.ceil(radius_in_cells(residual, samples, size)) + rims.REACH) + 1)
    ny, nx = samples.shape
    image = 8.0 * ny * nx * (1.0 if rule is None else 4.0 / rule.factor)
    return (8.0 if single else 16.0) * rows * size + image + 2**26


def intensity_in(
    residual: Residual,
    wave: SoftWave,
    samples: Window,
    size: int,
    rule: PixelRule | None,
    single: bool,
) -> Array:
    """Image intensity in a window, 1 at the ideal peak.

    ``single`` transforms in single precision.
    """
    from . import _pupil_kernels

    pupil = residual.wavefront
    radius = radius_in_cells(residual, samples, size)
    centre = math.ceil(radius) + rims.REACH
    rows = min(size, 2 * centre + 1)
    fits_memory(
        f"the transform of {rows} x {size} samples",
        n_bytes(residual, samples, size, rule, single),
        "use a smaller shape",
    )
    found = [_rim_table(radius)]
    if pupil.obscuration > 0:
        found.append(_rim_table(pupil.obscuration * radius))
    lows, highs = (np.array([rim[i] for rim in found]) for i in (0, 1))
    width = max(rim[2].size for rim in found)
    tables = np.zeros((len(found), width))
    for row, rim in zip(tables, found, strict=True):
        row[: rim[2].size] = rim[2]
    turns = wave.aberration / pupil.wavelength
    side = math.copysign(1.0, pupil.image_distance)
    starts = [
        (first - shift) / samples.pitch
        for first, shift in zip(samples.first, residual.shift, strict=True)
    ]
    turns[1, 0] -= side * starts[0] / size * radius
    turns[0, 1] -= side * starts[1] / size * radius
    # Rows are u, so that the second transform gives rows of the image.
    values = _workspace("values", (rows, size), np.dtype("c8" if single else "c16"))
    values[...] = 0.0
    total = _pupil_kernels.soft_pupil(
        np.ascontiguousarray(turns.T),
        np.ascontiguousarray(wave.amplitude.T),
        1 / radius,
        lows,
        highs,
        float(STEPS),
        tables,
        centre,
        values[:, :rows],
    )
    return _intensity(values, samples.shape, side > 0, rule, 1 / total**2)


def _intensity(
    values: NDArray[np.complexfloating],
    shape: tuple[int, int],
    forward: bool,
    rule: PixelRule | None,
    scale: float,
) -> Array:
    """``scale`` |transform|^2 of columns (u) as long as the period, of rows (v) padded to the same.

    The first samples of the given shape, averaged over pixels when a rule is given; ``values`` is
    overwritten.
    """
    from . import _pupil_kernels

    size = values.shape[1]
    ny, nx = shape
    ducc0.fft.c2c(values, axes=(1,), forward=forward, out=values, nthreads=1)
    step = max(8, BLOCK_BYTES // (16 * size))
    # rows are averaged along as they come: the fine image need not fit the memory
    across = nx if rule is None else (nx - 2 * rule.margin) // rule.factor
    half = np.empty((ny, across))
    energy = np.empty((0 if rule is None else step, nx))
    padded = _workspace("padded", (step, size), values.dtype)
    for start in range(0, ny, step):
        part = padded[: min(step, ny - start)]
        _pupil_kernels.turned(values[:, start : start + step], part)
        ducc0.fft.c2c(part, axes=(1,), forward=forward, out=part, nthreads=1)
        if rule is None:
            _pupil_kernels.squares(part, scale, half[start : start + step])
            continue
        fine = energy[: len(part)]
        _pupil_kernels.squares(part, scale, fine)
        half[start : start + step] = rule.mean(fine)
    if rule is None:
        return half
    return rule.mean(np.ascontiguousarray(half.T)).T


def _workspace(name: str, shape: tuple[int, int], kind: np.dtype[Any]) -> NDArray[Any]:
    """Array of a thread's own, kept for the next call if small: new pages cost another pass."""
    need = shape[0] * shape[1] * kind.itemsize
    if need > WORKSPACE_BYTES:
        return np.empty(shape, dtype=kind)
    held = getattr(_own, name, None)
    if held is None or held.nbytes < need:
        held = np.empty(need, dtype=np.uint8)
        setattr(_own, name, held)
    return np.asarray(held[:need].view(kind).reshape(shape))


def radius_in_cells(residual: Residual, samples: Window, size: int) -> float:
    """Cells across the pupil's radius for a period of ``size`` samples."""
    pupil = residual.wavefront
    period = size * samples.pitch
    return pupil.pupil_radius * period / (pupil.wavelength * abs(pupil.image_distance))
