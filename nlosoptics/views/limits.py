"""What an image can tell, drawn: modulation and signal against noise over frequency."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .canvas import new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..limits import Feasibility

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
        title=found.verdict.split(":")[0] + f", {found.modes} modes",
    )
    axes.legend(loc="upper right", fontsize=8)
    return axes
