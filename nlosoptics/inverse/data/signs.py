"""Signs of a wrong image model in an object of least total variation, and their sum.

Each sign alone is also seen in right fits, so that no limit of its own would separate them. Their
weights are those of a logistic regression that tells answers of `tv_deconvolve` with a correlation
below 0.85 from those above 0.93; the offset lets the sum exceed 0 in 5 % of the latter. These are
mostly answers with a correlation of up to 0.97 whose model is wrong; of the fits with a right model
1 % are among them. In a cross-validation, 5 % of the wrong answers were called right at this share,
and still 1 % where a fifth of the right answers are doubted.
The constants were fitted by ``benchmarks/inverse/mismatches.py --fit``.

The sign "unsteady" is a parametric bootstrap: the fitted object is imaged with new noise by a point
spread that is wider than the model's, and fitted again. A fit to the model's own image would only
show what the noise changes. What blur and noise have hidden is missing from the object already; the
wider point spread takes about as much from what is left.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded on first use
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BORDER = 1 / 32  # width of the frame's edge, relative to the shorter side
_MOST_BORDER = 1.5  # brightness at the edge that counts fully, relative to the mean
# The residual's power over the noise's that right fits may leave; least power of the image's detail
# with which the rest is compared.
_EXCESS, _LEAST_EXCESS = 1.1, 1e-3
# Largest number of pixels a side, and reach, of the object in which halos are sought.
_HALO_PIXELS, _HALO_REACH = 64, 8
# Share of the power below which dim parts are too faint for a halo to matter. In the tuning cases
# no answer below it was wrong.
_FAINT = 5e-3
# Brightness below which pixels are dim, relative to the brightest; quantile of the brightest.
_DIM, _BRIGHTEST = 0.25, 0.997
# Steps of the object, relative to its brightness, that do not count as soft.
_MOST_STEPS = 0.25
#: Width of the point spread of the second fit, relative to the model's.
WIDER = math.sqrt(2.0)
#: Correlation with the truth that an answer lacks, relative to the product of what the second fit
#: lacks of the answer and what a linear estimate lacks of an object, to the power of LACK_POWER.
LACK, LACK_POWER = 0.88, 2.0 / 3.0
_HALO_RIDGE = 0.01  # of the bright parts' power, for a stable fit


@dataclass(frozen=True)
class _Sign:
    """Weight of a sign, its mean over right fits, and the value that 95 % of them do not exceed.

    The sign "unexplained" adds nothing to the others and has no weight; 99 % of the right fits do
    not exceed its value.
    """

    weight: float
    mean: float
    usual: float
    words: str


_OFFSET = -8.100
# Sum for which half of the answers in the regression were wrong.
_EVEN = 0.763
SIGNS = {
    "grain": _Sign(
        11.682,
        0.110,
        0.203,
        "the object is grainy: {0:.2f} on a scale from 0 (few edges) to 0.79 (noise), usually "
        "below {1:.2f}",
    ),
    "soft": _Sign(
        10.074,
        -0.244,
        -0.199,
        "the object has soft edges: its steps are {0:.2f} of its brightness, usually more than "
        "{1:.2f}; the true point spread may be wider than the model's",
    ),
    "border": _Sign(
        2.398,
        0.147,
        0.557,
        "the object is {0:.2f} times as bright at the frame's edge as on average, usually below "
        "{1:.2f}: there is a veil (give background_shape) or light from outside the frame",
    ),
    "halo": _Sign(
        13.612,
        0.112,
        0.299,
        "{0:.2f} of the power of the dim parts is one halo around all bright parts that the image "
        "shows, usually below {1:.2f}: the true point spread has light that the model lacks",
    ),
    "dim": _Sign(
        10.769,
        0.029,
        0.087,
        "dim parts hold {0:.2g} of the object's power, usually below {1:.2g}",
    ),
    "unexplained": _Sign(
        0.000,
        0.001,
        0.010,
        "the fit does not explain {0:.2g} of the power of the image's detail, usually below "
        "{1:.2g}: the point spread, the camera's response or the background differs",
    ),
    "unsteady": _Sign(
        20.882,
        0.155,
        0.294,
        "a fit to the object's own image, with other noise and a wider point spread, gives another "
        "object: their distance is {0:.2f} (0 if equal, 1 if unrelated), usually below {1:.2f}; "
        "the noise hides detail (expose longer), or the point spread is another one",
    ),
}


def doubt(values: Mapping[str, float]) -> float:
    """Return the sum of the `signs`; an object for which it is positive is taken to be wrong."""
    return _OFFSET + sum(sign.weight * values[name] for name, sign in SIGNS.items())


def risk(values: Mapping[str, float]) -> float:
    """Return the probability of a correlation below 0.85, by the regression.

    It holds for as many answers below 0.85 as above 0.93, as in the cases of the regression.
    """
    return 1.0 / (1.0 + math.exp(min(_EVEN - doubt(values), 500.0)))


def as_if_steady(values: Mapping[str, float]) -> dict[str, float]:
    """Return the signs as if the object were no less steady than is usual."""
    return {**values, "unsteady": min(values["unsteady"], SIGNS["unsteady"].mean)}


def told(values: Mapping[str, float]) -> Iterator[str]:
    """Yield a sentence for each unusual sign, or for the strongest one, the heaviest first."""
    weights = {name: SIGNS[name].weight * (v - SIGNS[name].mean) for name, v in values.items()}
    order = sorted(weights, key=lambda name: -weights[name])
    unusual = [name for name in order if values[name] > SIGNS[name].usual]
    for name in unusual or order[:1]:
        sign = SIGNS[name]
        yield sign.words.format(abs(values[name]), abs(sign.usual))


def signs(
    level: Array, again: Array, *, residual: float, excess: float, passed: float = 1.0
) -> dict[str, float]:
    """Return the signs of a fit, whose weighted sum is `doubt`.

    Parameters
    ----------
    level : ndarray, (H, W)
        Fitted object, any unit, non-negative and not all zero.
    again : ndarray, (H, W)
        Object of a fit to an image of ``level`` with other noise and a wider point spread.
    residual : float
        Rms residual over the noise.
    excess : float
        Power of the image's detail over that of the noise.
    passed : float
        Share of the power of the object's detail that the optics pass, 0 to 1.

    Returns
    -------
    dict of str to float
        ``grain``: (mean |grad|)^2 / mean |grad|^2. ``soft``: minus the mean |grad|, weighted by
        itself, over the brightness, at least -0.25. ``border``: brightness at the frame's edge over
        the mean. ``halo``: share of the dim parts' power that one halo around all bright parts
        explains, times ``passed``, since deconvolution of a wide blur leaves halos in right objects
        too; less if ``dim`` is below 0.005. ``dim``: the dim parts' share of the object's power.
        ``unexplained``: the residual's power above the noise over ``excess``. ``unsteady``: square
        root of one minus the correlation of both objects, their distance.
    """
    steps = np.hypot(level - np.roll(level, 1, 0), level - np.roll(level, 1, 1))
    side = -(-max(level.shape) // _HALO_PIXELS)
    halo, dim = _halo(block_means(level, side))
    total, square = (max(float(part.mean()), 1e-300) for part in (steps, steps**2))
    return {
        "grain": total**2 / square,
        "soft": -min(square / total / _brightness(level), _MOST_STEPS),
        "border": min(border(level), _MOST_BORDER),
        "halo": passed * halo * min(dim / _FAINT, 1.0),
        "dim": dim,
        "unexplained": min(max(residual**2 - _EXCESS, 0.0) / max(excess, _LEAST_EXCESS), 1.0),
        "unsteady": math.sqrt(max(1.0 - _correlation(level, again), 0.0)),
    }


def expected_correlation(unsteady: float, share: float) -> float:
    """Return the correlation with the truth to expect of an answer if the model is right.

    Parameters
    ----------
    unsteady : float
        Distance of the second fit from the answer, one of the `signs`.
    share : float
        Expected correlation of a linear estimate of a typical object; see `Spectra.share`.

    Notes
    -----
    Both tell what blur and noise take from an object: the second fit from this object by the
    sharp estimate, the share from a typical object by a linear one. One minus the correlation
    scatters about the value from both by a factor of 1.7, about that from the second fit by 1.9.
    """
    lack: float = LACK * (unsteady**2 * (1.0 - share)) ** LACK_POWER
    return 1.0 - min(lack, 1.0)


def border(level: Array) -> float:
    """Return the mean of an object at the frame's edge over that of the whole frame."""
    width = max(1, round(_BORDER * min(level.shape)))
    inside = level[width:-width, width:-width]
    return float((level.sum() - inside.sum()) / (level.size - inside.size) / level.mean())


def _brightness(object_: Array) -> float:
    """Return the brightness that only the brightest 0.3 % of the pixels exceed."""
    return float(np.quantile(object_, _BRIGHTEST)) or float(object_.max())


def _correlation(one: Array, other: Array) -> float:
    """Return the Pearson correlation of two objects, 0 if either is uniform."""
    a, b = one - one.mean(), other - other.mean()
    return float((a * b).sum()) / max(math.sqrt(float((a**2).sum() * (b**2).sum())), 1e-300)


def _halo(object_: Array) -> tuple[float, float]:
    """Return how much of the dim parts one halo explains, and their share of the power.

    The halo h minimises ``|dim - h * bright|^2 + ridge |h|^2`` over all h within `_HALO_REACH`
    pixels, with the convolution ``*``. A blur that the model lacks leaves such a halo.
    """
    bright = np.where(object_ > _DIM * _brightness(object_), object_, 0.0)
    dim = object_ - bright
    grid = tuple(scipy.fft.next_fast_len(n + 2 * _HALO_REACH, real=True) for n in object_.shape)
    spectrum, rest = scipy.fft.rfft2(bright, grid), scipy.fft.rfft2(dim, grid)
    own = scipy.fft.irfft2(np.abs(spectrum) ** 2, grid)
    shared = scipy.fft.irfft2(spectrum.conj() * rest, grid)
    axis = np.arange(-_HALO_REACH, _HALO_REACH + 1)
    y, x = (part.ravel() for part in np.meshgrid(axis, axis, indexing="ij"))
    near = np.hypot(y, x) <= _HALO_REACH
    y, x = y[near], x[near]
    matrix = own[y[:, None] - y, x[:, None] - x]
    power, target = float((dim**2).sum()), shared[y, x]
    if power == 0.0 or own[0, 0] == 0.0:
        return 0.0, 0.0
    ridge = _HALO_RIDGE * own[0, 0] * np.eye(len(y))
    halo = np.linalg.solve(matrix + ridge, target)
    explained = float(halo @ (2.0 * target - matrix @ halo))
    return explained / power, power / float((object_**2).sum())


def block_means(values: Array, side: int) -> Array:
    """Return the means of an image over square blocks of at most ``side`` pixels along each side.

    Rows and columns that do not fill a block are left out.
    """
    high, wide = (min(side, n) for n in values.shape)
    rows, columns = values.shape[0] // high, values.shape[1] // wide
    whole = values[: rows * high, : columns * wide]
    return np.asarray(whole.reshape(rows, high, columns, wide).mean(axis=(1, 3)))
