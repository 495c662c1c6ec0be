"""Metrics of a mean over independent patterns, with jackknife standard errors."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._nouns import Noun
from ...errors import SamplingError, SceneError
from ..transform.point_spread import PointSpread

Array = NDArray[np.float64]
ALIKE = ("shape", "pitch", "normalisation", "wavelength", "f_number", "pixel_integrated")


@dataclass(frozen=True, eq=False, kw_only=True)
class MetricEstimate(Noun):
    """Metric of the mean of several random point spreads, with its standard error.

    Parameters
    ----------
    value : ndarray
        Metric of the mean of all point spreads, in the shape that the metric has.
    standard_error : ndarray
        Standard error of ``value``, in the same shape: its estimated standard deviation if the
        point spreads were drawn again.
    n_patterns : int
        Number of random point spreads.

    See Also
    --------
    metric_estimate : Metric of a mean of independent patterns, with its error.
    """

    value: Array
    standard_error: Array
    n_patterns: int


def metric_estimate(
    metric: Callable[[PointSpread], Any], patterns: Iterable[PointSpread]
) -> MetricEstimate:
    """Evaluate a metric on the mean of random point spreads (speckle patterns), with an error bar.

    Parameters
    ----------
    metric : callable
        Function of a `PointSpread` that returns a number or an array, such as `fwhm`, `centroid` or
        ``lambda p: psf.encircled_energy(p, radii)``.
    patterns : iterable of PointSpread
        Two or more independent random point spreads with the same pitch, shape and normalisation,
        such as ``psf.sample_point_spread(scene, roughness, seed=s)`` for many s. Each may itself be
        a mean of random draws, if all are means of the same number of draws.

    Returns
    -------
    MetricEstimate
        Metric of the mean point spread, its standard error, and the number of patterns.

    Raises
    ------
    SceneError
        If there are fewer than two patterns, or their pitch, shape or normalisation differs.
    SamplingError
        If the metric is not finite.

    See Also
    --------
    sample_point_spread : PSF of one random rough wall.
    strehl : Strehl ratio on the axis.
    encircled_energy : Energy within circles.

    Notes
    -----
    The standard error s is the jackknife estimate [1]_:
    ``s^2 = (n - 1)/n sum_i (t_i - mean t)^2``, where n is the number of patterns and t_i the metric
    of the mean of all patterns except the i-th. If the metric is a smooth function of the image,
    the error of ``value`` divided by s follows Student's t distribution with n - 1 degrees of
    freedom. A metric that can jump needs many patterns. An example is `fwhm`: the brightest pixel,
    through which it is measured, may change from one speckle to another.

    The standard error does not include errors that all patterns share, such as energy outside the
    window. A modulus such as `mtf` is biased upward where it is not larger than its error.

    References
    ----------
    .. [1] Efron and Stein, The jackknife estimate of variance, Ann. Stat. 9, 586 (1981).
    """
    drawn = list(patterns)
    n = len(drawn)
    if n < 2:
        raise SceneError(
            f"a standard error needs at least 2 patterns, got {n}; draw more, each with its own "
            "seed"
        )
    for name in ALIKE:
        found = {getattr(pattern, name) for pattern in drawn}
        if len(found) > 1:
            raise SceneError(
                f"patterns differ in {name}: {sorted(found)[:2]}; draw all with the same options"
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
    """Evaluate the metric on a mean intensity (ny, nx) of the kind of the pattern ``like``."""
    spread = replace(like, intensity=mean, enclosed_energy=energy)
    value = np.asarray(metric(spread), dtype=np.float64)
    if not np.isfinite(value).all():
        raise SamplingError(
            f"the metric is {value}; give a metric that is finite for these patterns"
        )
    return value
