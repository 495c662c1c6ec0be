"""One loop for all iterative solvers: history, progress, stop, start.

A `Solver` holds the data and options of one fit, and all that changes from one iteration to the
next. `run` makes the iterations. `reconstructed` leads from an image to a `Reconstruction`, for
iterative and direct methods. The docstring of `Stop` describes what a callback may do.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import counted, in_range, whole
from ..._progress import Progress
from ...errors import SceneError
from ...imaging.forward_model import ForwardModel
from .arrays import as_numpy, check_finite, check_shape
from .measurement import measured
from .noisy_image import NoisyImage, noisy_image
from .reconstruction import Reconstruction, assemble, concluded
from .status import Ending

History = dict[str, list[float]]
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


def stop_rule(max_iterations: int, tolerance: float) -> tuple[int, float]:
    """Return the checked options that say when a solver stops."""
    tolerance = in_range("tolerance", tolerance, 0.0, 0.5, open_low=True)
    return whole("max_iterations", max_iterations), tolerance


class Solver(ABC):
    """Iterative method with its data, options and state, which `run` drives."""

    records: tuple[str, ...] = ("objective", "residual", "change")  # numbers that `step` returns
    report: str  # format of the progress text, with names of records and attributes
    every: int = 10  # iterations between two progress reports
    max_iterations: int
    count: int = 0  # iterations so far

    @abstractmethod
    def step(self) -> tuple[float, ...]:
        """Make one iteration; return its ``records``."""

    @abstractmethod
    def level(self) -> NDArray[np.float64]:
        """Return the object (H, W) in image units."""

    def done(self) -> bool:
        """Return whether the criterion of the solver is met."""
        return False

    def fraction(self) -> float:
        """Return the completed fraction, 0 to 1."""
        return self.count / self.max_iterations

    def answer(self, level: NDArray[np.float64], history: History) -> dict[str, Any]:
        """Return further arguments of `concluded`, or some that replace those of `solved`."""
        return {}


def run(solver: Solver, progress: Progress | None = None) -> History:
    """Iterate until the solver is done, its iterations are used, or a callback stops it.

    Returns the records of all iterations.
    """
    history: History = {name: [] for name in solver.records}
    on, left = True, not solver.done()
    while on and left:
        record = dict(zip(solver.records, solver.step(), strict=True))
        solver.count += 1
        for name, value in record.items():
            history[name].append(value)
        left = solver.count < solver.max_iterations and not solver.done()
        if not left or solver.count % solver.every == 0:
            text = solver.report.format(**{**vars(solver), **record})
            on = goes_on(
                progress,
                f"{text} after {counted(solver.count, 'iteration')}",
                solver.fraction() if left else 1.0,
                lambda: state_of(solver.level()),
            )
    return history


def solved(solver: Solver, progress: Progress | None) -> dict[str, Any]:
    """Run a solver; return the arguments of `concluded` for its result.

    If the solver's answer has a status of its own, they are those of `assemble`.
    """
    history = run(solver, progress)
    level = solver.level()
    answer = {"level": level, **solver.answer(level, history)}
    if "status" in answer:
        return {"history": history, **answer}
    return {"ending": Ending(converged=solver.done(), history=history), **answer}


def reconstructed(
    solve: Callable[[NoisyImage], dict[str, Any]],
    image: Any,
    model: ForwardModel,
    shape: tuple[int, int] | None = None,
) -> Reconstruction:
    """Check an image, or a `Measurement` of one, and return what a method finds in it.

    ``solve`` returns the arguments of `concluded` or `assemble` for a checked image; it is not
    called if no object is detected and no pixel is saturated. ``shape`` (H, W) is that of the image
    if the point spread is unknown.
    """
    started = time.perf_counter()
    gain = measured(image).gain
    data = noisy_image(image, shape or model)
    full = 0 if data.saturated is None else int(data.saturated.sum())
    hidden = data.is_background(None if shape else model)
    answer = _no_object(data) if hidden and not full else solve(data)
    finish = concluded if "ending" in answer else assemble
    found = finish(**{"data": data, "model": model, "gain": gain, "started": started, **answer})
    if not (hidden and full):
        return found
    reason = f"only the {counted(full, 'saturated pixel')} show an object; expose shorter"
    return replace(found, status="does_not_fit", reasons=(reason,))


def _no_object(data: NoisyImage) -> dict[str, Any]:
    """Return the arguments of `assemble` for a zero object: none was detected."""
    return {
        "level": 0.0 * data.data,
        "background": data.background_strength(data.data),
        "status": "too_few_photons",
        "history": {"objective": [], "residual": [], "change": []},
        "reasons": (
            "no object was detected above the noise, so the object is zero; expose longer",
        ),
    }
