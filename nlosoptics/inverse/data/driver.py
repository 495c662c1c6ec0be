"""One loop for all iterative solvers: history, progress, stop, saved states, resuming.

A `Solver` holds the data and options of one fit, which stay constant. An `Iterate` holds all that
changes: everything on which the next iteration depends. `run` makes the iterations, so that each
solver resumes bit for bit from the states that it offers to a progress callback. `reconstructed`
leads from an image to a `Reconstruction`, for iterative and direct methods.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, TypeVar, cast

import numpy as np

from ..._checks import counted, in_range, whole
from ..._progress import Progress
from ...errors import SceneError
from .arrays import Values, check_finite, check_shape, is_tensor, like, real_array
from .checkpoints import State, goes_on, started_from, state_of
from .measurement import measured
from .models import AnyModel
from .noisy_image import NoisyImage, noisy_image
from .reconstruction import Reconstruction, assemble, concluded
from .status import Ending


def stop_rule(max_iterations: int, tolerance: float) -> tuple[int, float]:
    """Return the checked options that say when a solver stops."""
    tolerance = in_range("tolerance", tolerance, 0.0, 0.5, open_low=True)
    return whole("max_iterations", max_iterations), tolerance


@dataclass(eq=False, kw_only=True)
class Iterate:
    """State of a solver: all that the next iteration depends on.

    Arrays, tensors, numbers and Adam optimisers are saved. Fields of other types can be computed
    from them.
    ``count`` is the number of iterations so far.
    """

    count: int = 0


S = TypeVar("S", bound=Iterate)


@dataclass(eq=False)
class Run(Generic[S]):
    """Last state, and records of all iterations, including those before a resumption.

    ``stopped`` says whether a callback ended the run before the solver had finished.
    """

    state: S
    history: dict[str, list[float]]
    stopped: bool


class Solver(ABC, Generic[S]):
    """Iterative method with its data and options, which `run` drives."""

    name: str  # public function, for error messages
    records: tuple[str, ...] = ("objective", "residual", "change")  # numbers that `step` returns
    report: str  # format of the progress text, with names of records and fields of the state
    every: int = 10  # iterations between two progress reports
    takes_object: bool = True  # whether a fit can start from an object alone
    data: NoisyImage  # of solvers that can start from an object
    max_iterations: int

    @abstractmethod
    def init(self, first: Values | None) -> S:
        """Return the initial state; ``first`` (H, W) is a given object in image units, or None."""

    @abstractmethod
    def step(self, state: S) -> tuple[float, ...]:
        """Make one iteration; return its ``records``."""

    @abstractmethod
    def level(self, state: S) -> Values:
        """Return the object (H, W) in image units."""

    def done(self, state: S) -> bool:
        """Return whether the criterion of the solver is met; a function of the state alone."""
        return False

    def fraction(self, state: S) -> float:
        """Return the completed fraction, 0 to 1."""
        return state.count / self.max_iterations

    def resumed(self, state: S) -> None:
        """Apply what a restored state implies for other parts of the solver."""

    def answer(self, found: Run[S], level: Values) -> dict[str, Any]:
        """Return further arguments of `concluded`, or some that replace those of `solved`."""
        return {}


def run(solver: Solver[S], start: Any = None, progress: Progress | None = None) -> Run[S]:
    """Iterate until the solver is done, its iterations are used, or a callback stops it.

    ``start`` is an initial object, (H, W) in image units, a saved state, a state in memory, or
    None, and ``progress`` a callback as in `inverse.data.checkpoints`. A `SceneError` or
    `SamplingError` is raised if ``start`` belongs to another solver or shape, or is not finite.
    """
    state, history = _begun(solver, start)
    on = True
    while on and not _finished(solver, state):
        record = dict(zip(solver.records, solver.step(state), strict=True))
        state.count += 1
        for name, value in record.items():
            history[name].append(value)
        last = _finished(solver, state)
        if last or state.count % solver.every == 0:
            text = solver.report.format(**{**vars(state), **record})
            on = goes_on(
                progress,
                f"{text} after {counted(state.count, 'iteration')}",
                1.0 if last else solver.fraction(state),
                partial(_saved, solver, state, history),
            )
    return Run(state, history, stopped=not _finished(solver, state))


def solved(solver: Solver[S], start: Any, progress: Progress | None) -> dict[str, Any]:
    """Run a solver; return the arguments of `concluded` for its result.

    If the solver's answer has a status of its own, they are those of `assemble`.
    """
    found = run(solver, start, progress)
    level = solver.level(found.state)
    answer = {"level": level, **solver.answer(found, level)}
    if "status" in answer:
        return {"history": found.history, **answer}
    ending = Ending(converged=solver.done(found.state), history=found.history)
    return {"ending": ending, **answer}


def reconstructed(
    solve: Callable[[NoisyImage], dict[str, Any]],
    image: Any,
    model: AnyModel,
    shape: tuple[int, int] | None = None,
    *,
    in_numpy: bool = False,
) -> Reconstruction:
    """Check an image, or a `Measurement` of one, and return what a method finds in it.

    ``solve`` returns the arguments of `concluded` or `assemble` for a checked image in torch; it is
    not called if no object is detected and no pixel is saturated. ``shape`` (H, W) is that of the
    image if the point spread is unknown. With ``in_numpy`` the checked image is in numpy.
    """
    started = time.perf_counter()
    gain = measured(image).gain
    data = noisy_image(image, shape or model)
    full = 0 if data.saturated is None else int(data.saturated.sum())
    hidden = data.is_background(None if shape else model)
    if hidden and not full:
        answer = _no_object(data)
    else:
        answer = solve(data.in_numpy() if in_numpy else data.in_torch())
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


def _finished(solver: Solver[S], state: S) -> bool:
    return state.count >= solver.max_iterations or solver.done(state)


def _saved(solver: Solver[S], state: S, history: Mapping[str, list[float]]) -> State:
    """Return the state as a dict of arrays, from which a run resumes."""
    entries: dict[str, Any] = {}
    for name, value in _arrays(state).items():
        entries |= {name: value} if not _is_adam(value) else _adam().adam_state(name, value)
    numbers = [getattr(state, name) for name in _numbers(state)]
    records = np.array(list(history.values()))
    return state_of(solver.level(state), **entries, numbers=numbers, history=records)


def _begun(solver: Solver[S], start: Any) -> tuple[S, dict[str, list[float]]]:
    """Return the initial state, or the one that was saved, with its history."""
    nothing: dict[str, list[float]] = {name: [] for name in solver.records}
    if isinstance(start, Iterate):
        return cast(S, start), nothing
    if isinstance(start, Mapping) or (start is not None and not solver.takes_object):
        state, known = solver.init(None), start if isinstance(start, Mapping) else {}
        missing = [name for name in (*_arrays(state), "numbers", "history") if name not in known]
        if not missing:
            return state, _restored(solver, state, start)
        if not solver.takes_object:
            raise SceneError(f"start holds no {missing[0]}; {_remedy(solver)}")
    first = None if start is None else started_from(start, solver.data.data)
    return solver.init(first), nothing


def _restored(solver: Solver[S], state: S, saved: Mapping[str, Any]) -> dict[str, list[float]]:
    """Write saved values into an initial state; return the saved history."""
    names = _numbers(state)
    numbers = real_array("start's numbers", saved["numbers"]).ravel().tolist()
    records = real_array("start's history", saved["history"])
    if len(numbers) != len(names) or not np.isfinite(numbers).all():
        raise SceneError(
            f"start's numbers are {numbers}, must be {counted(len(names), 'finite value')}; "
            f"{_remedy(solver)}"
        )
    if len(records) != len(solver.records):
        raise SceneError(
            f"start's history has shape {records.shape}, must be ({len(solver.records)}, n); "
            f"{_remedy(solver)}"
        )
    for name, number in zip(names, numbers, strict=True):
        setattr(state, name, type(getattr(state, name))(number))
    for name, mine in _arrays(state).items():
        if _is_adam(mine):
            _adam().take_up_adam(name, mine, saved)
            continue
        values = real_array(f"start's {name}", saved[name])
        rest = "like this fit's; it is of another, leave it out"
        check_shape(f"start's {name}", values, mine.shape, rest)
        check_finite(f"start's {name}", values, _remedy(solver))
        setattr(state, name, like(values, mine))
    solver.resumed(state)
    return dict(zip(solver.records, records.tolist(), strict=True))


def _remedy(solver: Solver[S]) -> str:
    return f"give a state of {solver.name}, or leave it out"


def _is_adam(value: Any) -> bool:
    return hasattr(value, "param_groups")


def _adam() -> Any:
    """Return the module that saves and restores Adam optimisers, which needs torch."""
    from . import adam

    return adam


def _arrays(state: Iterate) -> dict[str, Any]:
    """Return the arrays, tensors and optimisers of a state."""
    return {
        name: value
        for name, value in vars(state).items()
        if isinstance(value, np.ndarray) or is_tensor(value) or _is_adam(value)
    }


def _numbers(state: Iterate) -> list[str]:
    return [name for name, value in vars(state).items() if isinstance(value, int | float)]
