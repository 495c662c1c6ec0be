"""Saturated pixels of an image: those that a converter has clipped, and those of a full well.

A converter clips after all noise, so that many pixels have exactly the largest value of the image.
A full well clips before the noise of the readout, so that many pixels differ from one level by no
more than this noise. The first is certain evidence (`exact_plateau`); the second is also what an
object looks like that is bright and even (`noisy_plateau`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from .arrays import MEDIAN_OVER_SIGMA

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Order of the differences that measure noise, along both axes; their norm for unit noise is 70.
_ORDER = 4
_WIDTH = 1.0  # of the window that finds bright places, pixels
# Pixels whose differences give the noise: the brightest ones, and their least number.
_BRIGHTEST, _LEAST = 256, 32
# Share of neighbouring differences of opposite sign, above which they are noise. It is 0.80 for
# white noise, and below 0.5 for the image of any object that is blurred by a pixel or more.
_LEAST_OPPOSITE = 0.6
_LEAST_EQUAL = 3  # pixels
_FALSE_ALARMS = 1e-6  # images without saturation in which an exact plateau is found
_SURE = 1.5  # factor by which the noise may be overestimated
# Equal neighbours that white noise explains, relative to their expected share, and in addition.
_MOST_EQUAL, _EXTRA_EQUAL = 2.0, 0.05
_LEAST_NOISE = 0.6  # relative to the smallest step between values
_ROUNDING = 1e-6  # of the image's range: roundings in single precision are no noise
# Levels of a noisy plateau that are tried, noise sigmas below the brightest pixel.
_DEPTH, _STEP = 5.0, 0.1
_LEAST_NEAR = 6  # pixels
# Excess of the pixels near the level over twice those just below, in standard errors.
_LEAST_EXCESS = 4.0
_MOST_SATURATED = 0.5  # share of the pixels


class Plateau(NamedTuple):
    """Saturated pixels, their level, and the noise about it; both in the unit of the image.

    The level of pixels that the caller states is an array: it is the value of each of them.
    """

    mask: Mask
    level: float | Array
    sigma: float


def exact_plateau(image: Array, valid: Mask, most: float = math.inf) -> Plateau | None:
    """Return the pixels that a converter has clipped; None if there are none.

    Parameters
    ----------
    image : ndarray, (H, W)
        Image as it was recorded, without any background subtracted.
    valid : ndarray of bool, (H, W)
        Pixels that count. The others may have any value.
    most : float
        Largest noise that is stated, image units.

    Notes
    -----
    Noise of rms s spreads the values of pixels over several steps q of the converter. Of all pixels
    within 2 s below a value or above it, the share with exactly this value is then at most
    ``p = erf(q / (sqrt(8) s))``, whatever the object. The n pixels of the largest value are clipped
    if such a number has a probability below 1e-6 among those pixels, by Chernoff's bound. The noise
    is that of bright pixels whose surroundings have no pixel of the largest value, divided by 1.5
    for safety. If it is not seen there, is below 0.6 q or 1e-6 of the range, or does not make
    neighbours differ as white noise would, nothing is taken as clipped: without noise an object
    that is bright and even has a plateau too, images of few counts have equal pixels, and so have
    images with repeated pixels.
    """
    low, top = float(image[valid].min()), float(image[valid].max())
    full = valid & (image == top)
    n_full = int(np.count_nonzero(full))
    if n_full < _LEAST_EQUAL:
        return None
    sigma, equal = _bright_noise(image, full | ~valid)
    bright = image[valid & (image >= 0.5 * (top + low))]
    levels = np.unique(bright)
    if len(levels) < 2:
        return None
    step = float(np.diff(levels).min())
    sigma = min(sigma, most)
    if sigma < max(_LEAST_NOISE * step, _ROUNDING * (top - low)):
        return None
    if equal > _MOST_EQUAL * math.erf(step / (4.0 * sigma)) + _EXTRA_EQUAL:
        return None
    n_near = int(np.count_nonzero(bright >= top - 2.0 * sigma))
    share = math.erf(step * _SURE / (math.sqrt(8.0) * sigma))
    if _log_chance(n_full, n_near, share) > math.log(_FALSE_ALARMS):
        return None
    return Plateau(full, top, 0.0)


def noisy_plateau(image: Array, valid: Mask) -> Plateau | None:
    """Return pixels that a full well may have clipped; None if there are none.

    Parameters
    ----------
    image : ndarray, (H, W)
        Image as it was recorded, without any background subtracted.
    valid : ndarray of bool, (H, W)
        Pixels that count. The others may have any value.

    Notes
    -----
    For a level L and noise s, the number of pixels above ``L - s`` is compared with the number
    between ``L - 3 s`` and ``L - s``: in a plateau it is five times as large. Levels are tried from
    the brightest pixel down, by 5 s. The best one counts if the first number exceeds twice the
    second by four standard errors; smooth peaks have about equal numbers. The mask contains all
    pixels above L, and those where the image exceeds ``L - s`` once it is smoothed.
    """
    sigma, _ = _bright_noise(image, ~valid)
    if sigma == 0.0:
        return None
    values = np.sort(image[valid])
    levels = values[-1] - sigma * np.arange(_STEP, _DEPTH, _STEP)
    below, far = (np.searchsorted(values, levels - part * sigma) for part in (1.0, 3.0))
    near, beside = len(values) - below, below - far
    excess = np.where(near >= _LEAST_NEAR, near - 2.0 * beside, 0.0) / np.sqrt(near + 4.0 * beside)
    best = int(np.argmax(excess))
    if excess[best] < _LEAST_EXCESS:
        return None
    level = float(levels[best])
    filled = np.where(valid, image, float(values.mean()))
    mask = valid & (
        (scipy.ndimage.gaussian_filter(filled, _WIDTH) > level - sigma) | (image > level)
    )
    return Plateau(mask, level, sigma) if mask.mean() < _MOST_SATURATED else None


def _bright_noise(image: Array, out: Mask) -> tuple[float, float]:
    """Return the rms noise of the brightest pixels, 0 if it is not seen, and how many are equal.

    The second number is the share of equal pixels among neighbours. Fourth differences along both
    axes are taken, in which a smooth image vanishes, without those that involve pixels that are
    ``out``. Of white noise, neighbouring differences mostly have opposite signs; of an image that
    the optics have blurred they have the same sign.
    """
    none = 0.0, 1.0
    if min(image.shape) <= _ORDER or out.all():
        return none
    filled = np.where(out, float(image[~out].mean()), image)
    inside = (slice(_ORDER // 2, -(_ORDER // 2)),) * 2
    bright = scipy.ndimage.gaussian_filter(filled, _WIDTH)[inside]
    usable: Mask = ~np.any(sliding_window_view(out, (_ORDER + 1,) * 2), axis=(2, 3))
    if np.count_nonzero(usable) > _BRIGHTEST:
        usable &= bright >= np.partition(bright[usable], -_BRIGHTEST)[-_BRIGHTEST]
    if np.count_nonzero(usable) < _LEAST:
        return none
    differences = np.diff(np.diff(filled, n=_ORDER, axis=0), n=_ORDER, axis=1)
    opposite = _share_of_neighbours(differences, usable, lambda one, other: one * other < 0.0)
    equal = _share_of_neighbours(filled[inside], usable, np.equal)
    if opposite < _LEAST_OPPOSITE:
        return none
    sizes = np.abs(differences[usable]) / math.comb(2 * _ORDER, _ORDER)
    return float(np.median(sizes)) / MEDIAN_OVER_SIGMA, equal


def _share_of_neighbours(
    values: Array, usable: Mask, compare: Callable[[Array, Array], Mask]
) -> float:
    """Return the share of the pairs of usable neighbours that a comparison is true of."""
    true = [
        compare(one[1:], one[:-1])[both[1:] & both[:-1]]
        for one, both in ((values, usable), (values.T, usable.T))
    ]
    return float(np.concatenate(true).mean())


def _log_chance(count: int, trials: int, share: float) -> float:
    """Return Chernoff's bound of the logarithm of the probability of ``count`` or more successes.

    ``share`` is the probability of a success.
    """
    found = count / trials
    if found <= share:
        return 0.0
    rest = 0.0 if count == trials else (1.0 - found) * math.log((1.0 - found) / (1.0 - share))
    return -trials * (found * math.log(found / share) + rest)
