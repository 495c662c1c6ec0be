"""Plan of a study: points, shared stages, predicted time and size."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from .._checks import counted
from ..errors import NlosError
from ..runs.plan import plan
from .design.fast import has_gradient
from .design.point import point_spread_key
from .design.variables import delta_of
from .search.methods import most_trials, searched_figures, trials_together

if TYPE_CHECKING:
    from .design.study import Study

BLOCK_SECONDS = 1.0  # predicted time of a block, s
MOST_ROWS = 2000  # in a block
LEAST_BLOCKS = 8  # so that a short study shows progress and uses several workers
SCENE_SECONDS = 5e-4  # s to build and check a scene
FORECAST = 0.1, 2.0  # s of a forecast, and multiple of the point spread's seconds
COMPENSATION = 30  # evaluations of a compensation
STEPS = 3  # of the differences that the fast tier takes along a direction
WAVE_SECONDS = 0.01  # s to trace a wave and to sample the fields of a figure
DRAW_SECONDS = 1.5e-4  # s to evaluate a figure of a draw
UNKNOWN = 0.1  # s of a point spread that cannot be planned, and of a function of the user's


@dataclass(frozen=True, kw_only=True)
class StudyPlan:
    """Predicted cost of a study, from `plan_study`.

    Parameters
    ----------
    points : int
        Number of points (variants of the scene) that are computed in full. If random draws have
        ``tier = "fast"``, these are the draws that check the approximation.
    figures : int
        Number of figures of merit.
    point_spreads : int
        Number of different point spread functions (PSFs) to compute. Points that differ only in
        values on which the PSF does not depend share one. 0 if no figure of merit needs a PSF.
    forecasts : int
        Number of predictions by `limits.feasibility` to compute; 0 if no figure of merit needs one.
    seconds : float
        Predicted CPU time of all points after compilation, s; uncertain by a factor of about two.
    n_bytes : int
        Largest size of the results folder (the store), bytes, without the files of the base scene.
    block : int
        Number of points that are computed and stored together.
    fast_draws : int
        Number of random draws whose figures of merit are computed approximately (``tier =
        "fast"``), by an expansion of the wave to second order in the drawn values; otherwise 0.
    waves : int
        Approximate number of waves that are traced for this expansion.
    gradients : tuple of str
        Figures of merit whose gradients the optimisation computes without further trials; empty if
        its method uses no gradients.
    differences : tuple of str
        Figures of merit whose gradients are differences between trials, one for each variable.

    See Also
    --------
    plan_study : Predict number of points, time and size.
    """

    points: int
    figures: int
    point_spreads: int
    forecasts: int
    seconds: float
    n_bytes: int
    block: int
    fast_draws: int = 0
    waves: int = 0
    gradients: tuple[str, ...] = ()
    differences: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the plan as text."""
        blocks = -(-self.points // self.block)
        fast = (
            f"fast draws     {self.fast_draws}, from about {self.waves} waves expanded to second "
            f"order\nchecked draws  {self.points}, {counted(self.figures, 'figure')} each"
        )
        methods = (("computed", self.gradients), ("by differences", self.differences))
        slopes = [f"of {', '.join(names)} {how}" for how, names in methods if names]
        return "\n".join(
            (
                fast
                if self.fast_draws
                else f"points         {self.points}, {counted(self.figures, 'figure')} each",
                f"point spreads  {self.point_spreads}",
                f"forecasts      {self.forecasts}",
                f"blocks         {blocks} of at most {self.block} points",
                f"CPU time       about {self.seconds:.3g} s",
                f"store          at most {self.n_bytes / 1e6:.3g} MB",
                *([f"gradients      {', '.join(slopes)}"] if slopes else []),
            )
        )


def plan_study(study: Study) -> StudyPlan:
    """Predict the number of points of a study, its run time and the size of its results.

    A point is a variant of the study's scene, at which the figures of merit are computed. No point
    is computed here.

    Parameters
    ----------
    study : Study
        Study to plan.

    Returns
    -------
    StudyPlan
        Numbers of points and point spread functions, predicted CPU time, and size of the results
        folder.

    See Also
    --------
    run_study : Run a study, or continue it.
    """
    if study.variables:
        return _plan_search(study)
    count = len(study.in_full)
    stages = {figure.stage for figure in study.figures}
    needs_spread = "point spread" in stages
    keys = {point_spread_key(delta) for delta in _deltas(study)} if needs_spread else set()
    one = _point_spread_seconds(study)
    own = sum(figure.stage == "own function" for figure in study.figures)
    forecasts = count if "forecast" in stages else 0
    seconds = (
        count * (SCENE_SECONDS + UNKNOWN * own)
        + len(keys) * one
        + forecasts * (FORECAST[0] + FORECAST[1] * one)
    )
    if study.table.compensate is not None:
        seconds += COMPENSATION * count * (SCENE_SECONDS + one)
    size = len(study.dimensions[0].addresses)
    waves = 1 + STEPS * size * (size + 1) if study.fast else 0
    fast = len(study) if study.fast else 0
    block = min(MOST_ROWS, int(BLOCK_SECONDS * count / seconds), count // LEAST_BLOCKS)
    width = 40 + 9 * len(study.figures) + 8 * sum(f.has_error for f in study.figures)
    return StudyPlan(
        points=count,
        figures=len(study.figures),
        point_spreads=len(keys),
        forecasts=forecasts,
        seconds=seconds + len(study.figures) * (waves * WAVE_SECONDS + fast * DRAW_SECONDS),
        n_bytes=width * count + (4000 + 8 * fast) * (2 * len(study.figures) + 4),
        block=max(1, block),
        fast_draws=fast,
        waves=waves,
    )


def _plan_search(study: Study) -> StudyPlan:
    """Return the plan of a search: as if all its trials were at the first point."""
    start = delta_of(study.variables, {v.address: v.start for v in study.variables})
    one = plan_study(replace(study.with_trials([start]), variables=()))
    trials = most_trials(study)
    together = one.points * min(trials, trials_together(study))
    block = min(int(BLOCK_SECONDS * one.points / one.seconds), together // LEAST_BLOCKS)
    table = study.table.optimise
    searched = searched_figures(study) if table is not None and table.method == "slsqp" else ()
    known = {name for name in searched if has_gradient(study.figure(name))}
    return StudyPlan(
        points=one.points * trials,
        figures=one.figures,
        point_spreads=one.point_spreads * trials,
        forecasts=one.forecasts * trials,
        seconds=one.seconds * trials,
        n_bytes=one.n_bytes * trials,
        block=max(1, min(MOST_ROWS, block)),
        gradients=tuple(name for name in searched if name in known),
        differences=tuple(name for name in searched if name not in known),
    )


def _deltas(study: Study) -> Iterable[dict[str, object]]:
    return (study.delta(index) for index in study.in_full)


def _point_spread_seconds(study: Study) -> float:
    """Return the predicted seconds of a wave and its point spread for the first point."""
    try:
        stages = plan(study.scene(0), study.tol).stages
    except NlosError:
        return UNKNOWN
    return sum(s.seconds for s in stages if s.name in ("wave aberration", "point spread"))
