"""Random draws that depend on their address alone, never on threads or call order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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


def philox(counters: NDArray[np.uint32], seed: int) -> NDArray[np.uint32]:
    """Four random words for each address: Philox4x32-10 [1]_ for arrays of counters.

    Parameters
    ----------
    counters : ndarray of uint32, (..., 4)
        Addresses.
    seed : int
        Key, 0 to 2^64 - 1.

    Returns
    -------
    ndarray of uint32, (..., 4)

    References
    ----------
    .. [1] Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC 2011.
    """
    low, shift = np.uint64(0xFFFFFFFF), np.uint64(32)
    seed = checked_seed(seed)
    k0, k1 = seed & 0xFFFFFFFF, seed >> 32
    a, b, c, d = np.moveaxis(np.asarray(counters, dtype=np.uint64), -1, 0)
    for _ in range(10):
        first, second = a * np.uint64(0xD2511F53), c * np.uint64(0xCD9E8D57)
        a, b = (second >> shift) ^ b ^ np.uint64(k0), second & low
        c, d = (first >> shift) ^ d ^ np.uint64(k1), first & low
        k0, k1 = (k0 + 0x9E3779B9) & 0xFFFFFFFF, (k1 + 0xBB67AE85) & 0xFFFFFFFF
    return np.stack([a, b, c, d], axis=-1).astype(np.uint32)
