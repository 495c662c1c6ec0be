"""Settings of the search for walls, of its descents and of its generations."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Stage:
    """Settings of one descent.

    ``iterations``: number of iterations. ``kappa``: strength of the object's prior; 0.5 to compare
    answers, 1 to 1.5 to search. ``first``, ``last``: ratio of the assumed noise to the actual one,
    at the start and from ``share`` on. ``share``: fraction of the iterations after which ``last``
    is reached. ``wave_rate``: largest step of a coefficient, waves; 0 keeps the coefficients.
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
class Neighbourhood:
    """Generations near the best walls, with the random changes of one to the next.

    ``generations``, ``litter``: largest number of generations, and children of each; they have a
    third as many parents. ``flips``: probability that a coefficient changes its sign. ``noise``:
    norm of a random change relative to the norm of the parent's coefficients.
    """

    generations: int
    litter: int
    flips: float
    noise: float


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
    trivial: Stage = Stage(400, 0.5, 3.0, 1.5, 0.3, 0.008)
    release: Stage = Stage(200, 0.5, 3.0, 1.5, 0.5, 0.01)
    compare: Stage = Stage(150, 0.5, 5.0, 1.5, 0.6, 0.015)
    free: Stage = Stage(200, 0.5, 2.0, 1.5, 0.3, 0.005)
    noises: tuple[float, ...] = (30.0, 10.0, 60.0, 20.0)  # at the beginning, round by round
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
    # Ratio of FFT grid to image, so that light leaving at one edge does not re-enter at the other.
    # A narrow grid is sufficient until an answer for one image is compared with no blur.
    padding: float = 1.5
    narrow: float = 1.125
    # norms of initial walls, too large rather than too small; relative to a known rms; and those
    # for one image relative to these, between two limits
    strengths: tuple[float, ...] = (0.3, 0.6, 1.0)
    around: tuple[float, ...] = (0.9, 1.1, 1.4)
    lengths: tuple[float, float] = (0.9, 1.5)
    sharp: float = 0.01  # norm of a wall without noticeable blur
    starts: int = 32
    near_starts: int = 4
    kept: int = 20  # walls of one image that are fitted further
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
    near_several: Neighbourhood = Neighbourhood(4, 12, 0.03, 0.25)
    near_noisy: Neighbourhood = Neighbourhood(12, 12, 0.03, 0.25)
    near_one: Neighbourhood = Neighbourhood(12, 24, 0.06, 0.3)
    # Relative distance of point spreads beyond which walls are different answers: in tests below
    # 0.2 for equal ones, above 0.34 for different ones. Correlation of the objects of two rounds
    # that found the same: right ones had 0.94 to 0.98 with each other at 5 % noise, others 0.3.
    other: float = 0.3
    same_object: float = 0.93
    standstill: float = 5.0  # decrease of the score per generation below which these end
    # Repetitions of the last fit for one image. Answers, different walls and fits without blur are
    # repeated alike, since the status compares their energies.
    repeats: int = 5
    # rounds with several images, with several with much noise, with one, with one and proposals
    rounds: tuple[int, int, int, int] = (2, 4, 5, 1)
    enough: int = 2  # rounds after which the search ends if it found no different wall


SETTINGS = Settings()
