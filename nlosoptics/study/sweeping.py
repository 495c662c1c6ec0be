"""Sweep of a scene in memory: a study of its values along axes, without file and store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import expect
from .._progress import Progress
from ..errors import SceneError
from ..scene import Scene
from ..scene.file.scene_file import own_tables, with_units
from .blocks import order
from .design.study import Study
from .engine import Engine
from .results import Results, answered
from .worker import Answers, Block


def sweep(
    scene: Scene,
    axes: Mapping[str, Sequence[Any]],
    figures: str | Sequence[Any],
    *,
    tol: float = 1e-3,
    progress: Progress | None = None,
) -> Results:
    """Compute figures of merit of a scene over all combinations of some of its values.

    Parameters
    ----------
    scene : Scene
        Base scene.
    axes : mapping of str to sequence
        Values along each axis by address, such as ``camera.stop_diameter``: numbers in SI units,
        or texts with a unit. See `Scene.with_values`.
    figures : str or sequence
        Names of figures of merit, such as "strehl", or mappings with options, such as
        ``{"figure": "mtf", "frequency": 60.0}``; see `Study`.
    tol : float, default 1e-3
        Error tolerance of point spread functions, max |dI|/max I, with I the intensity.
    progress : callable(str, float), optional
        Function that is called with a text and the completed fraction, 0 to 1.

    Returns
    -------
    Results
        Figures of merit over the axes, NaN where they failed. ``path`` is no folder.

    Raises
    ------
    SceneError
        If an address, the form of a value or a figure of merit is wrong.

    See Also
    --------
    run_study : Run a study on several processes, with its results in a folder.
    nlosoptics.views.study_map : Figure of merit over two dimensions.

    Notes
    -----
    Points that differ only in values on which the point spread does not depend share it.

    Examples
    --------
    >>> from nlosoptics import Scene
    >>> from nlosoptics.study import sweep
    >>> scene = Scene.load("examples/scenes/letter_flat.toml")
    >>> table = sweep(scene, {"wall.curvature": [-0.01, 0.0, 0.01]}, figures="aberration_rms")
    >>> table.to_xarray()["aberration_rms"].values.round(2)
    array([0.22, 0.  , 0.23])
    """
    scene = expect("scene", scene, "Scene")
    if not isinstance(axes, Mapping) or not axes:
        raise SceneError(f"axes is {axes!r}; give values by address, such as camera.stop_diameter")
    listed = {address: _listed(f"axes: {address}", values) for address, values in axes.items()}
    tables, _ = own_tables(scene)
    first = {address: values[0] for address, values in listed.items()}
    written = {
        address: [with_units(tables, first | {address: value})[address] for value in values]
        for address, values in listed.items()
    }
    names = [figures] if isinstance(figures, Mapping) else _listed("figures", figures)
    study = Study.from_tables({"scene": scene, "axes": written, "figures": names, "tol": tol})
    blocks = (
        Block((i,), (study.delta(i),), (study.ids[i],), tuple(f.name for f in study.figures))
        for i in order(study)
    )
    parts: dict[int, Answers] = {}
    with Engine(study, 0) as engine:
        for block, answers in engine.compute(blocks, lambda: False):
            parts[block.rows[0]] = answers
            if progress is not None:
                progress(f"{len(parts)} of {len(study)} points", len(parts) / len(study))
    rows = zip(*(parts[i] for i in range(len(study))), strict=True)
    answers = Answers(*map(np.concatenate, rows))
    return Results(path=Path("sweep"), study=study, dataset=answered(study, answers, {}))


def _listed(name: str, values: Any) -> list[Any]:
    """Return values, of which there may be one, as a list."""
    try:
        listed = [values] if isinstance(values, str) else list(values)
    except TypeError:
        listed = [values]
    if not listed:
        raise SceneError(f"{name} = {values!r} has no values; give at least one")
    return listed
