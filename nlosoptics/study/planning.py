"""Plan of a study: points, shared stages, predicted time and size."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from .._checks import counted, expect, lasting
from ..errors import NlosError
from ..runs.stages import is_matt, point_seconds
from .design.point import point_spread_key
from .design.variables import delta_of
from .search.methods import search_table
from .search.problem import population

if TYPE_CHECKING:
    from .design.study import Study

UNKNOWN = 0.1  # s of a point spread that cannot be planned, and of a function of the user's


@dataclass(frozen=True, kw_only=True)
class StudyPlan:
    """Predicted cost of a study, from `plan_study`.

    Parameters
    ----------
    points : int
        Number of points (variants of the scene).
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

    def __str__(self) -> str:
        """Return the plan as text."""
        blocks = -(-self.points // self.block)
        return "\n".join(
            (
                f"points         {self.points}, {counted(self.figures, 'figure')} each",
                f"point spreads  {self.point_spreads}",
                f"forecasts      {self.forecasts}",
                f"blocks         {blocks} of at most {self.block} points",
                f"CPU time       about {lasting(self.seconds)}",
                f"store          at most {self.n_bytes / 1e6:.3g} MB",
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
    study = expect("study", study, "Study")
    if study.variables:
        return _plan_search(study)
    count = len(study)
    stages = [figure.stage for figure in study.figures]
    needs_spread = "point spread" in stages
    deltas = map(study.delta, range(count))
    keys = set(map(point_spread_key, deltas)) if needs_spread else set()
    one, forecast = _stage_seconds(study)
    forecasts = count if "forecast" in stages else 0
    scene = 5e-4  # s to build and check a scene
    seconds = (
        count * (scene + UNKNOWN * stages.count("own function"))
        + len(keys) * (one + 5e-3 * stages.count("point spread"))
        + forecasts * forecast
    )
    if study.table.compensate is not None:
        seconds += 30 * count * (scene + one)  # evaluations of a compensation
    # blocks of about 1 s, of which a short study has eight for its workers and its progress
    block = min(2000, int(count / seconds), count // 8)
    width = 40 + 17 * len(study.figures)
    return StudyPlan(
        points=count,
        figures=len(study.figures),
        point_spreads=len(keys),
        forecasts=forecasts,
        seconds=seconds,
        n_bytes=width * count + 20_000,
        block=max(1, block),
    )


def _plan_search(study: Study) -> StudyPlan:
    """Return the plan of a search: as if all its trials were at the first point."""
    start = delta_of(study.variables, {v.address: v.start for v in study.variables})
    one = plan_study(replace(study.with_trials([start]), variables=()))
    table = search_table(study)
    trials = table.evaluations
    together = one.points * min(trials, population(table))
    return StudyPlan(
        points=one.points * trials,
        figures=one.figures,
        point_spreads=one.point_spreads * trials,
        forecasts=one.forecasts * trials,
        seconds=one.seconds * trials,
        n_bytes=one.n_bytes * trials,
        block=max(1, min(2000, int(one.points / one.seconds), together // 8)),
    )


def _stage_seconds(study: Study) -> tuple[float, float]:
    """Return the predicted seconds of a point spread with its wave, and of a forecast.

    They are means over a few points of the design. A forecast takes the point spread, diffuse light
    of the object, and transforms of the image, more for a lobe that blurs.
    """
    spreads, forecasts = [], []
    for index in sorted({round(k * (len(study) - 1) / 4) for k in range(5)}):
        try:
            scene = study.scene(index)
            spreads.append(0.0 if is_matt(scene) else point_seconds(scene, study.tol))
        except NlosError:
            continue
        pixels = math.prod(scene.camera.shape)
        blurred = max(scene.mirror_slopes, default=0.0) > 0.0
        seconds = 0.6 + 1.2 * spreads[-1] + 1e-6 * pixels
        forecasts.append(seconds + (0.3 + 3e-6 * pixels if blurred else 0.0))
    if not spreads:
        return UNKNOWN, UNKNOWN
    return sum(spreads) / len(spreads), sum(forecasts) / len(forecasts)
