"""Random draws that depend on their address alone, never on threads or call order."""

from __future__ import annotations

import numpy as np

from ._checks import whole

MOST_SEED = 2**64 - 1


def checked_seed(seed: int) -> int:
    """Return ``seed`` as an int of 64 bits, the key of the generator, or raise `SceneError`."""
    return whole("seed", seed, 0, MOST_SEED)


def generator(seed: int, stream: int) -> np.random.Generator:
    """Counter-based generator (Philox) of one stage.

    Parameters
    ----------
    seed : int
        The user's seed, 0 to 2^64 - 1.
    stream : int
        Number of the stage that draws; different stages never share numbers.
    """
    key = np.array([checked_seed(seed), stream], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key))
