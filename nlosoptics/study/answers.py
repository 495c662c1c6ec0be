"""Answers from the results of a study: sensitivities, Sobol indices, yield."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # its parts are loaded lazily, on first use
from numpy.typing import NDArray

from .._checks import expect, in_range, real
from ..errors import SceneError
from .design.figures import Figure
from .results import Results

if TYPE_CHECKING:
    import xarray as xr

#: Figures of merit that are better if they are smaller.
SMALLEST_IS_BEST = ("aberration_rms", "spot_rms", "encircled_energy_radius")


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """Change of a figure of merit when one value of the scene changes.

    Changes are relative to the nominal scene, in which no value is changed.

    Parameters
    ----------
    case : str
        The changed value, by table and key of the scene file, such as "wall.radius = 4.9 m".
    value : float
        Figure of merit of the changed scene, in its unit; NaN if its computation failed.
    change : float
        Figure of merit of the changed scene minus that of the nominal scene, in its unit.
    resolved : bool
        Whether the change exceeds the numerical errors of both figures of merit, added in
        quadrature. Without such errors any change other than 0 is resolved. False if the
        computation failed.

    See Also
    --------
    sensitivities : All cases of a study.
    """

    case: str
    value: float
    change: float
    resolved: bool


def sensitivities(
    results: Results, figure: str, *, incomplete: bool = False
) -> tuple[Sensitivity, ...]:
    """Return how much each single change of the scene changes a figure of merit, largest first.

    Parameters
    ----------
    results : Results
        Results of a study with the table ``one_at_a_time`` and nothing else that varies. Each of
        its cases changes one value of the nominal scene.
    figure : str
        Name of the figure of merit.
    incomplete : bool
        Whether to accept results in which points are still to be computed. Their value is NaN,
        like that of failed cases.

    Returns
    -------
    tuple of Sensitivity
        One entry for each case, sorted by the magnitude of the change. Cases without a value come
        last.

    Raises
    ------
    SceneError
        If the study varies anything else, the computation for the nominal scene failed, or points
        are not computed yet and ``incomplete`` is False.

    See Also
    --------
    nlosoptics.views.tornado : Bars of the changes, sorted by size.
    """
    results = expect("results", results, "Results")
    names = [d.name for d in results.study.dimensions]
    if names != ["case"]:
        raise SceneError(
            f"sensitivities need a study with one_at_a_time alone, not one with "
            f"{', '.join(names)}; make one with that table"
        )
    values = results.values(figure, incomplete=incomplete)
    if not np.isfinite(values[0]):
        raise SceneError(
            f"{figure} of the nominal scene failed, so that no change is defined; choose a base "
            "scene in which it is known"
        )
    name = f"{figure}_error"
    errors = np.zeros_like(values)
    if name in results.dataset:
        errors = np.nan_to_num(results.dataset[name].values)
    labels = results.study.dimensions[0].labels()
    found = [
        Sensitivity(
            case=label,
            value=float(value),
            change=float(value - values[0]),
            resolved=bool(abs(value - values[0]) > np.hypot(error, errors[0])),
        )
        for label, value, error in list(zip(labels, values, errors, strict=True))[1:]
    ]
    return tuple(sorted(found, key=lambda s: -abs(s.change) if np.isfinite(s.change) else 1.0))


@dataclass(frozen=True, kw_only=True)
class Fraction:
    """Yield of a study: fraction of points that meet a specification, with confidence limits.

    The points are random variants (draws) of a scene. They meet the specification if a figure of
    merit lies within given limits.

    Parameters
    ----------
    value : float
        Yield, 0 to 1.
    low, high : float
        Ends of the confidence interval of the yield (Clopper-Pearson), at the confidence given to
        `fraction_within`.
    met : int
        Number of points that meet the specification.
    points : int
        Number of finished points.
    failed : int
        Number of finished points whose figure of merit is not finite. They do not meet the
        specification.

    See Also
    --------
    fraction_within : Fraction of points that meet a specification.
    """

    value: float
    low: float
    high: float
    met: int
    points: int
    failed: int


def fraction_within(
    results: Results,
    figure: str,
    *,
    at_least: float | None = None,
    at_most: float | None = None,
    confidence: float = 0.95,
    incomplete: bool = False,
) -> Fraction:
    """Return the yield: the fraction of random draws whose figure of merit lies within limits.

    A draw is a variant of the study's scene with random values, for example within tolerances.

    Parameters
    ----------
    results : Results
        Results of a study that varies the scene only by random draws (table ``draws``), with the
        method "random", "latin" or "sobol".
    figure : str
        Name of the figure of merit.
    at_least, at_most : float, optional
        Limits of the figure of merit, in its unit. Give one or both.
    confidence : float
        Confidence level of the interval, 0.01 to 0.9999.
    incomplete : bool
        Whether to accept results in which points are still to be computed. These are not counted.

    Returns
    -------
    Fraction
        Yield with its confidence interval and the numbers of points.

    Raises
    ------
    SceneError
        If the study varies the scene in another way, no limit is given, or points are not computed
        yet and ``incomplete`` is False.

    See Also
    --------
    Results : Results of a study.

    Notes
    -----
    The interval is that of Clopper and Pearson for independent draws (method "random"). It is wider
    than needed for Latin hypercubes. Draws of the method "sobol" fill the space more evenly, and
    their yield is more precise: the interval then follows from the yields of 16 runs of consecutive
    draws, by Student's distribution. The runs complement each other, so that this interval is wide
    enough for any figure of merit. If fewer than 80 draws meet the specification, or fail it, or
    the study is incomplete, it is that of independent draws.
    """
    results = expect("results", results, "Results")
    _check_draws(results, "a yield", ("random", "latin", "sobol"))
    if at_least is None and at_most is None:
        raise SceneError("at_least and at_most are both missing; give one or both")
    confidence = in_range("confidence", confidence, 0.01, 0.9999)
    low = -np.inf if at_least is None else real("at_least", at_least)
    high = np.inf if at_most is None else real("at_most", at_most)
    values = results.values(figure, incomplete=incomplete)
    sobol = results.study.definition["draws"].get("method", "sobol") == "sobol"
    status = results.dataset["status"].values.ravel()
    known = status != "pending"
    if not known.any():
        raise SceneError(f"{results.path} has no finished point; run the study first")
    values, sobol = values[known], sobol and bool(known.all())
    good = np.isfinite(values) & (low <= values) & (values <= high)
    met, count = int(good.sum()), len(values)
    share, ends = met / count, interval(good, confidence, sobol=sobol)
    return Fraction(
        value=share,
        low=ends[0],
        high=ends[1],
        met=met,
        points=count,
        failed=int((~np.isfinite(values)).sum()),
    )


def interval(
    good: NDArray[np.bool_], confidence: float, *, sobol: bool = False
) -> tuple[float, float]:
    """Return the confidence interval of the share of draws that are good."""
    met, count = int(good.sum()), len(good)
    if not sobol or min(met, count - met) < 80:
        return _exact(met, count, confidence)
    runs = good.reshape(16, -1).mean(axis=1)
    half = -float(scipy.special.stdtrit(len(runs) - 1, (1.0 - confidence) / 2))
    half *= float(runs.std(ddof=1)) / math.sqrt(len(runs))
    return max(met / count - half, 0.0), min(met / count + half, 1.0)


def _exact(met: int, count: int, confidence: float) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a share."""
    ends = scipy.stats.binomtest(met, count).proportion_ci(confidence, "exact")
    return float(ends.low), float(ends.high)


def smallest_is_best(figure: Figure) -> bool:
    """Return whether a figure of merit is better if it is smaller; False for a user's function."""
    return figure.source in SMALLEST_IS_BEST


def yields(results: Results, figure: str) -> tuple[NDArray[np.float64], tuple[Fraction, ...]]:
    """Return the yield against the limit over the range of a figure, finished points only."""
    values = results.values(figure, incomplete=True)
    good = values[np.isfinite(values)]
    if not len(good):
        raise SceneError(
            f"{figure} is known at no point, so that there is no curve to draw; run the study first"
        )
    limits = np.linspace(good.min(), good.max(), 200)
    key = "at_most" if smallest_is_best(results.study.figure(figure)) else "at_least"
    found = (
        fraction_within(results, figure, incomplete=True, **{key: float(limit)}) for limit in limits
    )
    return limits, tuple(found)


def sobol_indices(results: Results, figure: str, *, confidence: float = 0.95) -> xr.Dataset:
    """Return the Sobol indices of a figure of merit: which drawn values cause its variance.

    The first-order index of a value is the fraction of the variance that it causes alone. The total
    index also includes its interactions with other values.

    Parameters
    ----------
    results : Results
        Complete results of a study that varies the scene only by random draws (table ``draws``),
        with the method "saltelli".
    figure : str
        Name of the figure of merit.
    confidence : float
        Confidence level of the intervals, 0.01 to 0.9999.

    Returns
    -------
    xarray.Dataset
        Indices ``first`` and ``total``, with the ends of their confidence intervals ``first_low``,
        ``first_high``, ``total_low`` and ``total_high``. The dimension ``address`` names the drawn
        values by table and key of the scene file, such as "wall.radius".

    Raises
    ------
    SceneError
        If the study has another design, points are not computed yet, or the computation of the
        figure of merit failed at some point.

    See Also
    --------
    fraction_within : Fraction of points that meet a specification.

    Notes
    -----
    The estimators are those of Saltelli et al., Comput. Phys. Commun. 181, 259 (2010), as in
    `scipy.stats.sobol_indices`. The confidence intervals are bootstrap intervals.
    """
    results = expect("results", results, "Results")
    _check_draws(results, "Sobol indices", ("saltelli",))
    confidence = in_range("confidence", confidence, 0.01, 0.9999)
    values = results.values(figure)
    if failed := int((~np.isfinite(values)).sum()):
        raise SceneError(
            f"{figure} failed at {failed} of {len(values)} points, which leaves no complete "
            "design; narrow the distributions"
        )
    addresses = results.study.dimensions[0].addresses
    rows = values.reshape(-1, len(addresses) + 2)

    def statistic(chosen: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return first-order and total indices of some rows, (2, addresses)."""
        f_a, f_b, mixed = rows[chosen, 0], rows[chosen, 1], rows[chosen, 2:]
        parts: Any = {"f_A": f_a[None], "f_B": f_b[None], "f_AB": mixed.T[:, None]}
        found = scipy.stats.sobol_indices(func=parts, n=len(chosen))
        return np.stack([np.ravel(found.first_order), np.ravel(found.total_order)])

    every = np.arange(len(rows))
    best = statistic(every)
    interval = scipy.stats.bootstrap(
        (every,),
        statistic,
        n_resamples=999,
        confidence_level=confidence,
        method="percentile",
        vectorized=False,
        rng=np.random.default_rng(0),
    ).confidence_interval
    data = {}
    for i, name in enumerate(("first", "total")):
        for part, found in (("", best), ("_low", interval.low), ("_high", interval.high)):
            data[f"{name}{part}"] = ("address", np.asarray(found)[i])
    import xarray as xr  # here, so that a script's workers load without

    return xr.Dataset(data, {"address": list(addresses)})


def _check_draws(results: Results, what: str, methods: tuple[str, ...]) -> None:
    """Raise `SceneError` unless a study has draws of one of some methods and nothing else."""
    names = [d.name for d in results.study.dimensions]
    draws = results.study.definition.get("draws", {})
    method = draws.get("method", "sobol")
    if names != ["draw"] or method not in methods:
        told = f", drawn by {method}" if "draw" in names else ""
        raise SceneError(
            f"{what} needs a study with [draws] alone and method {' or '.join(methods)}; this one "
            f"has {', '.join(names)}{told}"
        )
