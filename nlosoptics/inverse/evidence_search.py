"""Searches for the wave of least free energy, from random starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from .free_energy import Floats, FreeEnergy, Stage, Starts, joined

#: Told how far a search is, 0 to 1; true: stop now and return the best so far.
Watch = Callable[[float, str], bool]

# Several frames: strong noise first, so that all starts see one broad basin.
_GATHER = Stage(iterations=200, kappa=1.0, first=30.0, last=3.0, share=0.9, wave_rate=0.016)
_SETTLE = Stage(iterations=250, kappa=0.5, first=3.0, last=1.0, share=0.5, wave_rate=0.01)
_FINISH = Stage(iterations=250, kappa=0.5, first=1.5, last=1.0, share=0.3, wave_rate=0.006)

# One frame.
_TRIVIAL = Stage(iterations=400, kappa=0.5, first=2.0, last=1.0, share=0.3, wave_rate=0.008)
_REFINE = Stage(iterations=200, kappa=1.0, first=4.0, last=1.0, share=0.8, wave_rate=0.008)
_COMPARE = Stage(iterations=250, kappa=0.5, first=3.0, last=1.0, share=0.5, wave_rate=0.008)
_FREE = Stage(iterations=400, kappa=0.5, first=2.0, last=1.0, share=0.3, wave_rate=0.005)


@dataclass(frozen=True, kw_only=True)
class Breeding:
    """How children differ from their parents.

    Parameters
    ----------
    flips : float
        Chance of each coefficient to change its sign.
    noise : float
        Length of a random change over the parent's.
    """

    flips: float
    noise: float


def random_walls(count: int, modes: int, lengths: Floats, random: Generator) -> Floats:
    """Coefficients of random directions and given lengths in turn, (count, modes)."""
    walls = random.normal(size=(count, modes))
    walls *= np.resize(lengths, count)[:, None] / np.linalg.norm(walls, axis=1, keepdims=True)
    return walls


def children(
    parents: Starts, count: int, twin: Floats, breeding: Breeding, random: Generator
) -> Floats:
    """Coefficients like those of the best parents, (count, M).

    Parameters
    ----------
    parents : Starts
        Least energy first; each is likelier than the next.
    count : int
    twin : ndarray, (M,)
        Signs that turn a wall into the one with the same point spread, W(x) -> -W(-x).
    breeding : Breeding
    random : Generator

    Notes
    -----
    A third takes each coefficient from one of two parents, whose twins count as themselves; a third
    flips signs; the rest moves in a random direction; a few change all signs, which mirrors the
    point spread.
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
            flipped = random.random(wall.size) < breeding.flips
            flipped[random.integers(wall.size)] = True
            wall = np.where(flipped, -wall, wall)
        elif kind < 0.95:
            size = breeding.noise * length * random.uniform(0.5, 1.5)
            wall += size * _direction(wall.size, random)
        else:
            wall = -wall
        found.append(wall)
    return np.array(found)


def _direction(size: int, random: Generator) -> Floats:
    vector = random.normal(size=size)
    unit: Floats = vector / np.linalg.norm(vector)
    return unit


@dataclass(frozen=True, kw_only=True)
class Island:
    """Strengths of the prior, steps and noise that one search of a single frame runs with."""

    kappa: float
    wave_rate: float
    first: float
    radius: float


def evolve(
    energy: FreeEnergy, island: Island, twin: Floats, random: Generator, watch: Watch,
    *, population: int = 24, first_walls: int = 96, generations: tuple[int, int] = (5, 4), litter: int = 32,
) -> Starts:  # fmt: skip
    """Walls of one frame, held at one length: the best of random ones and of their children."""
    stage = Stage(
        iterations=200, kappa=island.kappa, first=island.first, last=2.0, share=0.9,
        wave_rate=island.wave_rate,
    )  # fmt: skip
    walls = random_walls(first_walls, energy.modes, np.array([island.radius]), random)
    pool = energy.descend(energy.starts(walls, stage.first, island.radius), stage)
    pool = pool.best(population)
    breeding = Breeding(flips=0.12, noise=0.35)
    for turn in range(generations[0]):
        if watch((turn + 1) / 12, "random walls"):
            return pool
        walls = children(pool[:12], litter, twin, breeding, random)
        young = energy.descend(energy.starts(walls, stage.first, island.radius), stage)
        pool = joined([pool, young]).best(population)
    pool = energy.descend(pool, _REFINE).best(population)
    breeding = Breeding(flips=0.06, noise=0.25)
    for turn in range(generations[1]):
        if watch((turn + 7) / 12, "finer walls"):
            return pool
        walls = children(pool[:12], litter, twin, breeding, random)
        young = energy.descend(energy.starts(walls, _REFINE.first, island.radius), _REFINE)
        pool = joined([pool, young]).best(population)
    return pool
