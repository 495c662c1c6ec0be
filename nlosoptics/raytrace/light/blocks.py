"""Blocks of rays: light paths from the laser, eye paths from the lens, and their connections."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...kernels.codes import GROUPS, UNIT
from ...scene import Scene
from ..fans.paths import DETECTED
from . import _chain_kernels as chaining
from . import _connection_kernels as connecting
from . import _light_kernels as kernels
from . import _surround_kernels as surround
from .kept_paths import Kept, kept_paths
from .surroundings import Surroundings

Array = NDArray[np.float64]
LEDGER: Final = 0.25  # share of the rays continued when only the ledger still needs them
PARTNERS: Final = 4
#: Sums by unit and group, numbers of intersection tests, and kept paths of a block.
Traced = tuple[Array, Counter[str], list[Kept]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Job:
    """Scene and options common to all blocks of rays."""

    scene: Scene
    around: Surroundings
    sampler: tuple[Any, ...]  # seed, Sobol columns and shifts; see `kernels.random.draw`
    max_bounces: int
    analog: bool
    keep_paths: bool

    @property
    def columns(self) -> int:
        """Number of sums: one per number of reflections, and those of the power balance."""
        return self.max_bounces + 1 + kernels.SUMS


def traced(job: Job, first: int, end: int) -> Traced:
    """Trace the rays with the numbers ``first`` to ``end - 1``, and return their sums and paths."""
    return follow(Rays(job, first, end - first))


def follow(block: Rays) -> Traced:
    """Trace a block of rays from the laser, and return its sums and paths."""
    job, first = block.job, block.first
    light = block.from_laser()
    if not job.analog:
        block.look()
    before = np.zeros_like(light)
    before[:, kernels.DENSITY] = -1.0
    # without glossy lobes, vertices after this bounce contribute to the ledger only
    last_seen = 0 if job.around.plan.glossy else max(1, job.max_bounces - 1)
    for bounce in range(1, job.max_bounces + 1):
        block.walked.append(light)
        if not (light[:, kernels.SURFACE] >= 0.0).any():
            break
        if not job.analog:
            block.detect(light, before, bounce)
            if bounce == last_seen:
                kernels.thin(job.sampler, first, LEDGER, light)
        before, light = light, block.onward(light, bounce)
    units = block.sums.reshape(-1, GROUPS, job.columns)
    return units, block.counts, block.kept


@lru_cache(maxsize=8)
def _partners(n: int, count: int) -> list[tuple[NDArray[np.int64], Array]]:
    """Return rows and weights (n,) of the eye paths to which n light paths are connected, in turns.

    Partners are rays of the same group and unit whose numbers differ in the lowest bits. The points
    of a Sobol sequence with these bits turned are another such sequence, so that each turn alone is
    as evenly spread as pairs of equal rows. The weights (n,) of all turns add up to 1.
    """
    ray = np.arange(n)
    rows = [(ray // GROUPS ^ turn) * GROUPS + ray % GROUPS for turn in range(count)]
    there = sum(row < n for row in rows)
    return [(np.where(row < n, row, ray), (row < n) / there) for row in rows]


class Rays:
    """Block of n rays: light paths from the laser, eye paths from the lens, and connections."""

    def __init__(self, job: Job, first: int, n: int) -> None:
        self.job, self.first, self.n, self.around = job, first, n, job.around
        self.sums = np.zeros((-(-n // UNIT) * GROUPS, job.columns))
        self.counts = Counter[str](rays=n)
        self.origins, self.directions, self.starts, self.ends = np.empty((4, n, 3))
        self.leave = np.empty((n, kernels.LEAVE))
        self.live = np.ones(n, dtype=bool)
        self.fates = np.empty(n, dtype=np.int8)
        self.value, self.length = np.empty((2, n))
        self.watched = job.keep_paths
        self.walked: list[Array] = []
        self.partners: list[tuple[Array, Array, Array | float]] = []
        self.kept: list[Kept] = []

    def from_laser(self) -> Array:
        """Return the first vertices of the light paths, where the laser's rays hit a surface."""
        job, rays = self.job, (self.origins, self.directions)
        laser = job.around.world.laser
        surround.beam(laser, job.sampler, self.first, *rays)
        self.sources = self.origins.copy()
        hits = self._hits(None)
        new = np.zeros((self.n, kernels.VERTEX))
        kernels.start(
            laser[13], self.first, job.max_bounces, *rays, hits, new, self.sums, self.fates
        )
        self._settle(new)
        self._take_ended(new, 0)
        return new

    def look(self) -> None:
        """Compute the first vertices of the eye paths, and with glossy lobes the second ones.

        Eye paths are traced backward from the lens.
        """
        job, world, rays = self.job, self.around.world, (self.origins, self.directions)
        powers, densities = np.empty((2, self.n))
        surround.sight(world.camera, job.sampler, self.first, *rays, powers, densities)
        self.lens = self.origins.copy()
        np.greater(powers, 0.0, out=self.live)
        self.seen, self.further = np.zeros((2, self.n, kernels.VERTEX))
        kernels.look(*rays, powers, densities, self._hits(None), self.seen)
        self._settle(self.seen)
        # kept paths stay few, and the three strategies of glossy lobes gain nothing from partners
        count = 1 if job.keep_paths or self.around.plan.glossy else PARTNERS
        (_, share), *turns = _partners(self.n, count)
        self.partners = [(self.seen, self.lens, share)]
        self.partners += [(self.seen[rows], self.lens[rows], share) for rows, share in turns]
        if self.around.plan.glossy:
            self._scatter(self.seen, surround.DRAW_EYE, True)
            hits = self._hits(self.seen)
            kernels.look_on(world.norm, self.seen, self.leave, *rays, hits, self.further)
            self._settle(self.further)

    def onward(self, light: Array, bounce: int) -> Array:
        """Return the next vertices of the light paths, after scattering at those in ``light``."""
        job, number = self.job, surround.DRAW_FIRST
        if bounce > 1:
            number = surround.DRAW_NEXT + surround.DRAWS_A_BOUNCE * (bounce - 2)
        self._scatter(light, number, False)
        hits = self._hits(light)
        roulette = number + 4 if bounce > 3 and not job.analog else -1
        new = np.zeros((self.n, kernels.VERTEX))
        world = self.around.world
        kernels.land(
            (world.camera, world.norm, world.chains),
            job.sampler,
            self.first,
            (bounce, job.max_bounces, job.analog, roulette),
            light,
            self.leave,
            self.origins,
            self.directions,
            hits,
            new,
            self.sums,
            self.fates,
        )
        self._settle(new)
        self._take_ended(new, bounce)
        return new

    def detect(self, light: Array, before: Array, bounce: int) -> None:
        """Add the power that light vertices send to the detector after ``bounce`` reflections.

        ``before`` holds the preceding vertices of the light paths.
        """
        world, glossy, most = self.around.world, self.around.plan.glossy, self.job.max_bounces
        outputs = (self.value, self.length, self.starts, self.ends)
        if bounce == 1 or glossy:
            connecting.to_lens(world, light, before, self.lens, glossy, *outputs)
            self._book(light, light, bounce, (), self.lens)
        # the laser spot is much the same for all rays, so that partners would add nothing
        partners = self.partners if bounce > 1 else [(self.seen, self.lens, 1.0)]
        for seen, lens, share in partners if bounce + 1 <= most else ():
            connecting.connect(world, light, seen, seen, False, glossy, *outputs)
            self.value *= share
            self._book(light, seen, bounce + 1, (seen,), lens)
        if glossy and bounce + 2 <= most:
            connecting.connect(world, light, self.further, self.seen, True, glossy, *outputs)
            self._book(light, self.further, bounce + 2, (self.further, self.seen), self.lens)
        if self.around.chains.surfaces:
            longest = most - bounce if self.around.chains.both else min(1, most - bounce)
            for m in range(1, longest + 1):
                self._chain(light, bounce, m, False)
                if len(world.room):
                    self._chain(light, bounce, m, True)

    def _chain(self, light: Array, bounce: int, m: int, at_wall: bool) -> None:
        """Add the power of chains of ``m`` mirror-like reflections from vertices to the lens."""
        mirrors, chains = np.zeros((m, self.n, kernels.VERTEX)), self.around.chains
        chaining.chain_to_lens(
            self.around.world,
            self.around.chain_wall,
            self.job.sampler,
            self.first,
            light,
            self.lens,
            (bounce, m, at_wall),
            chains.several,
            chains.steepest,
            self.value,
            self.length,
            mirrors,
        )
        if not self.value.any():
            return
        on_wall = light[:, kernels.SURFACE] == surround.WALL
        self.starts[:] = light[:, kernels.P]
        for mirror in mirrors:
            self.ends[:] = mirror[:, kernels.P]
            self.around.clear(self.starts, self.ends, on_wall, self.value, self.counts)
            self.starts[:] = self.ends
            on_wall = mirror[:, kernels.SURFACE] == surround.WALL
        self.ends[:] = self.lens
        self._book(light, mirrors[-1], bounce + m, tuple(mirrors), self.lens, on_wall)

    def _scatter(self, vertices: Array, number: int, eye: bool) -> None:
        """Draw the directions in which the paths continue, from random number ``number`` on."""
        kernels.scatter(
            self.around.world,
            self.job.sampler,
            self.first,
            number,
            eye,
            vertices,
            self.leave,
            self.origins,
            self.directions,
            self.live,
        )

    def _settle(self, vertices: Array) -> None:
        """Move vertices exactly onto the wall, if light may travel from wall to wall."""
        if not self.around.plan.wall_to_wall:
            return
        on_wall = vertices[:, kernels.SURFACE] == surround.WALL
        self.around.settle(vertices[:, kernels.P], on_wall)

    def _hits(self, left: Array | None) -> Any:
        """Return the first hits of live rays; ``left`` are the vertices they start at, or None."""
        on_wall = np.zeros(self.n, dtype=bool)
        if left is not None:
            np.equal(left[:, kernels.SURFACE], surround.WALL, out=on_wall)
        return self.around.first_hits(
            self.origins, self.directions, self.live, on_wall, self.counts
        )

    def _book(
        self,
        light: Array,
        eye: Array,
        bounce: int,
        seen: tuple[Array, ...],
        lens: Array,
        on_wall: NDArray[np.bool_] | None = None,
    ) -> None:
        """Add the power of unblocked connections to the sums, and store their paths if wanted.

        ``light`` and ``eye`` are the connected vertices and ``bounce`` the number of reflections.
        ``seen`` holds the vertices between the light vertices and the points ``lens`` (n, 3) of
        the lens, for stored paths.
        ``on_wall`` (n,) tells whether a connection starts on the wall; by default this is the
        surface of the light vertices.
        """
        if on_wall is None:
            on_wall = light[:, kernels.SURFACE] == surround.WALL
        self.around.clear(self.starts, self.ends, on_wall, self.value, self.counts)
        connecting.book(
            light, eye, bounce, self.job.max_bounces, self.first, self.value, self.length, self.sums
        )
        if self.watched:
            self.take_detected(self.value, self.length, [*self.walked, *seen], lens, bounce)

    def _take_ended(self, new: Array, bounce: int) -> None:
        """Pass on paths that ended at the vertices ``new`` and that no connection stands for.

        In an analog trace these are all paths, otherwise those that smooth mirrors sent to the
        lens; see `_light_kernels.land`.
        """
        if not self.watched:
            return
        length, power, ends = new[:, kernels.LENGTH], new[:, kernels.POWER], new[:, kernels.P]
        detected = self.fates == DETECTED
        if self.job.analog and self.job.keep_paths:
            rows = np.flatnonzero((self.fates >= 0) & ~detected)
            self._keep(rows, power, length, self.walked, ends, bounce, self.fates[rows])
        elif bounce > 0 and not self.job.analog:
            detected &= self.leave[:, kernels.MIRROR] >= 0.0
            last = self.walked[-1]
            detected &= last[:, kernels.HISTORY] > 0.0
            power = power * (1.0 - last[:, kernels.LINKED])  # chains are traced separately
        if detected.any():
            self.take_detected(np.where(detected, power, 0.0), length, self.walked, ends, bounce)

    def take_detected(
        self, power: Array, length: Array, vertices: list[Array], ends: Array, bounce: int
    ) -> None:
        """Store the paths of detected light if wanted; called once for each set of such paths.

        ``power`` (n,) is the detected power of each ray's path, W times rays, 0 without a path;
        ``length`` (n,) its length from the laser to the lens, m; ``vertices`` are the reflecting
        vertices in the order of the light, and ``ends`` (n, 3) the points of the lens, m.
        """
        if self.job.keep_paths:
            rows = np.flatnonzero(power > 0.0)
            status = np.full(len(rows), DETECTED, dtype=np.int8)
            self._keep(rows, power, length, vertices, ends, bounce, status)

    def _keep(
        self,
        rows: NDArray[np.int64],
        power: Array,
        length: Array,
        vertices: list[Array],
        ends: Array,
        bounce: int,
        status: NDArray[np.int8],
    ) -> None:
        """Store the paths of the rays ``rows``; `take_detected` describes the other arguments."""
        lines = kept_paths(
            self.around.world,
            self.job.max_bounces,
            self.sources[rows],
            [vertex[rows] for vertex in vertices],
            ends[rows],
        )
        bounces = np.full(len(rows), bounce, dtype=np.int32)
        self.kept.append((*lines, length[rows], power[rows], bounces, status))
