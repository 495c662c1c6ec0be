"""Searches for the wave of least free energy, from random starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from .free_energy import Floats, FreeEnergy, Stage, Starts, joined

#: Told what a search does and how far it is, 0 to 1; true: stop now and return the best so far.
Watch = Callable[[str, float], bool]

# Several frames: strong noise first, so that all starts see one broad basin.
_GATHER = Stage(iterations=200, kappa=1.0, first=30.0, last=3.0, share=0.9, wave_rate=0.016)
_GATHER_SLOWLY = Stage(iterations=500, kappa=1.0, first=60.0, last=3.0, share=0.9, wave_rate=0.016)
_SETTLE = Stage(iterations=250, kappa=0.5, first=3.0, last=1.0, share=0.5, wave_rate=0.01)
_FINISH = Stage(iterations=250, kappa=0.5, first=1.5, last=1.0, share=0.3, wave_rate=0.006)
#: Gain of energy by a generation under which the next is not worth its time.
_STANDSTILL = 5.0

# One frame. Answers are compared at 1.5 times the noise: what the model lacks (higher modes, change
# over the field) then costs the truth less than no blur gains by following the noise.
_TRIVIAL = Stage(iterations=400, kappa=0.5, first=3.0, last=1.5, share=0.3, wave_rate=0.008)
_REFINE = Stage(iterations=200, kappa=1.0, first=4.0, last=1.5, share=0.8, wave_rate=0.008)
_COMPARE = Stage(iterations=250, kappa=0.5, first=5.0, last=1.5, share=0.6, wave_rate=0.01)
_FREE = Stage(iterations=200, kappa=0.5, first=2.0, last=1.5, share=0.3, wave_rate=0.005)

#: Length of a wall that blurs nothing, waves rms.
_SHARP = 0.01


@dataclass(frozen=True, kw_only=True)
class Breeding:
    """Mutation of coefficients from one generation to the next.

    Parameters
    ----------
    flips : float
        Probability that a coefficient changes its sign.
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
    """Strengths of the prior, steps and noise that one search of a single frame runs with.

    Parameters
    ----------
    radius : float
        Length that the coefficients are held at, waves rms: free ones drift to no blur.
    kappa : float
        Strength of the object's prior.
    first : float
        Assumed noise over the true one, at the start.
    wave_rate : float
        Largest step of a coefficient, waves.
    population : int
        Walls that are kept.
    litter : int
        Children of a generation.
    generations : (int, int)
        Under strong noise, then under weak.
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
    """Walls of frames that no blur cannot explain: the best of random ones, least energy first.

    Parameters
    ----------
    energy : FreeEnergy
    lengths : ndarray
        Of the coefficients at the start, in turn, waves rms.
    count : int
    slow : bool
        Give the noise more time to fall, which strong walls need.
    random : Generator
    """
    stage = _GATHER_SLOWLY if slow else _GATHER
    walls = random_walls(count, energy.modes, lengths, random)
    return energy.descend(energy.starts(walls, stage.first), stage).best(count // 4)


def without_blur(energy: FreeEnergy, random: Generator) -> Starts:
    """Fit from no blur and from nearly none; return the starts by increasing energy."""
    walls = random_walls(4, energy.modes, np.array([0.1]), random)
    walls[0] = 0.0
    return energy.descend(energy.starts(walls, _TRIVIAL.first), _TRIVIAL).best(4)


def sharp(energy: FreeEnergy, random: Generator) -> Starts:
    """Fit with coefficients kept near 0, so that the image itself serves as the object."""
    walls = random_walls(1, energy.modes, np.array([_SHARP]), random)
    return energy.descend(energy.starts(walls, _TRIVIAL.first, _SHARP), _TRIVIAL)


def evolve(
    energy: FreeEnergy, island: Island, twin: Floats, random: Generator, watch: Watch
) -> Starts:
    """Walls of one frame, held at one length: the best of random ones and of their children.

    Parameters
    ----------
    energy : FreeEnergy
    island : Island
    twin : ndarray, (M,)
        As of `children`.
    random : Generator
    watch : Watch
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
    """Walls under the prior that orders answers, and children near them; least energy first.

    A descent alone stops in side valleys whose objects are right within a few per cent; children
    of their walls, from objects of their own, get out.

    Parameters
    ----------
    energy : FreeEnergy
    pool : Starts
        Least energy first.
    twin : ndarray, (M,)
        As of `children`.
    random : Generator
    least_length : float
        Of the coefficients, waves rms; shorter ones are on their way to no blur and are dropped.
    generations : int
    enough : callable
        Whether the best wall needs no more of them.
    watch : Watch
    frames : bool
        Several frames that no blur cannot explain: their lengths are not guessed, and answers are
        compared at the noise itself.
    """
    compare, finish = (_SETTLE, _FINISH) if frames else (_COMPARE, _FREE)
    found = energy.descend(pool.best(8).held(np.inf), compare).best(8)
    for turn in range(generations):
        if enough(found) or watch("near the best walls", turn / generations):
            break
        walls = children(found[:4], 12, twin, Breeding(flips=0.03, noise=0.25), random)
        # a radius is a guess, rather too large than too small: the first look further down
        least = 0.8 if turn < 2 and not frames else 0.95
        walls *= random.uniform(least, 1.05, size=(len(walls), 1))
        both = joined([found, energy.descend(energy.starts(walls, compare.first), compare)])
        before = float(found.energy[0])
        long = np.linalg.norm(both.coefficients, axis=1) >= least_length
        found = (both[long] if long.any() else found).best(8)
        if frames and before - found.energy[0] < _STANDSTILL:
            break
    return energy.descend(found.best(2), finish).best(2)
