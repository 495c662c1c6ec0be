"""Progress callbacks of solvers, stopping a solver early, and resuming it from a saved state.

Each solver repeatedly calls ``progress(text, fraction)`` with a text and the completed fraction. A
callback has two further possibilities:

- It may raise `Stop`. The solver then returns its best result so far, with status "unconverged".
- It may have a method ``look(snapshot)``, which is called after each report. ``snapshot()`` returns
  the solver's state as a dict of arrays. Its entry ``"object"``, (H, W) in image units, serves as a
  preview; the whole dict can be passed to the solver as ``start``. The resumed fit is bit-identical
  to an uninterrupted one. Nothing is copied unless ``snapshot`` is called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..._progress import Progress
from ...errors import SamplingError, SceneError


def joined(parts: Sequence[Tensor]) -> Tensor:
    """Concatenate the values of several tensors to one vector, (n,)."""
    # torch.nn.utils.parameters_to_vector does not accept tensors in channels_last layout
    return torch.cat([part.detach().reshape(-1) for part in parts])


def spread(name: str, values: Any, parts: Sequence[Tensor]) -> None:
    """Write a vector (n,) of values into tensors of n elements together, in their order.

    Another number of values raises a `SamplingError`, in which ``name`` stands for the values.
    """
    vector = torch.from_numpy(np.array(values)).reshape(-1)
    sizes = [part.numel() for part in parts]
    if vector.numel() != sum(sizes):
        raise SamplingError(
            f"start has {vector.numel()} {name}, must be {sum(sizes)}; it belongs to other images "
            "or another network, leave it out"
        )
    with torch.no_grad():
        for part, some in zip(parts, torch.split(vector, sizes), strict=True):
            part.copy_(some.reshape(part.shape))


def adam_state(name: str, adam: torch.optim.Adam) -> dict[str, Tensor]:
    """Return values, moments and step count of an Adam optimiser that updates all its values.

    The vectors (n,) have the keys ``name``, ``name_exp_avg`` and ``name_exp_avg_sq``; the number of
    steps has the key ``name_steps``.
    """
    values = _values(adam)
    found = {name: joined(values)}
    if adam.state:
        for key in ("exp_avg", "exp_avg_sq"):
            found[f"{name}_{key}"] = joined([adam.state[part][key] for part in values])
        found[f"{name}_steps"] = adam.state[values[0]]["step"]
    return found


def take_up_adam(name: str, adam: torch.optim.Adam, state: Mapping[str, Any]) -> None:
    """Restore values and moments of an Adam optimiser, in place, from a dict of `adam_state`.

    A `SceneError` is raised if the state holds no such values, and a `SamplingError` if it holds
    more or fewer than the optimiser.
    """
    if name not in state:
        raise SceneError(f"start holds no {name}; give a state of the same solver, or leave it out")
    values = _values(adam)
    spread(name, state[name], values)
    if f"{name}_steps" not in state:
        return
    moments = {}
    for key in ("exp_avg", "exp_avg_sq"):
        moments[key] = [torch.zeros_like(part) for part in values]
        spread(f"{name}_{key}", state[f"{name}_{key}"], moments[key])
    for part, mean, square in zip(values, moments["exp_avg"], moments["exp_avg_sq"], strict=True):
        steps = torch.tensor(float(state[f"{name}_steps"]))
        adam.state[part] = {"step": steps, "exp_avg": mean, "exp_avg_sq": square}


def descend(adam: torch.optim.Adam, loss: Tensor) -> None:
    """Make one step of an Adam optimiser along the gradient of a loss, a single number."""
    adam.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    adam.step()


def _values(adam: torch.optim.Adam) -> list[Tensor]:
    return [part for group in adam.param_groups for part in group["params"]]


State = dict[str, NDArray[Any]]
Snapshot = Callable[[], State]


class Stop(Exception):
    """Exception that a progress callback raises to end a fit with its best result so far.

    See Also
    --------
    Reconstruction : Result of every solver.
    tv_deconvolve : Non-negative, with total variation.
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


def state_of(level: Tensor, **more: Any) -> State:
    """Return a solver's state as a dict of arrays: the object in image units, and ``more``."""
    arrays = {"object": level.detach().to(device="cpu", dtype=torch.float64).numpy().copy()}
    for name, value in more.items():
        if isinstance(value, Tensor):
            value = value.detach().cpu().numpy()
        arrays[name] = np.array(value)
    return arrays


def started_from(start: Any, shape: tuple[int, int], device: torch.device) -> Tensor | None:
    """Return the initial object (H, W), float64 in image units; None for the solver's own start.

    ``start`` is an object, or a saved state that holds one. A `SamplingError` is raised if its
    shape is not that of the model, ``shape``, and a `SceneError` if it is not finite or missing.
    """
    if start is None:
        return None
    if isinstance(start, Mapping):
        if "object" not in start:
            raise SceneError(
                f"start contains {', '.join(start) or 'nothing'}, but no object; give a solver's "
                "state"
            )
        start = start["object"]
    if isinstance(start, Tensor):
        level = start.detach().to(device=device, dtype=torch.float64)
    else:
        try:
            level = torch.tensor(np.asarray(start, dtype=np.float64), device=device)
        except (TypeError, ValueError):
            raise SceneError(
                f"start of type {type(start).__name__} is not an array of numbers; give an object "
                "in image units, for example gain times object of a Reconstruction"
            ) from None
    if tuple(level.shape) != shape:
        raise SamplingError(
            f"start has shape {tuple(level.shape)}, must be {shape} like the model; resample it or "
            "leave it out"
        )
    if not bool(torch.isfinite(level).all()):
        raise SceneError("start holds values that are not finite; leave it out")
    return level
