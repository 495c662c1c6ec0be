"""Random walls, and random changes of good ones, for the search of blind fits."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from .free_energy import Floats, Starts
from .search_settings import Neighbourhood


def random_walls(count: int, modes: int, lengths: Floats, random: Generator) -> Floats:
    """Return coefficients (count, modes) with random directions and given norms.

    The norms ``lengths``, waves rms, are used in turn.
    """
    walls = random.normal(size=(count, modes))
    walls *= np.resize(lengths, count)[:, None] / np.linalg.norm(walls, axis=1, keepdims=True)
    return walls


def children(
    parents: Starts, count: int, twin: Floats, near: Neighbourhood, random: Generator
) -> Floats:
    """Return coefficients (count, M) that vary those of the best parents.

    ``parents``: parents by increasing energy; a better one is chosen with higher probability.
    ``count``: number of children. ``twin`` (M,): signs that convert a wall to the one with the same
    point spread, W(x) -> -W(-x). ``near``: size of the changes. ``random``: source of random
    numbers.

    A third of the children takes each coefficient from one of two parents, of which the second is
    replaced by its twin if that is closer. A third changes signs. Most others move in a random
    direction. A few change all signs, which mirrors the point spread.
    """
    walls = parents.coefficients.astype(np.float64)
    chances = np.linspace(1.0, 0.2, len(walls))
    chances /= chances.sum()
    found = []
    for kind in random.random(count):
        wall = walls[random.choice(len(walls), p=chances)].copy()
        length = float(np.linalg.norm(wall))
        if kind < 0.35:
            other = walls[random.choice(len(walls), p=chances)]
            if np.linalg.norm(wall - twin * other) < np.linalg.norm(wall - other):
                other = twin * other
            wall = np.where(random.random(wall.size) < 0.5, wall, other)
            wall += 0.15 * length * _direction(wall.size, random)
        elif kind < 0.65:
            flipped = random.random(wall.size) < near.flips
            flipped[random.integers(wall.size)] = True
            wall = np.where(flipped, -wall, wall)
        elif kind < 0.95:
            size = near.noise * length * random.uniform(0.5, 1.5)
            wall += size * _direction(wall.size, random)
        else:
            wall = -wall
        found.append(wall)
    return np.array(found)


def _direction(size: int, random: Generator) -> Floats:
    vector = random.normal(size=size)
    return vector / np.linalg.norm(vector)
