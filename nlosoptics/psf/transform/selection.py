"""Automatic selection of the transform in `point_spread`: candidates, costs and the reason."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..._checks import fits_memory, lasting
from ...errors import MemoryLimitError, NlosError, SamplingError
from ..wave.regime import Regime
from ..window import error_bounds
from ..window.error_bounds import rounded_up
from . import airy, costs, geometric
from .runners import ABLE, Result, Task, transform

#: Aberration, waves peak to valley, up to which the geometric method is not tried.
MANY_WAVES = 20


@dataclass(frozen=True, order=True)
class Candidate:
    """Transform considered by `automatic`, ordered by its predicted time.

    Parameters
    ----------
    seconds : float
        Predicted run time on one core.
    method : str
        Name of the method in `point_spread`.
    ruled_out : str
        Reason why it is not run; empty if it can be run.
    """

    seconds: float
    method: str
    ruled_out: str = ""


def automatic(task: Task, regime: Regime, max_seconds: float) -> Result:
    """Run transforms in order of predicted time until one reaches tol.

    A method is skipped if the total predicted time would exceed ``max_seconds``.

    Returns
    -------
    Result
        Result of the first transform whose estimated error is at most tol. Its reason states why
        this transform was used, and why each other one was not.

    Raises
    ------
    SamplingError, MemoryLimitError
        If no transform reaches tol, or none within ``max_seconds``.
    """
    notes: list[str] = []
    refusals: list[NlosError] = []
    too_long: list[Candidate] = []
    reached, spent = math.inf, 0.0
    ordered = sorted(candidates(task, regime))
    for i, found in enumerate(ordered):
        if found.ruled_out:
            notes.append(f"{found.method} ruled out: {found.ruled_out}")
            continue
        if spent + found.seconds > max_seconds:
            too_long.append(found)
            continue
        try:
            result = transform(task, found.method)
        except (SamplingError, MemoryLimitError) as refusal:
            refusals.append(refusal)
            notes.append(f"{found.method} failed: {_first_clause(refusal)}")
            continue
        if result.error <= task.tol:
            reason = _reason(found, task.tol, notes, ordered[i + 1 :])
            return replace(result, reason=reason)
        spent += found.seconds
        reached = min(reached, result.error)
        notes.append(f"{found.method} ran first, with an error of {result.error:.2g}")
    raise _refusal(task, regime, reached, too_long, refusals, ordered, max_seconds)


def able(task: Task, regime: Regime) -> list[Candidate]:
    """Return the transforms that `automatic` tries, in its order.

    Raises
    ------
    SamplingError
        If all transforms are ruled out.
    """
    ordered = sorted(candidates(task, regime))
    found = [one for one in ordered if not one.ruled_out]
    if not found:
        raise _refusal(task, regime, math.inf, [], [], ordered, math.inf)
    return found


def candidates(task: Task, regime: Regime) -> list[Candidate]:
    """Return all transforms available for the wave's layout, with predicted times."""
    wave, samples = task.residual.wavefront, task.samples
    if task.polarisation is not None:
        found = [_components(task)]
    elif wave.is_spectral:
        closed = _airy(task)
        if not closed.ruled_out:
            return [closed]  # no other transform is faster
        seconds = costs.sum_over_nodes(math.prod(task.counts), samples)
        few = _nodes(task, "fft", costs.coarse_sum(task.coarse, samples), task.coarse.core)
        found = [closed, _nodes(task, "quadrature", seconds), few]
    elif wave.layout == "scattered":
        found = [Candidate(costs.scattered_sum(task.residual, samples), "nufft")]
    else:
        found = [Candidate(costs.map_sums(len(wave.u), samples), "mdft")]
    return [*found, _rays(task, regime)]


def _components(task: Task) -> Candidate:
    """Return the sums over nodes for each component of the high-aperture model."""
    wave, samples = task.residual.wavefront, task.samples
    if wave.layout == "grid":
        seconds = costs.map_sums(len(wave.u), samples)
    else:
        count = math.prod(task.counts) if wave.is_spectral else wave.u.size
        seconds = costs.sum_over_nodes(count, samples)
    return Candidate(task.components * seconds, ABLE[wave.layout][0])


def _airy(task: Task) -> Candidate:
    """Return the closed form, ruled out if its error bound exceeds tol."""
    bound = airy.error_bound(task.residual)
    ruled_out = "" if bound <= task.tol else "the wave is not flat"
    if ruled_out and math.isfinite(bound):
        ruled_out = f"the error of neglecting the aberration is {bound:.2g}"
    return Candidate(costs.airy(task.samples), "airy", ruled_out)


def _nodes(task: Task, method: str, seconds: float, missing: float = 0.0) -> Candidate:
    """Return a sum over nodes, ruled out if wave or nodes leave too large an error.

    ``missing`` is the field's error because of the number of nodes.
    """
    # lower bound of the relative error, since the peak is at most 1
    least = 2 * error_bounds.beat(task.pixel) * (task.residual.truncation + missing)
    ruled_out = f"error of at least {least:.2g} for its nodes" if least > task.tol else ""
    return Candidate(seconds, method, ruled_out)


def _rays(task: Task, regime: Regime) -> Candidate:
    """Return the geometric method, ruled out if diffraction matters."""
    least = geometric.least_error(task.residual, task.pitch)
    ruled_out = ""
    if task.rule is None:
        ruled_out = "rays have no intensity at points"
    elif regime.peak_to_valley <= MANY_WAVES:
        ruled_out = f"{regime.peak_to_valley:.3g} waves are too few, limit {MANY_WAVES}"
    elif least > task.tol:
        ruled_out = f"error of at least {least:.2g} on pixels of {regime.pixel:.3g} lambda N"
    if ruled_out:  # not costed: for a map that would need a fit about every node
        return Candidate(math.inf, "geometric", ruled_out)
    return Candidate(costs.rays(task.residual, task.pixels), "geometric")


def _reason(taken: Candidate, tol: float, notes: list[str], rest: list[Candidate]) -> str:
    """Return the text of `PointSpread.reason`."""
    later = [
        f"{c.method} ruled out: {c.ruled_out}"
        if c.ruled_out
        else f"{c.method} would take about {lasting(c.seconds)}"
        for c in rest
    ]
    head = f"{taken.method} is the cheapest within tol = {tol:g}, about {lasting(taken.seconds)}"
    return "; ".join([head, *notes, *later])


def _refusal(
    task: Task,
    regime: Regime,
    reached: float,
    too_long: list[Candidate],
    refusals: list[NlosError],
    ordered: list[Candidate],
    max_seconds: float,
) -> NlosError:
    """Return the error to raise if no transform succeeded, with a remedy."""
    if too_long:
        return _too_long(task, regime, too_long[0], reached, max_seconds)
    counts = " x ".join(map(str, task.residual.wavefront.u.shape))
    if math.isfinite(reached):
        # a factor, since callers split their own tolerance; half as much again, since transforms
        # sample more coarsely for a larger one
        factor = rounded_up(1.5 * reached / task.tol)
        return SamplingError(
            f"no transform reaches tol = {task.tol:g}, the best estimate is {reached:.2g}; use a "
            f"tol {factor} times as large, or more pupil nodes (now {counts})"
        )
    if refusals:
        return refusals[-1]
    why = "; ".join(f"{c.method}: {c.ruled_out}" for c in ordered if c.ruled_out)
    return SamplingError(
        f"no transform reaches tol = {task.tol:g} ({why}); use a larger tol, or more pupil nodes "
        f"(now {counts})"
    )


def _too_long(
    task: Task, regime: Regime, cheapest: Candidate, reached: float, max_seconds: float
) -> SamplingError:
    """Return the error for transforms that exceed ``max_seconds``; check the memory first."""
    ny, nx = task.samples.shape
    smaller = "use a smaller shape"
    if task.rule is not None and regime.peak_to_valley > MANY_WAVES:
        smaller += ", or on wide pixels a larger tol, so that geometric rays suffice"
    fits_memory(
        f"a point spread that needs {ny} x {nx} samples",
        32.0 * ny * nx,
        smaller,
    )
    remedies = [f"max_seconds = {rounded_up(cheapest.seconds)}"]
    if task.rule is None:
        remedies.append("a wider pitch with pixel_integrated=True")
    least = geometric.least_error(task.residual, task.pitch)
    if math.isfinite(reached):
        remedies.append(f"tol = {rounded_up(reached)}")
    elif task.rule is not None and regime.peak_to_valley > MANY_WAVES:
        remedies.append(f"a tol well above {least:.2g}, so that geometric rays suffice")
    if task.polarisation is not None:
        remedies.append("model='scalar'")
    if max(ny, nx) * task.samples.pitch > 3 * task.residual.rays.reach:
        remedies.append("a smaller shape")
    return SamplingError(
        f"{cheapest.method} of {regime.peak_to_valley:.3g} waves to {ny} x {nx} samples would take "
        f"about {lasting(cheapest.seconds)}, limit max_seconds = {max_seconds:g}; use "
        + ", or ".join(remedies)
    )


def _first_clause(refusal: NlosError) -> str:
    """Return an error message without its remedy."""
    return str(refusal).split(";")[0]
