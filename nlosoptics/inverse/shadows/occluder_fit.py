"""Place of an occluder, and picture of the object whose light it shades on a matt wall."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from ..._checks import positive, whole
from ..._progress import Progress
from ...errors import SceneError
from ..data.arrays import real_array
from ..data.reconstruction import Reconstruction
from .linear_model import evidence, wall_image
from .shadow_fit import (
    LIMITS,
    Operator,
    checked_operator,
    checked_settings,
    fitted,
    settled,
)

Array = NDArray[np.float64]


def occluder_fit(
    image: Any,
    operator_at: Callable[[Array], Any],
    *,
    finer: Callable[[Array], Any] | None = None,
    start: ArrayLike = (0.0, 0.0, 0.0),
    reach: float = 0.05,
    cells: tuple[int, int] | None = None,
    noise: Any = None,
    reference: Any = None,
    ambient: int | None = None,
    brightest: float = math.inf,
    max_evaluations: int = 200,
    max_iterations: int = 1000,
    tolerance: float = 1e-3,
    progress: Progress | None = None,
) -> Reconstruction:
    """Find the place of an occluder of known shape on its own shadows, and reconstruct the object.

    Parameters
    ----------
    image, cells, noise, reference, ambient, brightest, max_iterations, tolerance
        See `shadow_fit`.
    operator_at : callable
        Returns the operator, see `shadow_fit`, for an array of the occluder's d unknown values,
        such as its shift in m: for a `nlosoptics.imaging.WallTransport` named ``wall``,
        ``lambda shift: wall.moved(0, shift)``. Few pixels and cells, such as 16 x 16 and 12 x 12,
        are quick, but their errors move the place by about a sixth of a cell.
    finer : callable, optional
        As ``operator_at``, for more pixels and cells, such as 32 x 32 and 16 x 16. The two best
        places are searched again with it, and the result is the better one. The result's ``place``
        can then be passed to `shadow_fit` with an operator for all pixels.
    start : array_like, (d,)
        Values at which the search starts.
    reach : float
        Distance from the start that the search covers first, in the unit of the values. It ends at
        twice this distance along each value.
    max_evaluations : int
        Maximum number of operators that each search computes.
    progress : callable(str, float), optional
        Called at each place with a line of text and the fraction, 0 to 1, of the largest number of
        places; searches mostly end after a small part of it.

    Returns
    -------
    Reconstruction
        As of `shadow_fit` for the operator at the best place. ``physical_parameters`` also has
        ``place`` (d,), ``place_covariance`` (d, d), and ``evaluations``, the number of operators.

    Raises
    ------
    SamplingError
        If the shapes of image, operator, noise and reference do not fit each other.
    SceneError
        If a value is out of range or not finite.

    See Also
    --------
    shadow_fit : Fit for an occluder at a known place.

    Notes
    -----
    The search maximises the evidence of the linear model of `shadow_fit`, in which the object, the
    ambient light and the noise are integrated out or take their best values, for an object that is
    nowhere negative: objects at wrong places would have to be. Near a place, the constraint changes
    the logarithm by that of the probability of the most probable object (Laplace's method). This
    falls with the number of modes, so that distant places are compared by the evidence of an object
    that is dark outside the cells that the most probable object lights.

    The search starts at the three best of 10 d + 1 points, the start, its neighbours at ``reach``
    and a low-discrepancy sequence, and uses quadratic models [1]_. It is repeated near the two best
    of its ends with the number of independent pixels that the residual shows there. The place is
    the maximum of a quadratic fitted to places around the better end, at a tenth of ``reach``. The
    covariance follows from the fall of the evidence along the axes of its curvature, at the
    distance at which it should have fallen by the odds of a detection.

    The status is "ambiguous" if the searches end at different places of similar evidence, or at
    the edge of the region, if the curvature leaves a standard deviation above ``reach``, or if the
    linear estimates of places that are as probable have a correlation below 0.8 with the best one.

    A shift of occluder and object together changes the shadows little: the place along the wall is
    less certain than the picture, which may be shifted.

    References
    ----------
    .. [1] Ragonneau and Zhang, COBYQA, https://www.cobyqa.com.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.inverse import occluder_fit
    >>> wall = np.arange(32)[:, None] + 0.5
    >>> cell = 32 / 24 * (np.arange(24) + 0.5)
    >>> def operator_at(place):  # a pole between a line of wall points, in 20 rows, and the cells
    ...     free = np.clip(abs(wall - 0.6 * cell - place[0]) - 2.5, 0.0, 1.0)
    ...     return np.tile(1e4 * free / (400.0 + (wall - cell) ** 2), (20, 1))
    >>> truth = np.where((cell > 9) & (cell < 15), 100.0, 0.0)
    >>> image = (operator_at([8.0]) @ truth).reshape(20, 32)
    >>> image += np.random.default_rng(0).standard_normal(image.shape)
    >>> fit = occluder_fit(
    ...     image, operator_at, start=[5.0], reach=3.0, cells=(1, 24), noise=1.0, ambient=-1
    ... )
    >>> fit.status, bool(abs(fit.physical_parameters["place"][0] - 8.0) < 0.05)
    ('converged', True)
    """
    started = time.perf_counter()
    first = np.atleast_1d(real_array("start", start))
    for name, function in (("operator_at", operator_at), ("finer", finer or operator_at)):
        if not callable(function):
            raise SceneError(f"{name} = {function!r} cannot be called; give a function")
    if first.ndim != 1 or not np.isfinite(first).all():
        raise SceneError(f"start = {start!r} must be finite numbers; give one for each value")
    reach = positive("reach", reach)
    most = whole("max_evaluations", max_evaluations, 10)
    settings = checked_settings(image, brightest, max_iterations, tolerance)

    def operator(place: Array) -> Operator:
        return checked_operator(model(place), np.shape(image), cells)

    model = operator_at
    data = wall_image(image, operator(first).pixels, noise, reference, ambient)
    evaluations, orders, tell = 0, set[int](), progress or (lambda text, share: None)

    def picture(steps: Array) -> tuple[float, float, Array]:
        """Return both log evidences of a place, and the linear estimate of the object there."""
        nonlocal evaluations
        evaluations += 1
        tell(f"place {evaluations}", min(1.0, evaluations / (len(around) + 5 * most)))
        known = operator(first + reach * steps)
        linear = evidence(data, known.matrix, known.cells)
        orders.add(linear.order)
        log, lit = linear.not_negative(known.cells)
        return log, evidence(data, known.matrix * lit, known.cells).log, linear.estimate

    def cost(steps: Array) -> float:
        return -picture(steps)[0]

    def cost_of_lit(steps: Array) -> float:
        return -picture(steps)[1]

    def searched(function: Callable[[Array], float], steps: Array, radius: float) -> Any:
        end = scipy.optimize.minimize(
            function,
            steps,
            method="COBYQA",
            bounds=[(-2.0, 2.0)] * len(first),
            options={"initial_tr_radius": radius, "final_tr_radius": 0.05, "maxfev": most},
        )
        end.fun = cost_of_lit(end.x)
        return end

    eye, halton = np.eye(len(first)), scipy.stats.qmc.Halton(len(first), scramble=False)
    around = np.vstack([0.0 * first, eye, -eye, 2.0 * halton.random(8 * len(first) + 1)[1:] - 1.0])
    nearest = np.argsort([cost_of_lit(steps) for steps in around], kind="stable")
    data = replace(data, orders=sorted(orders))
    ends = _distinct([searched(cost_of_lit, steps, 0.5) for steps in around[nearest[:3]]])
    if finer is not None:
        model = finer
        data = wall_image(image, operator(first).pixels, noise, reference, ambient)
        data = replace(data, orders=sorted(orders))
    data, _ = settled(data, operator(first + reach * ends[0].x))
    ends = _distinct([searched(cost, end.x, 0.2) for end in ends[:2]])
    best, curvature = _least(cost, np.array(ends[0].x))
    falls, vectors = np.linalg.eigh(curvature)
    reasons, covariance = list[str](), np.full(curvature.shape, math.inf)
    if falls[0] <= 1.0 or (abs(best) > 1.98).any():
        reasons.append("the evidence has no maximum within reach; start elsewhere or enlarge reach")
    else:
        # to where the evidence should have fallen by the odds of a detection; it may fall less
        axes = vectors * np.sqrt(2.0 * LIMITS.detection / falls)
        log, log_of_lit, estimate = picture(best)
        ends_of_axes = [[picture(best + side * axis) for side in (-1, 1)] for axis in axes.T]
        falls = np.array([max(log - 0.5 * (a[0] + b[0]), 1.0) for a, b in ends_of_axes])
        covariance = reach**2 * (axes / (2.0 * falls)) @ axes.T
        unlike = np.array(
            [max(1.0 - _correlation(estimate, end[2]) for end in pair) for pair in ends_of_axes]
        )
        least = 1.0 - float((unlike * LIMITS.detection / falls).max())
        if least < LIMITS.correlation:
            worst = int(np.argmax(unlike / falls))
            apart = reach * axes[:, worst] / math.sqrt(2.0 * falls[worst])
            reasons.append(
                f"the place is known to {np.round(abs(apart), 4).tolist()} (rms) only; pictures "
                f"of places as probable have a correlation of {max(least, 0.0):.2f}, limit "
                f"{LIMITS.correlation:g}; expose longer, or measure the place"
            )
        for other in ends[1:]:
            margin = float(other.fun) - min(float(ends[0].fun), -log_of_lit)
            apart = other.x - best
            if margin < LIMITS.detection and apart @ curvature @ apart > LIMITS.errors**2:
                reasons.append(
                    f"another place, {np.round(first + reach * other.x, 4).tolist()}, has a log "
                    f"evidence that is smaller by {margin:.1f}, limit {LIMITS.detection:.1f}; give "
                    "a closer start or a smaller reach"
                )
    place = first + reach * best
    more = [("ambiguous", sentence) for sentence in reasons]
    if ends[0].nfev >= most:
        more.append(("unconverged", f"the search ended after {most} places; raise max_evaluations"))
    return fitted(
        data,
        operator(place),
        settings,
        started,
        tuple(more),
        place=place,
        place_covariance=covariance,
        evaluations=evaluations,
    )


def _correlation(first: Array, second: Array) -> float:
    """Return the correlation of objects (N, C) but for the mean of each colour; 0 if constant."""
    first, second = (values - values.mean(0) for values in (first, second))
    norm = math.sqrt((first**2).sum() * (second**2).sum())
    return float((first * second).sum()) / norm if norm > 0.0 else 0.0


def _distinct(ends: Sequence[Any], apart: float = 0.1) -> list[Any]:
    """Return the ends of searches, best first, without those that are close to a better one."""
    result: list[Any] = []
    for end in sorted(ends, key=lambda end: float(end.fun)):
        if all(np.linalg.norm(end.x - better.x) > apart for better in result):
            result.append(end)
    return result


def _least(cost: Callable[[Array], float], centre: Array, step: float = 0.1) -> tuple[Array, Array]:
    """Return the minimum (d,) and the second derivatives (d, d) of a function near a minimum.

    A quadratic is fitted to values around the centre, which the local roughness of the function
    moves less than the least of the values. Its minimum is used if it is among them.
    """
    sides = step * np.eye(len(centre))
    around = [sign * side for side in sides for sign in (0, 1, -1)]
    pairs = [(i, j) for i in range(len(centre)) for j in range(i)]
    around += [a * sides[i] + b * sides[j] for i, j in pairs for a in (-1, 1) for b in (-1, 1)]
    steps = np.unique(around, axis=0)
    columns = [np.ones(len(steps)), *steps.T, *(steps**2).T / 2.0]
    columns += [steps[:, i] * steps[:, j] for i, j in pairs]
    values = [cost(centre + change) for change in steps]
    fit = np.linalg.lstsq(np.stack(columns, 1), np.array(values), rcond=None)[0][1:]
    slope, curvature = fit[: len(centre)], np.diag(fit[len(centre) : 2 * len(centre)])
    for (i, j), value in zip(pairs, fit[2 * len(centre) :], strict=True):
        curvature[i, j] = curvature[j, i] = value
    if np.linalg.eigvalsh(curvature)[0] > 1.0:
        change = -np.linalg.solve(curvature, slope)
        if (abs(change) <= step).all():
            centre = centre + change
    return centre, curvature
