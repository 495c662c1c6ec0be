"""Error bars of metrics of a point spread that was drawn at random."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._nouns import Noun
from ..errors import SamplingError, SceneError
from .point_spreads import PointSpread

Array = NDArray[np.float64]
ALIKE = ("shape", "pitch", "normalisation", "wavelength", "f_number", "pixel_integrated")


@dataclass(frozen=True, eq=False, kw_only=True)
class MetricEstimate(Noun):
    """A metric of a mean point spread, known from so many patterns.

    Parameters
    ----------
    value : ndarray
        The metric of the mean of all patterns.
    standard_error : ndarray
        Of the value's shape: the standard deviation of the value over other such draws.
    n_patterns : int
    """

    value: Array
    standard_error: Array
    n_patterns: int


def metric_estimate(
    metric: Callable[[PointSpread], Any], patterns: Iterable[PointSpread]
) -> MetricEstimate:
    """Metric of the mean of independent patterns, with its standard error by the jackknife.

    Parameters
    ----------
    metric : callable
        Function of a point spread that returns a number or an array of them, such as
        ``lambda p: psf.encircled_energy(p, radii)``, `fwhm` or `centroid`.
    patterns : iterable of PointSpread
        Two or more, drawn independently on one grid, such as ``psf.sample_point_spread(scene,
        roughness, seed=s)`` for many s. Averages of several patterns do, if of equally many.

    Returns
    -------
    MetricEstimate

    Raises
    ------
    SceneError
        If there are fewer than two patterns, or they differ in grid or meaning.
    SamplingError
        If the metric is not finite.

    Notes
    -----
    ``s^2 = (n - 1)/n sum_i (t_i - mean t)^2``, t_i the metric of the mean of all patterns but the
    i-th [1]_. The true value lies within t standard errors as often as Student's t of n - 1
    degrees tells, for metrics that change smoothly with the image; one that jumps, as the width
    through the brightest pixel does from speckle to speckle, needs many patterns. What all patterns
    lack, such as light outside their window, no error bar tells, and a modulus such as `mtf` is too
    large where it sinks into its own error.

    References
    ----------
    .. [1] Efron and Stein, The jackknife estimate of variance, Ann. Stat. 9, 586 (1981).
    """
    drawn = list(patterns)
    n = len(drawn)
    if n < 2:
        raise SceneError(f"{n} patterns tell no error; draw two or more, with a seed each")
    for name in ALIKE:
        found = {getattr(pattern, name) for pattern in drawn}
        if len(found) > 1:
            raise SceneError(
                f"patterns differ in {name}, {sorted(found)[:2]}; draw all with the same options"
            )
    total = np.zeros(drawn[0].shape)
    energy = 0.0
    for pattern in drawn:
        total += pattern.intensity
        energy += pattern.enclosed_energy
    value = _measured(metric, drawn[0], total / n, energy / n)
    others = np.stack(
        [
            _measured(
                metric,
                pattern,
                (total - pattern.intensity) / (n - 1),
                (energy - pattern.enclosed_energy) / (n - 1),
            )
            for pattern in drawn
        ]
    )
    error = np.sqrt((n - 1) / n * np.sum((others - others.mean(axis=0)) ** 2, axis=0))
    return MetricEstimate(value=value, standard_error=np.asarray(error), n_patterns=n)


def _measured(
    metric: Callable[[PointSpread], Any], like: PointSpread, mean: Array, energy: float
) -> Array:
    spread = replace(like, intensity=mean, enclosed_energy=energy)
    value = np.asarray(metric(spread), dtype=np.float64)
    if not np.isfinite(value).all():
        raise SamplingError(f"the metric is {value}; give one that is finite for these patterns")
    return value
