"""Random draws that depend on their address alone, never on threads or call order."""

from __future__ import annotations

import numpy as np


def generator(seed: int, stream: int) -> np.random.Generator:
    """Counter-based generator (Philox) of one stage.

    Parameters
    ----------
    seed : int
        The user's seed, at least 0.
    stream : int
        Number of the stage that draws; different stages never share numbers.
    """
    return np.random.Generator(np.random.Philox(key=np.array([seed, stream], dtype=np.uint64)))
