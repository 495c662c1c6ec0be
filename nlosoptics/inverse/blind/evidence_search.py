"""Searches for the wave of least free energy, from random starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from .free_energy import Floats, FreeEnergy, Stage, Starts, joined

#: Progress callback with a text and the completed fraction. If it returns True, the search stops
#: and returns its best result so far.
Watch = Callable[[str, float], bool]

# Several images. A strong assumed noise at first gives all starts one broad basin of the energy.
_GATHER = Stage(iterations=200, kappa=1.0, first=30.0, last=3.0, share=0.9, wave_rate=0.016)
_GATHER_SLOWLY = Stage(iterations=500, kappa=1.0, first=60.0, last=3.0, share=0.9, wave_rate=0.016)
_SETTLE = Stage(iterations=250, kappa=0.5, first=3.0, last=1.0, share=0.5, wave_rate=0.01)
_FINISH = Stage(iterations=250, kappa=0.5, first=1.5, last=1.0, share=0.3, wave_rate=0.006)
#: Decrease of the energy per generation below which the search ends.
_STANDSTILL = 5.0

# One image. Answers are compared at 1.5 times the noise. Errors of the model (higher modes, change
# over the field) then penalise the truth less than fitting the noise favours a wave without blur.
_TRIVIAL = Stage(iterations=400, kappa=0.5, first=3.0, last=1.5, share=0.3, wave_rate=0.008)
_REFINE = Stage(iterations=200, kappa=1.0, first=4.0, last=1.5, share=0.8, wave_rate=0.008)
_COMPARE = Stage(iterations=250, kappa=0.5, first=5.0, last=1.5, share=0.6, wave_rate=0.01)
_FREE = Stage(iterations=200, kappa=0.5, first=2.0, last=1.5, share=0.3, wave_rate=0.005)

#: Norm of the coefficients of a wall without noticeable blur, waves rms.
_SHARP = 0.01


@dataclass(frozen=True, kw_only=True)
class Breeding:
    """Random changes of coefficients from one generation to the next.

    Parameters
    ----------
    flips : float
        Probability that a coefficient changes its sign.
    noise : float
        Norm of a random change relative to the norm of the parent's coefficients.
    """

    flips: float
    noise: float


def random_walls(count: int, modes: int, lengths: Floats, random: Generator) -> Floats:
    """Return coefficients (count, modes) with random directions and given norms.

    The norms ``lengths``, waves rms, are used in turn.
    """
    walls = random.normal(size=(count, modes))
    walls *= np.resize(lengths, count)[:, None] / np.linalg.norm(walls, axis=1, keepdims=True)
    return walls


def children(
    parents: Starts, count: int, twin: Floats, breeding: Breeding, random: Generator
) -> Floats:
    """Return coefficients (count, M) that vary those of the best parents.

    Parameters
    ----------
    parents : Starts
        Parents by increasing energy; a better one is chosen with higher probability.
    count : int
        Number of children.
    twin : ndarray, (M,)
        Signs that convert a wall to the one with the same point spread, W(x) -> -W(-x).
    breeding : Breeding
        Size of the changes.
    random : Generator
        Source of random numbers.

    Notes
    -----
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
    """Settings of one search for a single image.

    Parameters
    ----------
    radius : float
        Fixed norm of the coefficients, waves rms. Without it they would drift to a wave without
        blur.
    kappa : float
        Strength of the object's prior.
    first : float
        Initial ratio of the assumed noise to the actual one.
    wave_rate : float
        Largest step of a coefficient, waves.
    population : int
        Number of walls kept after each generation.
    litter : int
        Number of children per generation.
    generations : (int, int)
        Number of generations with strong and with weak assumed noise.
    """

    radius: float
    kappa: float = 1.5
    first: float = 10.0
    wave_rate: float = 0.016
    population: int = 24
    litter: int = 32
    generations: tuple[int, int] = (5, 4)


def gather(
    energy: FreeEnergy, lengths: Floats, count: int, *, slow: bool, random: Generator
) -> Starts:
    """Fit random walls to images of different defocus; return the best quarter by energy.

    Parameters
    ----------
    energy : FreeEnergy
        Energy of the images, which a wave without blur cannot explain.
    lengths : ndarray
        Initial norms of the coefficients, used in turn, waves rms.
    count : int
        Number of random walls.
    slow : bool
        Whether the assumed noise decreases slowly, which strong walls need.
    random : Generator
        Source of random numbers.
    """
    stage = _GATHER_SLOWLY if slow else _GATHER
    walls = random_walls(count, energy.modes, lengths, random)
    return energy.descend(energy.starts(walls, stage.first), stage).best(count // 4)


def without_blur(energy: FreeEnergy, random: Generator) -> Starts:
    """Fit from a wave without blur and from three weak ones; return results by energy."""
    walls = random_walls(4, energy.modes, np.array([0.1]), random)
    walls[0] = 0.0
    return energy.descend(energy.starts(walls, _TRIVIAL.first), _TRIVIAL).best(4)


def sharp(energy: FreeEnergy, random: Generator) -> Starts:
    """Fit with coefficients fixed near 0, so that the image itself serves as the object."""
    walls = random_walls(1, energy.modes, np.array([_SHARP]), random)
    return energy.descend(energy.starts(walls, _TRIVIAL.first, _SHARP), _TRIVIAL)


def evolve(
    energy: FreeEnergy, island: Island, twin: Floats, random: Generator, watch: Watch
) -> Starts:
    """Search walls for one image at a fixed norm of the coefficients; return the best.

    Random walls are fitted first, then several generations of their children.

    Parameters
    ----------
    energy : FreeEnergy
        Energy of the image.
    island : Island
        Settings of the search.
    twin : ndarray, (M,)
        Signs that convert a wall to the one with the same point spread; see `children`.
    random : Generator
        Source of random numbers.
    watch : callable
        Progress callback; if it returns True, the search stops.
    """
    coarse = Stage(
        iterations=200,
        kappa=island.kappa,
        first=island.first,
        last=2.0,
        share=0.9,
        wave_rate=island.wave_rate,
    )
    walls = random_walls(4 * island.population, energy.modes, np.array([island.radius]), random)
    pool = energy.descend(energy.starts(walls, coarse.first, island.radius), coarse)
    pool = pool.best(island.population)
    total, done = sum(island.generations) + 2, 1
    stages = (
        (coarse, Breeding(flips=0.12, noise=0.35)),
        (_REFINE, Breeding(flips=0.06, noise=0.25)),
    )
    for (stage, breeding), turns in zip(stages, island.generations, strict=True):
        if stage is _REFINE:
            pool = energy.descend(pool, stage).best(island.population)
            done += 1
        for _ in range(turns):
            if watch("walls and their children", done / total):
                return pool
            walls = children(pool[:12], island.litter, twin, breeding, random)
            young = energy.descend(energy.starts(walls, stage.first, island.radius), stage)
            pool = joined([pool, young]).best(island.population)
            done += 1
    return pool


def refine(
    energy: FreeEnergy,
    pool: Starts,
    twin: Floats,
    random: Generator,
    *,
    least_length: float,
    generations: int,
    enough: Callable[[Starts], bool],
    watch: Watch,
    frames: bool = False,
) -> Starts:
    """Fit walls with the prior that ranks answers, and children of the best; sort by energy.

    The descent alone can stop in a local minimum whose object is right within a few per cent.
    Children with objects of their own can leave it.

    Parameters
    ----------
    energy : FreeEnergy
        Energy of the images.
    pool : Starts
        Walls by increasing energy.
    twin : ndarray, (M,)
        Signs that convert a wall to the one with the same point spread; see `children`.
    random : Generator
        Source of random numbers.
    least_length : float
        Smallest norm of the coefficients, waves rms. Walls below it approach no blur and are
        dropped.
    generations : int
        Largest number of generations of children.
    enough : callable
        Returns whether the best wall needs no further generation.
    watch : callable
        Progress callback; if it returns True, the search stops.
    frames : bool
        Whether there are images of different defocus. Then the norms are known better, and answers
        are compared at the actual noise.
    """
    compare, finish = (_SETTLE, _FINISH) if frames else (_COMPARE, _FREE)
    found = energy.descend(pool.best(8).held(np.inf), compare).best(8)
    for turn in range(generations):
        if enough(found) or watch("near the best walls", turn / generations):
            break
        walls = children(found[:4], 12, twin, Breeding(flips=0.03, noise=0.25), random)
        # the assumed norm is usually too large, so the first generations also try smaller ones
        least = 0.8 if turn < 2 and not frames else 0.95
        walls *= random.uniform(least, 1.05, size=(len(walls), 1))
        both = joined([found, energy.descend(energy.starts(walls, compare.first), compare)])
        before = float(found.energy[0])
        long = np.linalg.norm(both.coefficients, axis=1) >= least_length
        found = (both[long] if long.any() else found).best(8)
        if frames and before - found.energy[0] < _STANDSTILL:
            break
    return energy.descend(found.best(2), finish).best(2)
