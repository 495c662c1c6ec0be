"""Draws of the fast tier: what it can do, which draws are checked, and their coordinates."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

from ...errors import SceneError
from .designs import Spread, spreads
from .file import StudyTable

if TYPE_CHECKING:
    from .figures import Figure

#: Figures of merit of the fast tier.
FAST: Final = ("strehl", "aberration_rms", "spot_rms", "mtf", "value")
#: Figures of merit that depend on the sampled wave only, and not on the window of a point spread.
OF_WAVES: Final = ("strehl", "aberration_rms", "spot_rms")
CHECK: Final = 200  # draws in full by default


def fast_spreads(
    table: StudyTable, figures: Sequence[Figure], value_of: Callable[[str], Any]
) -> dict[str, Spread]:
    """Return the middle and the width of each distribution of a fast study by address.

    It is empty if the draws are of the full tier.

    Parameters
    ----------
    table : StudyTable
        Checked study file.
    figures : sequence of Figure
        Figures of the study.
    value_of : callable
        Value of the base scene at an address.

    Raises
    ------
    SceneError
        If the fast tier cannot compute a figure, a dimension or a distribution of the study.
    """
    draws = table.draws
    if draws is None or draws.tier == "full":
        if draws is not None and draws.check is not None:
            raise SceneError(
                f"draws.check = {draws.check} goes with tier = 'fast' alone; add that, or remove it"
            )
        return {}
    others = [name for name in ("axes", "zip", "one_at_a_time") if getattr(table, name)]
    others += [
        name
        for name in ("optimise", "inverse_sensitivity", "compensate")
        if getattr(table, name) is not None
    ]
    if others:
        raise SceneError(
            f"draws.tier = 'fast' does not go with {others[0]}; remove that, or use tier = 'full'"
        )
    if draws.method == "saltelli":
        raise SceneError(
            "draws.method = saltelli does not go with tier = 'fast', whose error Sobol indices "
            "would not show; use another method, or tier = 'full'"
        )
    if draws.check is not None and draws.check > draws.count:
        raise SceneError(
            f"draws.check = {draws.check} is above draws.count = {draws.count}; use fewer, or "
            "tier = 'full'"
        )
    for figure in figures:
        if figure.source not in FAST:
            raise SceneError(
                f"figures: {figure.source} is not among those of tier = 'fast', "
                f"{', '.join(FAST)}; remove it, or use tier = 'full'"
            )
    return spreads(draws, value_of)


def has_gradient(figure: Figure) -> bool:
    """Return whether a figure's derivatives follow from neighbouring waves or scenes.

    Those of other figures need differences of whole points. So does the modulation: it is that of a
    point spread in a window, whose size changes with the scene and matters to the derivatives.
    """
    smooth = figure.source in OF_WAVES or figure.stage == "scene"
    return smooth and figure.compensate is None


def checked_draws(table: StudyTable, ids: Sequence[str]) -> tuple[int, ...]:
    """Return the draws that a fast study computes in full: those of the smallest ids.

    Ids are hashes of the values, so that this is a random sample. A larger sample contains all
    smaller ones.
    """
    given = None if table.draws is None else table.draws.check
    check = min(CHECK if given is None else given, len(ids))
    return tuple(sorted(heapq.nsmallest(check, range(len(ids)), key=ids.__getitem__)))
