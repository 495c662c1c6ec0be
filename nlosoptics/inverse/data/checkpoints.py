"""Progress callbacks of solvers, stopping a solver early, and resuming it from a saved state.

The docstring of `Stop` describes what a callback may do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._progress import Progress
from ...errors import SceneError
from .arrays import as_numpy, check_finite, check_shape

State = dict[str, NDArray[Any]]
Snapshot = Callable[[], State]


class Stop(Exception):
    """Exception that a progress callback raises to end a fit with its best result so far.

    Every iterative solver takes an argument ``progress``: a function that the solver calls
    repeatedly as ``progress(text, fraction)``, with a text and the completed fraction, 0 to 1. If
    this function raises `Stop`, the solver returns its best result so far, with status
    "unconverged".

    See Also
    --------
    Reconstruction : Result of every solver.
    tv_deconvolve : Non-negative deconvolution with total variation.

    Notes
    -----
    To save the state of a fit, pass as ``progress`` a callable object with a method ``look``. The
    solver calls ``look(snapshot)`` after each report. ``snapshot()`` returns the state as a dict of
    arrays; nothing is copied unless it is called. The entry ``"object"``, (H, W), in image units,
    serves as a preview. The dict can be passed as ``start`` to the same solver with the same image
    and options. `evidence_fit`, which takes minutes, then resumes, with the same result bit for bit
    as without interruption. The solvers with a known point spread start again from the object.

    Examples
    --------
    >>> import numpy as np
    >>> from nlosoptics.imaging import ForwardModel
    >>> from nlosoptics.inverse import Measurement, Stop, tv_deconvolve
    >>> model = ForwardModel(np.full((3, 3), 1 / 9), shape=(24, 24))
    >>> noise = np.random.default_rng(0).normal(0.0, 0.01, (24, 24))
    >>> image = model.forward(np.pad(np.eye(16), 4)) + noise
    >>> def stop_early(text, fraction):
    ...     if fraction > 0.1:
    ...         raise Stop
    >>> tv_deconvolve(Measurement(image, noise_sigma=0.01), model, progress=stop_early).status
    'unconverged'
    """

    def __init__(self) -> None:
        super().__init__("a progress callback asked the fit to end")


def goes_on(progress: Progress | None, text: str, fraction: float, snapshot: Snapshot) -> bool:
    """Call a progress callback; return False if it asks to stop.

    ``text`` describes the fit, ``fraction`` is the completed part of it, 0 to 1, and ``snapshot``
    returns the solver's state as a dict of arrays.
    """
    if progress is None:
        return True
    try:
        progress(text, fraction)
        look = getattr(progress, "look", None)
        if look is not None:
            look(snapshot)
    except Stop:
        return False
    return True


def state_of(level: Any, **more: Any) -> State:
    """Return a solver's state as a dict of arrays: the object in image units, and ``more``."""
    arrays = {"object": np.array(as_numpy(level), dtype=np.float64)}
    return arrays | {name: np.array(as_numpy(value)) for name, value in more.items()}


def started_from(start: Any, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the initial object (H, W), float64 in image units.

    ``start`` is an object, or a saved state that holds one. ``shape`` is that of the model. A
    `SamplingError` is raised if the object has another shape, and a `SceneError` if it is not
    finite or missing.
    """
    if isinstance(start, Mapping):
        if "object" not in start:
            raise SceneError(
                f"start contains {', '.join(start) or 'nothing'}, but no object; give a solver's "
                "state"
            )
        start = start["object"]
    try:
        level = np.array(as_numpy(start), dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(
            f"start of type {type(start).__name__} is not an array of numbers; give an object "
            "in image units, for example gain times object of a Reconstruction"
        ) from None
    check_shape("start", level, shape, "like the model; resample it or leave it out")
    check_finite("start", level, "leave it out")
    return level
