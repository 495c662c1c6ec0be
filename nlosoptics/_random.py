"""Counter-based random numbers, independent of the number of threads and the order of calls."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ._checks import whole


def checked_seed(seed: int) -> int:
    """Return ``seed`` as an integer from 0 to 2^64 - 1, or raise `SceneError`."""
    return whole("seed", seed, 0, 2**64 - 1)


def generator(seed: int, stream: int) -> np.random.Generator:
    """Return a counter-based generator (Philox) for one stage of a computation.

    Different numbers ``stream`` of stages get independent streams of the user's seed.
    """
    key = np.array([checked_seed(seed), stream], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key))


# Primitive polynomials (degree, coefficients) and first direction numbers of Sobol dimensions 2 on:
# Joe and Kuo, SIAM J. Sci. Comput. 30, 2635 (2008)
_JOE_KUO = (
    (1, 0, (1,)),
    (2, 1, (1, 3)),
    (3, 1, (1, 3, 1)),
    (3, 2, (1, 1, 1)),
    (4, 1, (1, 1, 3, 3)),
    (4, 4, (1, 3, 5, 13)),
    (5, 2, (1, 1, 5, 5, 17)),
    (5, 4, (1, 1, 5, 5, 5)),
    (5, 7, (1, 1, 7, 11, 19)),
    (5, 11, (1, 1, 5, 1, 1)),
    (5, 13, (1, 1, 1, 3, 11)),
    (5, 14, (1, 3, 5, 5, 31)),
    (6, 1, (1, 3, 3, 9, 7, 49)),
    (6, 13, (1, 1, 1, 15, 21, 21)),
    (6, 16, (1, 3, 1, 13, 27, 49)),
    (6, 19, (1, 1, 1, 15, 7, 5)),
    (6, 22, (1, 3, 1, 15, 13, 25)),
    (6, 25, (1, 1, 5, 5, 19, 61)),
    (7, 1, (1, 3, 7, 11, 23, 15, 103)),
    (7, 4, (1, 3, 7, 13, 13, 15, 69)),
)
SOBOL_DIMENSIONS = len(_JOE_KUO) + 1


@cache
def sobol_columns() -> NDArray[np.uint32]:
    """Return the generating columns of the Sobol sequence, (SOBOL_DIMENSIONS, 32).

    The first digit is the most significant bit.
    """
    columns = np.empty((SOBOL_DIMENSIONS, 32), dtype=np.uint32)
    columns[0] = 1 << np.arange(31, -1, -1, dtype=np.uint32)
    for row, (degree, polynomial, first) in zip(columns[1:], _JOE_KUO, strict=True):
        values = [m << (31 - i) for i, m in enumerate(first)]
        for i in range(degree, 32):
            value = values[i - degree] ^ (values[i - degree] >> degree)
            for k in range(1, degree):
                if polynomial >> (degree - 1 - k) & 1:
                    value ^= values[i - k]
            values.append(value)
        row[:] = values
    columns.flags.writeable = False
    return columns


def scrambled_sobol(
    seed: int, stream: int, groups: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return generating columns and digital shifts of independently scrambled Sobol sequences.

    Each group is scrambled by a random lower triangular matrix over the digits and a random shift.
    Every point is then uniformly distributed, and the variance equals that of Owen's scrambling
    (Matousek, J. Complexity 14, 527, 1998). The columns have the shape
    (groups, SOBOL_DIMENSIONS, 32), the shifts (groups, SOBOL_DIMENSIONS).
    """
    from .kernels import random

    draw = generator(seed, stream)
    shape = (groups, SOBOL_DIMENSIONS)
    # each digit keeps itself and is added to random lower digits
    unit = np.uint32(1) << np.arange(32, dtype=np.uint32)
    matrices = draw.integers(0, 2**32, size=(*shape, 32), dtype=np.uint32) & (unit - 1) | unit
    scrambled = np.empty((*shape, 32), dtype=np.uint32)
    random.scramble(sobol_columns(), matrices, scrambled)
    return scrambled, draw.integers(0, 2**32, size=shape, dtype=np.uint32)


def philox(counters: NDArray[np.uint32], seed: int) -> NDArray[np.uint32]:
    """Return four random 32-bit words for each counter (..., 4), by Philox4x32-10 [1]_.

    References
    ----------
    .. [1] Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC 2011.
    """
    from .kernels import random

    counters = np.asarray(counters, dtype=np.uint32)
    words = np.empty(counters.shape, dtype=np.uint32)
    random.philox(counters.reshape(-1, 4), np.uint64(checked_seed(seed)), words.reshape(-1, 4))
    return words
