"""Plans: what runs, how long it takes, and what is left out."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import counted
from .canvas import new_axes
from .palette import BLUE, GREY

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..limits import Feasibility
    from ..runs.plan import Plan, Stage

LOWEST = 1e-4  # of the modulation that is drawn


def feasibility(found: Feasibility, *, axes: Axes | None = None) -> Axes:
    """Draw modulation and noise against frequency on the object.

    Parameters
    ----------
    found : Feasibility
    axes : matplotlib Axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    Axes
        Modulation of the picture and of a matt wall, and that which noise hides, the modulation
        over its signal-to-noise; what lies above its own dashed line can be told. The strokes'
        frequency, one period on two widths, is marked.
    """
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.4, height=4.2)
    parts: list[tuple[str, str, Any, Any]] = [
        ("picture", "C0", found.modulation, found.signal_to_noise),
        ("matt wall", "C1", found.relay_modulation, found.relay_signal_to_noise),
    ]
    for name, colour, modulation, ratio in parts:
        if not np.any(modulation > 0.0):
            continue
        axes.semilogy(
            found.frequency, np.maximum(modulation, LOWEST / 10), color=colour, label=name
        )
        if ratio[0] > 0.0:
            hidden = modulation[0] / ratio[0]
            axes.axhline(hidden, color=colour, ls="--", lw=1, label=f"its noise, {hidden:.1g}")
    if found.stroke > 0.0:
        axes.axvline(0.5 / found.stroke, color="0.5", lw=1, label="strokes")
    axes.set(
        xlabel="frequency on the object (cycles/m)",
        ylabel="modulation",
        ylim=(LOWEST, 1.5),
        xlim=(0.0, float(found.frequency[-1])),
        title=found.verdict.split(":")[0] + f", {counted(found.modes, 'mode')}",
    )
    axes.legend(loc="upper right", fontsize=8)
    return axes


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
