"""Settings of the search for walls, of its descents and of its generations."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Stage:
    """Settings of one descent.

    ``iterations``: number of iterations. ``kappa``: strength of the object's prior; 0.5 to compare
    answers, 1 to search. ``first``, ``last``: ratio of the assumed noise to the actual one, at the
    start and from ``share`` on. ``share``: fraction of the iterations after which ``last`` is
    reached. ``wave_rate``: largest step of a coefficient, waves; 0 keeps the coefficients.
    """

    iterations: int
    kappa: float
    first: float
    last: float
    share: float
    wave_rate: float

    def noise(self, iteration: int) -> float:
        """Return the ratio of the assumed noise to the actual one in an iteration."""
        done = min(1.0, iteration / (self.share * self.iterations))
        return self.first * math.exp(done * math.log(self.last / self.first))

    def pace(self, iteration: int) -> float:
        """Return the factor of both rates: 1 in the first half, then a cosine down to 5 %."""
        late = max(0.0, 2.0 * iteration / self.iterations - 1.0)
        return 0.05 + 0.95 * 0.5 * (1.0 + math.cos(math.pi * late))


@dataclass(frozen=True)
class Settings:
    """Settings of the search; norms of coefficients are in waves rms.

    A strong assumed noise at first gives all starts one broad basin of the energy, but hides thin
    strokes. Answers for one image are compared at 1.5 times the noise: errors of the model (higher
    modes, change over the field) then penalise the truth less than fitting the noise favours a wave
    without blur.
    """

    # several images, with much noise, and from the second round on
    gather: Stage = Stage(200, 1.0, 30.0, 3.0, 0.9, 0.016)
    gather_noisy: Stage = Stage(200, 1.0, 12.0, 1.5, 0.9, 0.016)
    gather_slowly: Stage = Stage(500, 1.0, 60.0, 3.0, 0.9, 0.016)
    settle: Stage = Stage(250, 0.5, 3.0, 1.0, 0.5, 0.01)
    finish: Stage = Stage(250, 0.5, 1.5, 1.0, 0.3, 0.006)
    # one image
    release: Stage = Stage(200, 0.5, 3.0, 1.5, 0.5, 0.01)
    compare: Stage = Stage(150, 0.5, 5.0, 1.5, 0.6, 0.015)
    free: Stage = Stage(200, 0.5, 2.0, 1.5, 0.3, 0.005)
    # proposed walls: the object first, then both
    proposed: tuple[Stage, ...] = (
        Stage(60, 0.5, 5.0, 5.0, 1.0, 0.0),
        Stage(250, 0.5, 5.0, 1.5, 0.7, 0.015),
    )
    # given coefficients with a known error: the object first, then both, then the best start alone
    near: tuple[Stage, ...] = (
        Stage(200, 0.5, 5.0, 5.0, 1.0, 0.0),
        Stage(400, 0.5, 5.0, 1.0, 0.7, 0.01),
        Stage(200, 0.5, 1.0, 1.0, 1.0, 0.004),
    )
    object_rate: float = 0.05  # largest step of the object, relative to the images' range
    softness: float = 0.1  # of the transition of object values to 0, relative to the images' range
    gain_error: float = 0.2  # standard deviation of the prior of the images' relative brightness
    # Ratio of FFT grid to image, so that light leaving at one edge does not re-enter at the other.
    # A narrow grid is sufficient until answers are compared.
    padding: float = 1.5
    narrow: float = 1.125
    # norms of random walls if unknown, and limits of the factors by which they vary; too large is
    # better than too small
    strengths: tuple[float, ...] = (0.3, 0.6, 1.0)
    lengths: tuple[float, float] = (0.9, 1.5)
    sharp: float = 0.01  # norm of a wall without noticeable blur
    starts: int = 32
    near_starts: int = 4
    pool: int = 12  # walls that a step passes to the next
    proposals: int = 24
    # walls that show which point spreads are expected for one image, the share of them beyond the
    # expected limit, and the penalty of a sharper one, per pixel and factor e of its sum of
    # squares. Before they settle, right walls have up to 300 more energy than sharp wrong ones.
    expected: int = 96
    spread_out: float = 0.1
    too_sharp: float = 0.2
    weak: float = 0.35  # expected norm up to which sharp point spreads are right ones
    tops: tuple[int, ...] = (21, 36, 45)  # largest Noll indices up to which modes are added
    # largest number of generations near the best walls: of several images, and of one or with much
    # noise; children in each, which have a third as many parents; norm of their random changes
    # relative to the parent's; probability that a coefficient changes its sign
    generations: tuple[int, int] = (4, 12)
    litter: int = 12
    litter_of_one: int = 24
    change: float = 0.3
    flips: float = 0.05
    # correlation of objects that count as the same: two rounds with the right one had 0.94 to 0.98
    # with each other at 5 % noise, others 0.3
    same_object: float = 0.93
    answers: int = 3  # different objects that are compared at the end
    # decrease of the score per generation or repetition below which these end
    standstill: float = 5.0
    repeats: int = 5  # of the last fit for one image
    # rounds for several images; with much noise, or for one image; for one with proposals
    rounds: tuple[int, int, int] = (2, 4, 1)


SETTINGS = Settings()
