"""Fast tier: figures of all draws from a second-order expansion of the wave in drawn values."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..errors import NlosError, SceneError
from ..psf import SceneOptics
from ..psf.pupil.scene_optics import PointOptics
from ..scene.file.addresses import value_at
from .design.designs import Spread
from .design.fast import fast_spreads
from .design.figures import Figure
from .design.point import StudyPoint, stage_caches
from .design.study import Study
from .design.values import canonical, label, number, with_unit
from .expansion import Expansion, first_steps
from .fast_figures import FastFigure, fast_figure
from .store import Store, reading

Array = NDArray[np.float64]
FEW_NODES: Final = 8  # of the first expansion, which shows how much the phase varies
MOST_NODES: Final = 100
BLOCK: Final = 1_000_000  # nodes of all draws that are evaluated together


def fast_key(study: Study, figure: Figure) -> str:
    """Return a text that is equal for equal draws and figures."""
    draws = {k: v for k, v in study.definition["draws"].items() if k != "check"}
    text = json.dumps([study.seed, draws, asdict(figure)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def fast_lacking(study: Study, store: Store) -> list[Figure]:
    """Return the figures of a fast study that its store lacks; none of another study."""
    if not study.fast:
        return []
    with reading(store.path):
        return [f for f in study.figures if store.fast(f.name, fast_key(study, f)) is None]


def keep_fast(study: Study, store: Store, found: Mapping[str, Array]) -> None:
    """Store values of `fast_values`, by figure."""
    for name, values in found.items():
        figure = study.figure(name)
        about = expanded_meaning(figure), figure.unit
        store.set_fast(name, fast_key(study, figure), values, *about)


def expanded_meaning(figure: Figure) -> str:
    """Return what a figure of the fast tier is."""
    return f"{figure.meaning}, expanded to second order in the drawn values"


def fast_values(study: Study, figures: Sequence[Figure]) -> dict[str, Array]:
    """Return figures of a fast study for all its draws, from expanded waves.

    Parameters
    ----------
    study : Study
        Study whose draws have ``tier = "fast"``.
    figures : sequence of Figure
        Figures to compute.

    Returns
    -------
    dict of str to (n,) ndarray
        Values by figure, in the order of the draws.

    Raises
    ------
    SceneError
        If a scene near the middle of the distributions has no wave that can be expanded.

    Notes
    -----
    The aberration at every pupil node, the amplitude, the landing points of rays and the values
    that pixels and lobes depend on are expanded about the medians of the distributions. The nodes
    move with the pupil. Tilt is removed from each wave before. A modulation is multiplied by its
    ratio to the full path's in the middle, where the window of the point spread cuts the tails.
    """
    waves = _Waves(study)
    coordinates = waves.coordinates()
    found = {}
    for figure in figures:
        if figure.source == "value":
            found[figure.name] = _given(study, str(figure.options["address"]))
        else:
            found[figure.name] = _expanded(waves, figure, coordinates)
    return found


class _Waves:
    """Waves of scenes about the middle of the distributions, each aimed once."""

    def __init__(self, study: Study) -> None:
        self.study = study
        self.spreads: dict[str, Spread] = fast_spreads(
            study.table, study.figures, lambda address: value_at(study.base.tables, address)
        )
        self._kept: dict[tuple[float, ...], PointOptics] = {}

    @property
    def middle(self) -> tuple[float, ...]:
        return (0.0,) * len(self.spreads)

    def coordinates(self) -> Array:
        """Return the draws (n, d), in widths from the middle."""
        found = []
        for delta in self.study.dimensions[0].deltas:
            row = [number(delta[address]) for address in self.spreads]
            found.append([math.nan if one is None else one[0] for one in row])
        middles = np.array([spread.middle for spread in self.spreads.values()])
        widths = np.array([spread.width for spread in self.spreads.values()])
        return np.asarray((np.array(found) - middles) / widths)

    def delta(self, place: tuple[float, ...]) -> dict[str, object]:
        """Return the values by address at coordinates."""
        return {
            address: canonical(with_unit(spread.middle + z * spread.width, spread.unit))
            for (address, spread), z in zip(self.spreads.items(), place, strict=True)
        }

    def seen(self, place: tuple[float, ...]) -> PointOptics:
        """Return the wave at coordinates."""
        if place not in self._kept:
            delta = self.delta(place)
            told = ", ".join(f"{address} = {label(value)}" for address, value in delta.items())
            try:
                optics = SceneOptics(self.study.base.scene(delta))
                why = unfit(optics)
            except NlosError as error:
                raise SceneError(
                    f"tier = 'fast' needs the wave at {told}: {error}; or use tier = 'full', or "
                    "narrower distributions"
                ) from None
            if why:
                raise SceneError(f"tier = 'fast' at {told}: {why}; use tier = 'full'")
            self._kept[place] = optics.reference
        return self._kept[place]

    def in_full(self, figure: Figure) -> float:
        """Return a figure of the full path in the middle."""
        point = StudyPoint(
            self.study.base, self.delta(self.middle), 0, self.study.tol, stage_caches()
        )
        return figure.value(point, self.study.folder)[0]


def unfit(optics: SceneOptics) -> str:
    """Return why the wave of a scene cannot be expanded; empty if it can."""
    if optics.scene.wall_roughness is not None:
        return "the wall has a roughness, whose point spread is no smooth function of the values"
    # a flat wall's edge is known before any ray is aimed
    if optics.exit_pupil.layout != "polar" or optics.reference.first.wave.layout != "polar":
        return "the wall's edge cuts the cone of light, so that the outline of the pupil varies"
    return "occluders cut the cone of light" if optics.reference.first.hidden else ""


def _expanded(waves: _Waves, figure: Figure, coordinates: Array) -> Array:
    """Return a figure of all draws (n,) from fields expanded at enough nodes."""
    size = coordinates.shape[1]
    # the first steps of all differences
    near = [waves.seen(tuple(place)) for place in first_steps(size)]
    fast = fast_figure(figure.source, figure.options, near)

    def expansion(n: int) -> Expansion:
        return Expansion.of(lambda place: fast.fields(waves.seen(place), n), size)

    found, n = expansion(FEW_NODES), FEW_NODES
    if fast.uses_nodes:
        n = _needed_nodes(found, coordinates)
        if n > MOST_NODES:
            raise SceneError(
                f"figure {figure.name}: phases of the draws need {n} x {n} nodes, limit "
                f"{MOST_NODES} for tier = 'fast'; use narrower distributions or tier = 'full'"
            )
        found = expansion(n) if n > FEW_NODES else found
    values = evaluated(fast, found, coordinates)
    if figure.source == "mtf":
        middle = evaluated(fast, found, np.zeros((1, size)))[0]
        values *= waves.in_full(figure) / middle
    return values


def _needed_nodes(found: Expansion, coordinates: Array) -> int:
    """Return the number of nodes along an axis that resolves the phase of every draw."""
    v = 0.0
    step = max(1, BLOCK // found.terms.shape[1])
    for first in range(0, len(coordinates), step):
        phase = found.at(coordinates[first : first + step])["phase"]
        v = max(v, 2 * math.pi * float(np.ptp(phase, axis=(-2, -1)).max()))
    return resolving_nodes(v)


def resolving_nodes(v: float) -> int:
    """Return the number of nodes along an axis for a phase with the range v, rad.

    So many Gauss-Legendre nodes integrate exp(i v s) over s from 0 to 1 to 1e-15.
    """
    return max(FEW_NODES, math.ceil(v / 4 + 3.1 * math.cbrt(v) + 6))


def evaluated(fast: FastFigure, found: Expansion, coordinates: Array) -> Array:
    """Return a figure (n,) at coordinates (n, d) from its expanded fields, block by block.

    Parameters
    ----------
    fast : FastFigure
        Figure of merit.
    found : Expansion
        Fields of the figure.
    coordinates : ndarray, (n, d)
        Draws in widths from the middle.
    """
    step = max(1, BLOCK // found.terms.shape[1])
    parts = [
        fast.values(found.at(coordinates[first : first + step]))
        for first in range(0, len(coordinates), step)
    ]
    return np.concatenate(parts)


def _given(study: Study, address: str) -> Array:
    """Return the values (n,) of an address in all draws."""
    own = value_at(study.base.tables, address)
    found = [number(delta.get(address, own)) for delta in study.dimensions[0].deltas]
    if None in found:
        raise SceneError(f"{address} = {label(own)} is not a number; name the address of a number")
    return np.array([one[0] for one in found if one is not None])
