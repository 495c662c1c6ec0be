"""Figures of predictions: feasibility of a reconstruction, and the plan of a run."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from .._checks import counted
from .canvas import BLACK, BLUE, GREY, VERMILION, new_axes, space_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..limits import Feasibility
    from ..runs.plan import Plan, Stage

LOWEST = 1e-4  # lower limit of the modulation axis


def feasibility(found: Feasibility, *, axes: Axes | None = None) -> Axes:
    """Draw which detail an image can show: contrast against spatial frequency, with noise limits.

    Parameters
    ----------
    found : Feasibility
        Result of `nlosoptics.limits.feasibility`.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with the modulation against the spatial frequency on the hidden object, cycles/m. The
        modulation is the contrast of a sine pattern on the object that is left in the camera image.
        One curve is for the image formed by the mirror-like part of the wall's reflection, one for
        its diffuse part. A dashed line of the same colour marks the modulation at which the
        signal-to-noise ratio is 1; only frequencies with a modulation above it are detectable. A
        grey line marks the frequency whose period is twice the width of the object's strokes. The
        title gives the verdict.

    See Also
    --------
    nlosoptics.limits.feasibility : Predict what an image can show.
    plan : Stages of a plan with their times.
    """
    (axes,) = (axes,) if axes is not None else new_axes(1, width=6.4, height=4.2)
    parts: list[tuple[str, str, Any, Any]] = [
        ("specular image", BLUE, found.modulation, found.signal_to_noise),
        ("diffuse reflection", VERMILION, found.relay_modulation, found.relay_signal_to_noise),
    ]
    for name, colour, modulation, ratio in parts:
        if not np.any(modulation > 0.0):
            continue
        axes.semilogy(
            found.frequency, np.maximum(modulation, LOWEST / 10), color=colour, label=name
        )
        if ratio[0] > 0.0:
            hidden = modulation[0] / ratio[0]
            label = f"{name}: noise limit {hidden:.1g}"
            axes.axhline(hidden, color=colour, ls="--", lw=1, label=label)
    if found.stroke > 0.0:
        axes.axvline(0.5 / found.stroke, color=GREY, lw=1, label="stroke frequency")
    axes.set(
        xlabel="spatial frequency on the object (cycles/m)",
        ylabel="modulation",
        ylim=(LOWEST, 1.5),
        xlim=(0.0, float(found.frequency[-1])),
        title=found.verdict.split(":")[0] + f", {counted(found.modes, 'mode')}",
    )
    space_ticks(axes)
    # below the axes, where it cannot cover a curve
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2, fontsize=8)
    return axes


def plan(plan: Plan, *, axes: Axes | None = None) -> Axes:
    """Draw the predicted time of each step of a run as a bar, and why steps are skipped.

    Parameters
    ----------
    plan : Plan
        Result of `nlosoptics.plan`, which lists the steps (stages) of a run.
    axes : matplotlib Axes, optional
        Axes to draw on; a new figure by default.

    Returns
    -------
    Axes
        Axes with one row per stage: first those that run, in their order, with time and error, then
        the skipped ones with the reason. Times are in seconds on one core.

    See Also
    --------
    nlosoptics.plan : Predict stages, time and error.
    feasibility : Modulation and noise against frequency.

    Examples
    --------
    >>> import nlosoptics as nlos
    >>> from nlosoptics import views
    >>> scene = nlos.Scene.load("examples/scenes/letter_flat.toml")
    >>> views.plan(nlos.plan(scene)).get_xlabel()
    'predicted time on one core (s)'
    """
    stages = (*plan.stages, *plan.skipped)
    if axes is None:
        (axes,) = new_axes(1, width=8.5, height=1.1 + 0.36 * len(stages))
    for row, stage in enumerate(stages):
        axes.barh(row, stage.seconds, height=0.6, color=BLUE)
        _tell(axes, row, stage)
    axes.set_yticks(range(len(stages)), [stage.name for stage in stages])
    for label, stage in zip(axes.get_yticklabels(), stages, strict=True):
        label.set_color(BLACK if stage.runs else GREY)
    axes.set(
        xlim=(0.0, 1.02 * max((stage.seconds for stage in plan.stages), default=0.0) or 1.0),
        ylim=(len(stages) - 0.4, -0.6),
        xlabel="predicted time on one core (s)",
        title=f"total {plan.seconds:.3g} s, tolerance {plan.tol:g} of the peak",
    )
    space_ticks(axes)
    axes.grid(axis="x", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _tell(axes: Axes, row: int, stage: Stage) -> None:
    """Write the time and error of a stage to the right of its bar, or why it is skipped."""
    style: dict[str, Any] = {"color": BLACK, "style": "normal"}
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
