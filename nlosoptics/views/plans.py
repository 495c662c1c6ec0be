"""Plans: what runs, how long it takes, and what is left out."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

from .canvas import new_axes
from .palette import BLUE, GREY

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..planning import Plan, Stage


def plan(plan: Plan, *, axes: Axes | None = None) -> Axes:
    """Draw the predicted seconds of a plan's stages as bars, and what is skipped with its reason.

    Parameters
    ----------
    plan : Plan
        What to draw.
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        One row for each stage, in the order in which they run, the skipped ones below; seconds on
        one core.
    """
    stages = (*plan.stages, *plan.skipped)
    if axes is None:
        (axes,) = new_axes(1, width=8.5, height=1.1 + 0.36 * len(stages))
    for row, stage in enumerate(stages):
        axes.barh(row, stage.seconds, height=0.6, color=BLUE)
        _tell(axes, row, stage)
    axes.set_yticks(range(len(stages)), [stage.name for stage in stages])
    for label, stage in zip(axes.get_yticklabels(), stages, strict=True):
        label.set_color("black" if stage.runs else GREY)
    axes.set(
        xlim=(0.0, 1.02 * max((stage.seconds for stage in plan.stages), default=0.0) or 1.0),
        ylim=(len(stages) - 0.4, -0.6),
        xlabel="predicted seconds, one core",
        title=f"{plan.seconds:.3g} s in all, to {plan.tol:g} of the peak",
    )
    axes.grid(axis="x", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _tell(axes: Axes, row: int, stage: Stage) -> None:
    """Write a stage's seconds and error behind its bar, or why it is skipped."""
    style: dict[str, Any] = {"color": "black", "style": "normal"}
    text = f"{stage.seconds:.2g} s"
    if stage.error:
        text += f", {stage.error}"
    if not stage.runs:
        style = {"color": GREY, "style": "italic"}
        text = f"skipped: {stage.reason}"
    axes.annotate(
        textwrap.fill(text, 90),
        (stage.seconds, row),
        xytext=(5, 0),
        textcoords="offset points",
        verticalalignment="center",
        fontsize=9,
        **style,
    )
