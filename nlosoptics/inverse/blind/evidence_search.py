"""Search for the wave of least free energy, in steps between which it can be saved and resumed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.random import Generator

from ..._random import generator
from ...errors import SamplingError, SceneError
from ..data.arrays import check_shape
from ..data.reconstruction import registered_correlation
from .free_energy import Floats, FreeEnergy, Starts, joined
from .search_settings import SETTINGS, Neighbourhood
from .verdict import Verdict
from .wall_proposals import Proposals

#: Callback with a text and the completed fraction; returns whether the search is to end.
Watch = Callable[[str, float], bool]
#: Free energy on an FFT grid wider than the images by the given factor, for given Noll indices.
Energies = Callable[[float, tuple[int, ...]], FreeEnergy]

HISTORY = ("objective", "residual", "change")
NUMBERS = ("turn", "count", "met", "floor", "sharp", "held", "rival")


@dataclass(eq=False, kw_only=True)
class Place:
    """Position and results of a search after a step.

    ``turn``, ``count``, ``met``: number of the round, -1 before the first one, of repetitions of
    the step, and of rounds that found the best answer; the last one for several images with much
    noise. ``step``: name of the next step. ``floor``, ``sharp``: free energies of the fits that
    start without blur and that have no blur; NaN if not needed. ``held``: energy that the prior of
    the coefficients would add to the former. ``rival``: for one image the least free energy of
    walls of another point spread, minus that of the best answer; NaN before the end of the first
    round. ``modes``: Noll indices of ``best``. ``pool``: starts of the current round; empty before
    its first step. ``best``: best answer so far, one start; empty before the first one.
    ``history``: energy, residual and change after each improvement or round.
    """

    turn: int = -1
    count: int = 0
    met: int = 0
    step: str = "reference"
    floor: float = math.nan
    sharp: float = math.nan
    held: float = math.nan
    rival: float = math.nan
    modes: tuple[int, ...]
    pool: Starts
    best: Starts
    history: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in HISTORY})

    def saved(self) -> dict[str, Any]:
        """Return all that a resumed search needs, as arrays."""
        arrays: dict[str, Any] = {
            "place": [STEPS.index(self.step), *(getattr(self, name) for name in NUMBERS)],
            "modes": self.modes,
            "history": np.array([self.history[name] for name in HISTORY]),
        }
        for name, starts in (("pool", self.pool), ("best", self.best)):
            arrays |= {f"{name}_{key}": values for key, values in vars(starts).items()}
        return arrays

    @classmethod
    def of(cls, state: Any, like: Starts, modes: int) -> Place:
        """Return the place of a saved state.

        ``like`` are starts of the resumed fit, with ``modes`` coefficients.
        """
        if not isinstance(state, Mapping):
            raise SceneError(
                f"start of type {type(state).__name__} is no saved state; give a state of "
                "evidence_fit, or leave it out"
            )
        names = [f"{part}_{entry.name}" for part in ("pool", "best") for entry in fields(Starts)]
        names += ["place", "modes", "history"]
        missing = [name for name in names if name not in state]
        if missing:
            raise SceneError(
                f"start holds no {missing[0]}; give a state of evidence_fit, or leave it out"
            )

        def kept(part: str, count: int) -> Starts:
            arrays: dict[str, Floats] = {}
            for name, mine in vars(like).items():
                arrays[name] = np.array(state[f"{part}_{name}"], dtype=mine.dtype)
                given, wanted = arrays[name].shape[1:], mine.shape[1:]
                if name == "coefficients":
                    wanted = (count,)
                if given != wanted:
                    raise SamplingError(
                        f"start's {name} have shape {given} for each start, this fit's {wanted}; "
                        "it belongs to other images or modes, leave it out"
                    )
            return Starts(**arrays)

        wide = tuple(np.asarray(state["modes"], dtype=int).tolist())
        numbers = np.asarray(state["place"], dtype=float)
        check_shape("start's place", numbers, (8,), "in this version; leave it out")
        step, turn, count, met, *energies = numbers.tolist()
        return cls(
            step=STEPS[int(step)],
            **dict(zip(NUMBERS, [int(turn), int(count), int(met), *energies], strict=True)),
            modes=wide,
            pool=kept("pool", modes),
            best=kept("best", len(wide)),
            history=dict(zip(HISTORY, np.asarray(state["history"]).tolist(), strict=True)),
        )


class Search:
    """Search of one fit, step by step; each step draws from its own stream of random numbers.

    ``energies``: returns the free energy for a padding and Noll indices. ``verdict``: tests of
    answers. ``first`` (M,): given coefficients of the wall, waves rms; zeros if there are none.
    ``start_error``: expected rms error of the given coefficients, waves; None: they are only one
    more start. ``strength``: known rms of the walls' waves, waves. ``proposals``: proposed walls
    for one image; None: there are none. ``rounds``: largest number of rounds; None: the default.
    ``seed``: seed of the random numbers. ``state``: saved state to resume from.

    ``place``: position and results.
    """

    def __init__(
        self,
        energies: Energies,
        verdict: Verdict,
        *,
        first: Floats,
        start_error: float | None,
        strength: float | None,
        proposals: Proposals | None,
        rounds: int | None,
        seed: int,
        state: Any,
    ) -> None:
        self._energies, self._verdict = energies, verdict
        self._first, self._error, self._strength = first, start_error, strength
        self._proposals, self._seed = proposals, seed
        modes = verdict.modes
        self._energy = energies(SETTINGS.padding, modes)
        self._prior = self._energy
        if start_error is not None:
            self._prior = self._energy.about(first, start_error)
        self._frames = verdict.several
        self._noisy = verdict.vague and start_error is None
        usual = int(self._noisy) if self._frames else 2 if proposals is None else 3
        self._rounds = SETTINGS.rounds[usual] if rounds is None else rounds
        #: sum of squares of a point spread above which walls are penalised
        self._sharpness = math.inf
        if not self._frames and start_error is None and self._expected_length() > SETTINGS.weak:
            self._sharpness = self._expected_sharpness()
        self._flat = self._energy.starts(np.zeros((1, len(modes))), SETTINGS.trivial.first)
        self.place = Place(modes=modes, pool=self._flat[:0], best=self._flat[:0])
        if state is not None:
            self.place = Place.of(state, self._flat, len(modes))

    @property
    def faults(self) -> tuple[str, ...]:
        """Reason against the best answer; empty if it passes all tests."""
        place = self.place
        if self._noisy and (doubts := self._verdict.doubts(place.modes, place.met)):
            return doubts
        return self._verdict.faults(
            place.best,
            self.margins,
            place.rival,
            expected=self._expected_length(),
            held=place.held,
            start_error=self._error,
        )

    @property
    def margins(self) -> tuple[float, float]:
        """Energy of the best answer minus those of the fits that start and that stay sharp."""
        place = self.place
        if not len(place.best):
            return math.nan, math.nan
        energy = float(place.best.energy[0])
        return energy - place.floor, energy - place.sharp

    def energy(self) -> FreeEnergy:
        """Return the free energy with the best answer's modes."""
        return self._wider(self.place.modes)

    def best(self) -> Starts:
        """Return the best answer so far; before the first one, an object without blur."""
        return self.place.best if len(self.place.best) else self._flat

    def run(self, watch: Watch) -> None:
        """Make steps until the search ends or ``watch`` asks it to."""
        while self.place.step != "end":
            now, count = self.place.step, self.place.count
            phase, text, stream = self.phases[now]
            part = (STEPS.index(now) + count / 10.0) / len(STEPS)
            whole = self.place.turn + part if self.place.turn >= 0 else 0.1 * part - 0.1
            if watch(text, (whole + 0.1) / (self._rounds + 0.1)):
                return
            stream = 100 * (13 * (self.place.turn + 1) + stream) + count
            step = phase(self, generator(self._seed, stream))
            self.place.count = count + 1 if step == now else 0
            self.place.step = step

    def finished(self) -> None:
        """Fit an answer quickly if the search ended before it had one."""
        if len(self.place.best):
            return
        pool, last = self.place.pool, SETTINGS.finish if self._frames else SETTINGS.free
        if not len(pool):
            pool = self._energy.starts(self._first[None], last.first)
        free = replace(pool.best(1), radius=np.array([np.inf]))
        self._offer(self._energy.descend(free, last))

    def _reference(self, random: Generator) -> str:
        """Fit without blur, which an answer for one image has to beat."""
        if not self._frames:
            walls = random_walls(4, len(self._energy.modes), np.array([0.1]), random)
            walls[0] = 0.0
            if self._error is not None:
                found = self._energy.starts(walls[:1], SETTINGS.near[1].first)
                for stage in SETTINGS.near[1:]:
                    found = self._energy.descend(found, stage)
                self.place.held = float(self._prior.held(found.coefficients)[0])
                self.place.floor = float(found.energy[0])
            else:
                found = self._energy.starts(walls, SETTINGS.trivial.first)
                found = _settled(
                    self._energy, self._energy.descend(found, SETTINGS.trivial).best(1)
                )
                flat = random_walls(1, len(self._energy.modes), np.array([SETTINGS.sharp]), random)
                flat_starts = self._energy.starts(flat, SETTINGS.trivial.first, SETTINGS.sharp)
                self.place.floor = float(found.energy[0])
                flat_starts = self._energy.descend(flat_starts, SETTINGS.trivial)
                self.place.sharp = float(_settled(self._energy, flat_starts).energy[0])
                self._offer(found)
        if self._error is not None:
            return "near"
        if self._first.any():
            return "given"
        return self._next()

    def _near(self, random: Generator) -> str:
        """Fit from given coefficients of known error."""
        assert self._error is not None  # the step exists only then
        count, pool = self.place.count, self.place.pool
        if count == 0:
            walls = random_walls(
                SETTINGS.near_starts, len(self._energy.modes), np.array([self._error]), random
            )
            walls[0] = 0.0
            pool = self._prior.starts(self._first + walls, SETTINGS.near[0].first)
        pool = self._prior.descend(pool, SETTINGS.near[count])
        if count < 2:
            self.place.pool = pool.best(1 if count else len(pool))
            return "near"
        self._offer(pool)
        return "widen" if self._frames else "end"

    def _given(self, _: Generator) -> str:
        """Fit from given coefficients of unknown error, one start among others."""
        settle = SETTINGS.settle if self._frames else SETTINGS.compare
        pool = self._energy.starts(self._first[None], SETTINGS.near[0].first)
        pool = self._energy.descend(self._energy.descend(pool, SETTINGS.near[0]), settle)
        self._offer(_settled(self._energy, pool, self._frames))
        self.place.met = 1
        return "widen" if self._frames else self._next()

    def _gather(self, random: Generator) -> str:
        """Fit random walls."""
        slow = self._frames and self.place.turn > 0 and not self._noisy
        stage = SETTINGS.gather_slowly if slow else SETTINGS.gather
        if self._noisy:
            stage = SETTINGS.gather_noisy
        starts = SETTINGS.starts
        lengths = np.resize(self._strengths(), starts) * (1.3 if slow else 1.0)
        if not self._frames:
            noises = SETTINGS.noises
            stage = replace(stage, first=noises[self.place.turn % len(noises)])
            lengths = lengths * random.uniform(*SETTINGS.lengths, starts)
        walls = random_walls(starts, len(self._energy.modes), lengths, random)
        energy = self._searched()
        self.place.pool = energy.descend(energy.starts(walls, stage.first), stage)
        return "settle"

    def _propose(self, random: Generator) -> str:
        """Fit proposed walls, with objects of their own."""
        assert self._proposals is not None  # the step exists only then
        energy, walls = self._searched(), self._proposals.walls(SETTINGS.proposals, random)
        pool = energy.starts(walls, SETTINGS.proposed[0].first)
        for stage in SETTINGS.proposed:
            pool = energy.descend(pool, stage)
        self.place.pool = self._ranked(pool, SETTINGS.pool)
        return "neighbours"

    def _expected_length(self) -> float:
        """Return the norm of the coefficients that is told or proposed, waves rms; else NaN."""
        if self._strength is not None:
            return self._strength
        return math.nan if self._proposals is None else self._proposals.length

    def _expected_sharpness(self) -> float:
        """Return the sum of squares that the point spreads of most expected walls exceed."""
        random = generator(self._seed, 12)
        if self._proposals is None:
            lengths = np.array([self._expected_length()])
            walls = random_walls(SETTINGS.expected, len(self._energy.modes), lengths, random)
        else:
            walls = self._proposals.walls(SETTINGS.expected, random)
        return float(np.quantile(self._searched().sharpness(walls), SETTINGS.spread_out))

    def _scores(self, starts: Starts) -> Floats:
        """Return the energies (B,), increased where the point spread is unexpectedly sharp.

        Without this, one image draws the search to waves that approach no blur.
        """
        if self._sharpness == math.inf:
            return starts.energy
        excess = np.log(self._searched().sharpness(starts.coefficients) / self._sharpness)
        penalty = SETTINGS.too_sharp * self._verdict.pixels
        return starts.energy + penalty * np.maximum(excess, 0.0)

    def _ranked(self, starts: Starts, count: int) -> Starts:
        """Return the ``count`` starts of least score, least first."""
        return starts[np.argsort(self._scores(starts), kind="stable")[:count]]

    def _settle(self, _: Generator) -> str:
        """Fit the best walls with the prior that ranks answers."""
        count, stage = (8, SETTINGS.settle) if self._frames else (SETTINGS.kept, SETTINGS.release)
        pool = self._searched().descend(self.place.pool.best(count), stage)
        self.place.pool = self._ranked(pool, SETTINGS.pool)
        return "neighbours"

    def _neighbours(self, random: Generator) -> str:
        """Fit children of the best walls, with objects of their own.

        The descent alone can stop in a local minimum whose object is right within a few per cent.
        """
        pool, frames, energy = self.place.pool, self._frames, self._searched()
        near = (
            SETTINGS.near_noisy
            if self._noisy
            else SETTINGS.near_several
            if frames
            else SETTINGS.near_one
        )
        well = frames and not self._noisy and self._verdict.well(pool)
        if well or self.place.count == near.generations:
            return "finish"
        twin = np.ones(len(energy.modes)) if frames else energy.twin
        walls = children(pool[: near.litter // 3], near.litter, twin, near, random)
        stage = SETTINGS.settle if frames else SETTINGS.compare
        both = joined([pool, energy.descend(energy.starts(walls, stage.first), stage)])
        self.place.pool = self._ranked(both, SETTINGS.pool)
        before, now = (float(self._scores(one[:1])[0]) for one in (pool, self.place.pool))
        return "neighbours" if before - now >= SETTINGS.standstill else "finish"

    def _finish(self, _: Generator) -> str:
        place, before = self.place, self.place.best
        found = self._ranked(_settled(self._energy, place.pool[:2], self._frames), 1)
        if self._noisy:
            self._count(found)
        self._offer(found)
        if self._frames:
            # a wrong wall that noise hides can need more modes: a right one is sought first
            last = place.met > 1 or place.turn + 1 == self._rounds
            return "widen" if last or not self._noisy else self._next()
        # energies of the narrow grid are compared among themselves
        energy = self._searched()
        other = energy.apart(place.pool, place.best.coefficients) > SETTINGS.other
        walls = _settled(energy, joined([place.pool[other].best(4), before, place.best]))
        other = energy.apart(walls, walls[-1:].coefficients) > SETTINGS.other
        found = walls.energy[other].min(initial=math.inf) - walls.energy[-1]
        lowered = float(before.energy[0] - place.best.energy[0])
        place.rival = float(np.fmin(place.rival + lowered, found))
        return self._next()

    def _count(self, found: Starts) -> None:
        """Count a round that found the best answer, or start anew with a better one."""
        place, best = self.place, self.place.best
        if not len(best):
            place.met = 1
            return
        if self._energy.known:  # any two rounds have its object
            equal = place.modes == self._energy.modes
            same = equal and self._energy.apart(found, best.coefficients)[0] < SETTINGS.other
        else:
            one, other = (self._energy.objects(starts)[0] for starts in (found, best))
            same = registered_correlation(one, other) > SETTINGS.same_object
        if same:
            place.met += 1
        elif found.energy[0] < best.energy[0]:
            place.met = 1

    def _widen(self, _: Generator) -> str:
        """Add modes while the residual has structure and they lower the energy."""
        place = self.place
        tops = [top for top in SETTINGS.tops if top > max(self._energy.modes)]
        if place.count < len(tops) and self._verdict.structured(place.best):
            added = [mode for mode in range(4, tops[place.count] + 1) if mode not in place.modes]
            modes = (*place.modes, *added)
            wide = self._wider(modes)
            wider = np.pad(place.best.coefficients, ((0, 0), (0, len(added))))
            found = wide.descend(replace(place.best, coefficients=wider), SETTINGS.finish)
            # Schwarz (1978): a parameter costs half the logarithm of the number of data
            least = 0.5 * math.log(self._verdict.pixels) * len(added)
            if float(place.best.energy[0] - found.energy[0]) > least:
                self._offer(found, modes)
            return "widen"
        return self._next()

    def _next(self) -> str:
        """Return the first step of the next round, or the end."""
        place = self.place
        place.turn += 1
        if place.turn == self._rounds or (len(place.best) and not self.faults):
            return "end"
        if place.turn == SETTINGS.enough and self._verdict.alone(place.rival):
            return "end"
        return "gather" if self._proposals is None else "propose"

    def _offer(self, found: Starts, modes: tuple[int, ...] | None = None) -> None:
        """Keep the start of least score, and record it in the history."""
        place, best = self.place, self._ranked(found, 1)
        if not len(place.best) or self._scores(best)[0] < self._scores(place.best)[0]:
            place.best, place.modes = best, self._energy.modes if modes is None else modes
        now, history = float(place.best.energy[0]), place.history
        before = history["objective"][-1] if history["objective"] else math.inf
        history["objective"].append(now)
        history["residual"].append(math.sqrt(float(place.best.chi_square[0].mean())))
        change = (before - now) / max(abs(now), 1.0) if math.isfinite(before) else 1.0
        history["change"].append(change)

    def _wider(self, modes: tuple[int, ...]) -> FreeEnergy:
        return (
            self._energy if modes == self._energy.modes else self._energies(SETTINGS.padding, modes)
        )

    def _searched(self) -> FreeEnergy:
        """Return the energy that a round descends."""
        return self._energy if self._frames else self._energies(SETTINGS.narrow, self._energy.modes)

    def _strengths(self) -> tuple[float, ...]:
        """Return the norms of initial walls, used in turn, waves rms."""
        if self._strength is not None:
            known = self._strength
            return tuple(known * factor for factor in SETTINGS.around) if self._frames else (known,)
        return SETTINGS.strengths

    #: Steps in their order: method, text, and the stream of random numbers, of 13 in a round.
    phases: ClassVar[dict[str, tuple[Callable[[Search, Generator], str], str, int]]] = {
        "reference": (_reference, "no blur", 0),
        "near": (_near, "about the given wall", 1),
        "given": (_given, "about the given wall", 2),
        "gather": (_gather, "random walls", 3),
        "settle": (_settle, "best walls", 8),
        "neighbours": (_neighbours, "near the best walls", 9),
        "finish": (_finish, "best walls", 10),
        "widen": (_widen, "more modes", 11),
        "propose": (_propose, "proposed walls", 12),
    }


STEPS = (*Search.phases, "end")


def _settled(energy: FreeEnergy, starts: Starts, frames: bool = False) -> Starts:
    """Fit answers a last time; those for one image until no energy decreases much."""
    found = energy.descend(starts, SETTINGS.finish if frames else SETTINGS.free)
    for _ in range(0 if frames else SETTINGS.repeats):
        before, found = found.energy, energy.descend(found, SETTINGS.free)
        if (before - found.energy).max() < SETTINGS.standstill:
            break
    return found


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
