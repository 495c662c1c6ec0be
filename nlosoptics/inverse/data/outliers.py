"""Dead and hot pixels: which pixels of an image no object through the optics can make."""

from __future__ import annotations

import math

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

from .arrays import MEDIAN_OVER_SIGMA
from .models import expected_signal, half_weights, periodic_spectrum, squared

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Offsets of the pixels that are compared with a bad one, and which of them are its neighbours.
_Y, _X = (part.ravel() - 3 for part in np.indices((7, 7)))
_BESIDE = np.maximum(np.abs(_Y), np.abs(_X)) == 1


def noise_of_neighbours(values: Array) -> float:
    """Return the rms noise of an image, (H, W), from its second differences."""
    side = 12  # of a block, pixels
    # The mask (1, -2, 1) x (1, -2, 1) has norm 6.
    response = np.abs(np.diff(np.diff(values, n=2, axis=0), n=2, axis=1)) / 6.0
    counts = [max(1, length // side) for length in response.shape]
    sides = [length // count for length, count in zip(response.shape, counts, strict=True)]
    whole_blocks = response[: counts[0] * sides[0], : counts[1] * sides[1]]
    tiles = whole_blocks.reshape(counts[0], sides[0], counts[1], sides[1]).swapaxes(1, 2)
    blocks = tiles.reshape(counts[0] * counts[1], -1)
    medians = np.median(blocks, axis=1)
    squares = np.where(
        medians > 0.0, (medians / MEDIAN_OVER_SIGMA) ** 2, (blocks * blocks).mean(axis=1)
    )
    return math.sqrt(float(squares.mean()))


def lone_pixels(
    image: Array,
    passed: Array,
    sigma: float,
    least: Array | float = 0.0,
    *,
    masked: Mask | bool = False,
) -> tuple[Mask, Array]:
    """Return the mask (H, W) of dead and hot pixels, and the image with predictions in their place.

    ``image`` (H, W): image; single pixels may have any value. ``passed`` (H, W//2 + 1): squared
    modulus of the transfer function, from `passed_power`. ``sigma``: rms noise, image units, by an
    estimate that single pixels hardly affect. ``least`` (H, W): rms noise that is stated for each
    pixel, image units: no pixel within six of it is bad. ``masked`` (H, W): pixels that hold no
    measured value; they are not examined, and get predictions as well.

    The image is taken as a normal variable with the spectrum ``P = S + sigma^2``, where S is the
    `expected_signal` times 100. The deviation of a pixel from the mean of all others, in standard
    deviations, is then ``ifft(fft(image)/P)`` over ``sqrt(mean(1/P))``. A bad pixel deviates alone:

    - its deviation is the largest within 3 pixels and at least 6;
    - without the pattern that one pixel makes, ``ifft(1/P)``, or two adjacent ones, the deviations
      around it are smaller by a factor of six (median). Around edges that are sharper than the
      model allows they are not;
    - a point of an object that is as bright as the pixels around it deviates less. If the point
      spread is as narrow as a pixel, none is found. The frame's edge may cut such a point in half.

    Bad pixels are replaced by their predictions, and the search is repeated, since they hide others
    nearby. After the first round the limits of 6 become 4.5.
    """
    filled, shape = image.copy(), image.shape
    out = np.zeros(shape, dtype=bool) | masked  # of the predictions
    renewed = not out.any()
    twice, modulus = half_weights(shape), np.sqrt(passed)
    # of 262 144 pixels with normal noise, fewer than one in 1000 images deviates by 6
    limit, most = 6.0, max(1, image.size // 20)
    searched = sigma > 0.0 and min(shape) >= 8
    for _ in range(30 if searched else 0):
        spectrum = periodic_spectrum(filled, 5)
        signal = expected_signal(squared(spectrum) / image.size, passed, sigma**2, shape)
        share = sigma**2 / (100.0 * signal + sigma**2)
        share[0, 0] = 0.0
        if not renewed:  # means of the pixels around are worse than predictions
            filled, renewed = predicted(filled, out, spectrum, share), True
            # each prediction takes the noise of one frequency
            kept = 1.0 - out.sum() / float((twice * share).sum())
            sigma = noise_of_neighbours(filled) / math.sqrt(max(kept, 0.1))
            continue
        mean = float((twice * share).sum()) / image.size
        deviation = scipy.fft.irfft2(spectrum * share, shape) / (sigma * math.sqrt(mean))
        size = np.where(out, 0.0, np.abs(deviation))
        at = np.flatnonzero(size > limit)
        if len(at) > most:
            at = at[np.argpartition(size.ravel()[at], -most)[-most:]]
        row, column = np.unravel_index(at, shape)
        around = (row[:, None] + _Y) % shape[0], (column[:, None] + _X) % shape[1]
        left = _left(deviation[around], scipy.fft.irfft2(share, shape) / mean)
        # deviation of a point of the sharpest such optics, relative to the height of its image
        point = float((twice * share * modulus).sum() / (mean * (twice * modulus).sum()))
        own, change = size[row, column], size[row, column] * (sigma / math.sqrt(mean))
        found = own >= size[around].max(axis=1)
        found &= own > limit * np.maximum(left, 1.0)
        found &= change > limit * np.broadcast_to(least, shape)[row, column]
        inside = (row % (shape[0] - 1) > 0) & (column % (shape[1] - 1) > 0)
        # of an object's image; the frame's edge cuts images off
        most_change = np.where(inside, 2.0 * point, max(2.0 * point, 0.5))
        found &= change > most_change * np.ptp(filled[around], axis=1)
        if not found.any():
            break
        out[row[found], column[found]] = True
        filled = predicted(filled, out, spectrum, share)
        sigma, limit = noise_of_neighbours(filled), 4.5  # there are probably more
    return out & np.logical_not(masked), filled


def _left(near: Array, pattern: Array) -> Array:
    """Return the rms (n,) of deviations around n pixels, less the pattern of one bad pixel or two.

    ``near`` (n, 49) are the deviations, in the order of `_Y` and `_X`, and ``pattern`` (H, W) those
    around a bad pixel at [0, 0] whose own one is 1. The second pixel is the neighbour that deviates
    most once the pattern of the first is subtracted.
    """
    alone = pattern[_Y, _X]
    one = near - near[:, [len(_Y) // 2]] * alone
    second = np.argmax(np.where(_BESIDE, np.abs(one), 0.0), axis=1)[:, None]
    moved = pattern[_Y - _Y[second], _X - _X[second]]
    both = alone[second]
    two = one - np.take_along_axis(one, second, 1) / (1.0 - both**2) * (moved - both * alone)
    medians = [np.median(np.abs(rest), axis=1) for rest in (one, two)]
    return np.asarray(np.min(medians, axis=0) / MEDIAN_OVER_SIGMA)


def predicted(image: Array, bad: Mask, spectrum: NDArray[np.complex128], share: Array) -> Array:
    """Return an image with the values in the bad pixels that all the others predict.

    ``spectrum`` is that of the image, and ``share`` the reciprocal of the expected one. The errors
    of the given values are found by conjugate gradients.
    """
    errors = np.zeros(image.shape)
    rest = np.where(bad, scipy.fft.irfft2(spectrum * share, image.shape), 0.0)
    way, square = rest, float((rest**2).sum())
    for _ in range(15):
        changed = np.where(bad, scipy.fft.irfft2(scipy.fft.rfft2(way) * share, image.shape), 0.0)
        curvature = float((way * changed).sum())
        if curvature <= 0.0:  # nothing is left, or it is so faint that its square is zero
            break
        step = square / curvature
        errors += step * way
        rest = rest - step * changed
        before, square = square, float((rest**2).sum())
        way = rest + (square / before) * way
    return image - errors
