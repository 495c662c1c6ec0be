"""What a solver tells its caller on the way, how it is stopped, and where it goes on from.

Each solver calls ``progress(text, fraction)`` now and then, with a line of text and the share done.
Two things more are open to a callback:

- It may raise `Stop`: the solver then returns the best it has, status "unconverged".
- It may have a method ``look(snapshot)``: it is called after each report with a function that makes
  the solver's state, a dict of arrays. ``"object"`` is always among them, (H, W) in image units,
  for a preview; the whole dict is what the solver's ``start=`` takes to go on from there. Nothing
  is copied unless the function is called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .._progress import Progress
from ..errors import SamplingError, SceneError
from .measurements import real_array

State = dict[str, NDArray[Any]]
Snapshot = Callable[[], State]


class Stop(Exception):
    """Raised by a progress callback to end a fit with what it has."""

    def __init__(self) -> None:
        super().__init__("a progress callback asked the fit to end")


def goes_on(progress: Progress | None, text: str, fraction: float, snapshot: Snapshot) -> bool:
    """Tell a callback where a fit stands; False where it asks to stop.

    Parameters
    ----------
    progress : callable or None
    text : str
    fraction : float
        Share done, 0 to 1.
    snapshot : callable
        Makes the solver's state as arrays.
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


def state_of(level: Tensor, **more: Any) -> State:
    """State of a solver: the object in image units, and what else it starts from."""
    arrays = {"object": level.detach().to(device="cpu", dtype=torch.float64).numpy().copy()}
    for name, value in more.items():
        if isinstance(value, Tensor):
            value = value.detach().cpu().numpy()
        arrays[name] = np.array(value)
    return arrays


def kept_numbers(state: Mapping[str, Any], count: int, solver: str) -> list[float]:
    """The numbers of a state of a solver, finite and as many as it keeps."""
    numbers: list[float] = real_array("start's numbers", state["numbers"]).ravel().tolist()
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise SceneError(
            f"start's numbers are {numbers}, must be {count} finite ones; give a state of "
            f"{solver}, or leave it out"
        )
    return numbers


def started_from(start: Any, shape: tuple[int, int], device: torch.device) -> Tensor | None:
    """The object to start from, (H, W) float64 in image units; None for the solver's own start.

    Parameters
    ----------
    start : array_like, mapping or None
        An object, or a state that holds one.
    shape : (int, int)
    device : torch.device

    Raises
    ------
    SamplingError
        If its shape is not that of the model.
    SceneError
        If it holds no object, or one that is not finite.
    """
    if start is None:
        return None
    if isinstance(start, Mapping):
        if "object" not in start:
            raise SceneError(
                f"start holds {', '.join(start) or 'nothing'}, no object; give a solver's state"
            )
        start = start["object"]
    if isinstance(start, Tensor):
        level = start.detach().to(device=device, dtype=torch.float64)
    else:
        try:
            level = torch.tensor(np.asarray(start, dtype=np.float64), device=device)
        except (TypeError, ValueError):
            raise SceneError(
                f"start of type {type(start).__name__} is no array of numbers; give an object in "
                "image units, as a Reconstruction's gain times its object"
            ) from None
    if tuple(level.shape) != shape:
        raise SamplingError(
            f"start has shape {tuple(level.shape)}, must be {shape} like the model; resample it or "
            "leave it out"
        )
    if not bool(torch.isfinite(level).all()):
        raise SceneError("start holds values that are not finite; leave it out")
    return level
