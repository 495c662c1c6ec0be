"""Steps of Adam optimisers, and their state as vectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import SamplingError

_MOMENTS = "exp_avg", "exp_avg_sq"  # torch's names of the means of gradients and their squares


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
        for key in _MOMENTS:
            found[f"{name}_{key}"] = joined([adam.state[part][key] for part in values])
        found[f"{name}_steps"] = adam.state[values[0]]["step"]
    return found


def take_up_adam(name: str, adam: torch.optim.Adam, state: Mapping[str, Any]) -> None:
    """Restore values and moments of an Adam optimiser, in place, from a dict of `adam_state`.

    A `SceneError` is raised if the state holds no such values, and a `SamplingError` if it holds
    more or fewer than the optimiser.
    """
    values = _values(adam)
    spread(name, state[name], values)
    if f"{name}_steps" not in state:
        return
    for part in values:
        adam.state[part] = {key: torch.zeros_like(part) for key in _MOMENTS}
        adam.state[part]["step"] = torch.tensor(float(state[f"{name}_steps"]))
    for key in _MOMENTS:
        spread(f"{name}_{key}", state[f"{name}_{key}"], [adam.state[part][key] for part in values])


def descend(adam: torch.optim.Adam, loss: Tensor) -> None:
    """Make one step of an Adam optimiser along the gradient of a loss, a single number."""
    adam.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    adam.step()


def _values(adam: torch.optim.Adam) -> list[Tensor]:
    return [part for group in adam.param_groups for part in group["params"]]
