"""Which transform `point_spread` runs when it may choose, what that costs, and why."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..._checks import fits_memory
from ...errors import MemoryLimitError, NlosError, SamplingError
from ..wave.regime import Regime
from ..window import error_bounds
from ..window.error_bounds import rounded_up
from . import airy, antialiased_fft, costs, geometric
from .runners import Result, Task, grid_period_pitch, polar_size, transform

#: Waves, peak to valley, below which rays are not tried.
MANY_WAVES = 20
#: Times tol that a predicted estimate must pass before its transform is left out: what it is
#: relative to the peak is only known when the peak is.
DOUBT = 10.0


@dataclass(frozen=True, order=True)
class Candidate:
    """One transform that might do.

    Parameters
    ----------
    seconds : float
        Predicted.
    method : str
    ruled_out : str
        Why it cannot do, without having been run; empty where it can.
    """

    seconds: float
    method: str
    ruled_out: str = ""


def automatic(task: Task, regime: Regime, max_seconds: float) -> tuple[Result, str]:
    """Cheapest transform whose estimate is within tol, and why it is.

    A method is skipped if the total predicted time would exceed ``max_seconds``.
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
            notes.append(f"{found.method} refused: {_first_clause(refusal)}")
            continue
        if result.error <= task.tol:
            return result, _reason(found, task.tol, notes, ordered[i + 1 :])
        spent += found.seconds
        reached = min(reached, result.error)
        notes.append(f"{found.method} ran first and reached {result.error:.2g}")
    raise _refusal(task, regime, reached, too_long, refusals, ordered, max_seconds)


def able(task: Task, regime: Regime) -> list[Candidate]:
    """The transforms that `automatic` tries, in its order.

    Raises
    ------
    SamplingError
        As of `automatic`, where there is none.
    """
    ordered = sorted(candidates(task, regime))
    found = [one for one in ordered if not one.ruled_out]
    if not found:
        raise _refusal(task, regime, math.inf, [], [], ordered, math.inf)
    return found


def candidates(task: Task, regime: Regime) -> list[Candidate]:
    """Every transform that takes this layout, with its seconds and what rules it out."""
    layout = task.residual.wavefront.layout
    if layout == "polar":
        closed = _airy(task)
        if not closed.ruled_out:
            return [closed]  # none is faster
        found = [closed, _quadrature(task), _soft_grid(task)]
    elif layout == "cells":
        found = [_quadrature(task)]
    elif layout == "scattered":
        found = [Candidate(costs.scattered_sum(task.residual, task.samples), "nufft")]
    else:
        found = _maps(task)
    return [*found, _rays(task, regime)]


def _airy(task: Task) -> Candidate:
    bound = airy.error_bound(task.residual)
    ruled_out = "" if bound <= task.tol else "the wave is not flat"
    if ruled_out and math.isfinite(bound):
        ruled_out = f"the wave is flat to an error of {bound:.2g}"
    return Candidate(costs.airy(task.samples), "airy", ruled_out)


def _quadrature(task: Task) -> Candidate:
    residual = task.residual
    # against a peak of 1, the highest there is
    least = 2 * error_bounds.beat(task.pixel) * residual.truncation
    ruled_out = f"its nodes miss {least:.2g} or more" if least > task.tol else ""
    return Candidate(costs.polar_sum(residual, task.samples), "quadrature", ruled_out)


def _soft_grid(task: Task) -> Candidate:
    residual = task.residual
    if task.soft is not None:
        fast, few = (task.soft.grid(task, method) for method in ("fft", "mdft"))
        least = 2 * few.error
        ruled_out = f"its rim errs by {least:g}" if task.tol < least else ""
        return min(
            Candidate(costs.soft_padded(task.samples, fast), "fft", ruled_out),
            Candidate(costs.soft_folded(task.samples, few), "mdft", ruled_out),
        )
    size = polar_size(task)
    pitch = grid_period_pitch(task, size)
    # the light spread evenly over the rays' disc, 1 at most
    reach = max(residual.rays.reach / residual.airy_unit, 1.0)
    peak = min(1.0, 4 / (math.pi * reach) ** 2)
    rim = error_bounds.soft_rim_error(residual, pitch, 0.0, error_bounds.CONTINUATION)
    field = float(rim) + residual.truncation
    expected = 2 * error_bounds.beat(task.pixel) * field / math.sqrt(peak)
    ruled_out = f"its rim errs by about {expected:.2g}" if expected > DOUBT * task.tol else ""
    return Candidate(costs.soft_grid(residual, task.samples, pitch, size), "fft", ruled_out)


def _maps(task: Task) -> list[Candidate]:
    residual = task.residual
    chirp = Candidate(costs.map_chirp(residual, task.samples), "mdft")
    wave = residual.wavefront
    size = wave.wavelength * abs(wave.image_distance) / (task.samples.pitch * wave.pupil_pitch)
    whole = abs(size - round(size)) <= 1e-9 * size
    ruled_out = "" if whole and task.rule is None else "the pitch is not a fraction of its period"
    if task.rule is not None:
        ruled_out = "its pitch does not divide pixels"
    fft = Candidate(costs.map_fft(residual, task.samples, round(size)), "fft", ruled_out)
    return [fft, chirp]


def _rays(task: Task, regime: Regime) -> Candidate:
    least = geometric.least_error(task.residual, task.pitch)
    ruled_out = ""
    if task.rule is None:
        ruled_out = "rays have no intensity at points"
    elif regime.peak_to_valley <= MANY_WAVES:
        ruled_out = f"{regime.peak_to_valley:.3g} waves are few for rays, limit {MANY_WAVES}"
    elif least > task.tol:
        ruled_out = f"rays err by {least:.2g} or more on pixels of {regime.pixel:.3g} lambda N"
    if ruled_out:  # what rays of a map would cost takes a fit about every node
        return Candidate(math.inf, "geometric", ruled_out)
    return Candidate(costs.rays(task.residual, task.pixels), "geometric")


def _reason(taken: Candidate, tol: float, notes: list[str], rest: list[Candidate]) -> str:
    later = [
        f"{c.method} ruled out: {c.ruled_out}"
        if c.ruled_out
        else f"{c.method} would take about {c.seconds:.2g} s"
        for c in rest
    ]
    head = f"{taken.method} is the cheapest within tol = {tol:g}, about {taken.seconds:.2g} s"
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
    """What stopped the transforms, and what would be needed."""
    if too_long:
        return _too_long(task, regime, too_long[0], reached, max_seconds)
    counts = " x ".join(map(str, task.residual.wavefront.u.shape))
    if math.isfinite(reached):
        return SamplingError(
            f"no transform reaches tol = {task.tol:g}, the best estimate is {reached:.2g}; use "
            f"tol = {rounded_up(reached)}, or more pupil nodes (now {counts})"
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
    ny, nx = task.samples.shape
    n_bytes = 32.0 * ny * nx
    if task.soft is not None and cheapest.method in ("fft", "mdft"):
        need = (
            antialiased_fft.padded_bytes
            if cheapest.method == "fft"
            else antialiased_fft.folded_bytes
        )
        grid = task.soft.grid(task, cheapest.method)
        n_bytes = need(task.samples, grid, task.rule)
    smaller = "use a smaller shape"
    if task.rule is not None and regime.peak_to_valley > MANY_WAVES:
        smaller += ", or a larger tol on wide pixels, at which rays do"
    elif task.rule is not None and task.residual.wavefront.layout == "polar":
        smaller += ", or psf.wide_point_spread"
    fits_memory(
        f"a point spread that needs {ny} x {nx} samples",
        n_bytes,
        smaller,
    )
    remedies = [f"max_seconds = {rounded_up(cheapest.seconds)}"]
    if task.rule is None:
        remedies.append("a wider pitch with pixel_integrated=True")
    least = geometric.least_error(task.residual, task.pitch)
    if math.isfinite(reached):
        remedies.append(f"tol = {rounded_up(reached)}")
    elif task.rule is not None and regime.peak_to_valley > MANY_WAVES:
        remedies.append(f"a tol well above {least:.2g}, at which rays do")
    if max(ny, nx) * task.samples.pitch > 3 * task.residual.rays.reach:
        remedies.append("a smaller shape")
    return SamplingError(
        f"{cheapest.method} of {regime.peak_to_valley:.3g} waves to {ny} x {nx} samples would take "
        f"about {cheapest.seconds:.2g} s, limit max_seconds = {max_seconds:g}; use "
        + ", or ".join(remedies)
    )


def _first_clause(refusal: NlosError) -> str:
    return str(refusal).split(";")[0]
