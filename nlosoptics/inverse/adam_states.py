"""Fitted values with Adam's moments as arrays, so that a fit goes on as if it had not ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import SamplingError, SceneError


def joined(parts: Sequence[Tensor]) -> Tensor:
    """Values of several tensors in one vector, (n,)."""
    # torch's own vector of parameters takes no channels_last
    return torch.cat([part.detach().reshape(-1) for part in parts])


def spread(name: str, values: Any, parts: Sequence[Tensor]) -> None:
    """Write a vector of values, (n,), into tensors.

    Raises
    ------
    SamplingError
        If it has more or fewer values than they.
    """
    vector = torch.from_numpy(np.array(values)).reshape(-1)
    sizes = [part.numel() for part in parts]
    if vector.numel() != sum(sizes):
        raise SamplingError(
            f"start has {vector.numel()} {name}, this fit {sum(sizes)}; it is of other images or "
            "another network, leave it out"
        )
    with torch.no_grad():
        for part, some in zip(parts, torch.split(vector, sizes), strict=True):
            part.copy_(some.reshape(part.shape))


def adam_state(name: str, adam: torch.optim.Adam) -> dict[str, Tensor]:
    """Values that Adam moves, their moments, and the steps that were made.

    Parameters
    ----------
    name : str
        What the values are, for the keys.
    adam : Adam
        All of whose values move in every step.
    """
    values = _values(adam)
    found = {name: joined(values)}
    if adam.state:
        for key in ("exp_avg", "exp_avg_sq"):
            found[f"{name}_{key}"] = joined([adam.state[part][key] for part in values])
        found[f"{name}_steps"] = adam.state[values[0]]["step"]
    return found


def take_up_adam(name: str, adam: torch.optim.Adam, state: Mapping[str, Any]) -> None:
    """Set values and moments to those of `adam_state`.

    Raises
    ------
    SceneError
        If the state holds no such values.
    SamplingError
        If it holds more or fewer.
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


def _values(adam: torch.optim.Adam) -> list[Tensor]:
    return [part for group in adam.param_groups for part in group["params"]]
