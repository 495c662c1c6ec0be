"""Automatic selection of the transform in `point_spread`: candidates, costs and the reason."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..._checks import fits_memory, lasting
from ...errors import MemoryLimitError, NlosError, SamplingError
from ..window.error_bounds import rounded_up
from . import geometric
from .task import Result, Task
from .transforms import MANY_WAVES, able, transform


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


def automatic(task: Task, max_seconds: float) -> Result:
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
    ordered = candidates(task)
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
            notes.append(f"{found.method} failed: {str(refusal).split(';')[0]}")  # no remedy
            continue
        if result.error <= task.tol:
            reason = _reason(found, task.tol, notes, ordered[i + 1 :])
            return replace(result, reason=reason)
        spent += found.seconds
        reached = min(reached, result.error)
        notes.append(f"{found.method} ran first, with an error of {result.error:.2g}")
    raise _refusal(task, reached, too_long, refusals, ordered, max_seconds)


def candidates(task: Task) -> list[Candidate]:
    """Return all transforms of a wave in the order of their predicted seconds."""
    ways = able(task)
    closed = ways.pop("airy", None)
    refusal = "" if closed is None else closed.refusal(task)
    if closed is not None and not refusal:
        return [Candidate(closed.seconds(task), "airy")]  # no other transform is faster
    # a transform of several names is tried once, by the first
    names = {one: name for name, one in reversed(ways.items())}
    tried = [Candidate(math.inf, "airy", refusal)] if refusal else []
    for one, name in names.items():
        why = one.refusal(task)
        tried.append(Candidate(math.inf if why else one.seconds(task), name, why))
    return sorted(tried)


def possible(task: Task) -> list[Candidate]:
    """Return the transforms that `automatic` tries, in its order.

    Raises
    ------
    SamplingError
        If all transforms are ruled out.
    """
    ordered = candidates(task)
    if ordered[0].ruled_out:
        raise _refusal(task, math.inf, [], [], ordered, math.inf)
    return [one for one in ordered if not one.ruled_out]


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
    reached: float,
    too_long: list[Candidate],
    refusals: list[NlosError],
    ordered: list[Candidate],
    max_seconds: float,
) -> NlosError:
    """Return the error to raise if no transform succeeded, with a remedy."""
    if too_long:
        return _too_long(task, too_long[0], reached, max_seconds)
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


def _too_long(task: Task, cheapest: Candidate, reached: float, max_seconds: float) -> SamplingError:
    """Return the error for transforms that exceed ``max_seconds``; check the memory first."""
    (ny, nx), waves = task.samples.shape, task.regime.peak_to_valley
    smaller = "use a smaller shape"
    if task.rule is not None and waves > MANY_WAVES:
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
    elif task.rule is not None and waves > MANY_WAVES:
        remedies.append(f"a tol well above {least:.2g}, so that geometric rays suffice")
    if task.polarisation is not None:
        remedies.append("model='scalar'")
    if max(ny, nx) * task.samples.pitch > 3 * task.residual.rays.reach:
        remedies.append("a smaller shape")
    return SamplingError(
        f"{cheapest.method} of {waves:.3g} waves to {ny} x {nx} samples would take "
        f"about {lasting(cheapest.seconds)}, limit max_seconds = {max_seconds:g}; use "
        + ", or ".join(remedies)
    )
