"""Designs: the dimensions of a study, each with the values that its steps change."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts are loaded lazily, on first use
from numpy.typing import NDArray

from ...errors import SceneError
from ...scene.file.errors import located
from ...scene.parts.library import MaterialValue, entry
from .file import Distribution, Draws, Range, StudyTable
from .values import canonical, label, number, with_unit

Array = NDArray[np.float64]
Delta = Mapping[str, Any]
#: Largest number of points.
MOST_POINTS = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Dimension:
    """One dimension of a design.

    Parameters
    ----------
    name : str
        An address, or "zip", "case" (one at a time), "draw", or "trial" (of a search).
    deltas : tuple of mapping
        Values by address at each step.
    """

    name: str
    deltas: tuple[Delta, ...]

    @property
    def addresses(self) -> tuple[str, ...]:
        """Addresses that the steps change, in order of appearance."""
        return tuple(dict.fromkeys(address for delta in self.deltas for address in delta))

    def labels(self) -> tuple[str, ...]:
        """Return a text for each step, such as "wall.radius = 5 m"."""
        return tuple(
            ", ".join(f"{address} = {label(value)}" for address, value in delta.items())
            or "nominal"
            for delta in self.deltas
        )


def dimensions(table: StudyTable, value_of: Callable[[str], Any]) -> tuple[Dimension, ...]:
    """Return the dimensions of a study file; the points are their product."""
    found = []
    if table.optimise is not None:
        found.append(Dimension(name="trial", deltas=()))  # grows as the search goes on
    for address, given in table.axes.items():
        values = listed(f"axes.{address}", given)
        found.append(Dimension(name=address, deltas=tuple({address: v} for v in values)))
    if table.zip:
        found.append(_zipped({a: listed(f"zip.{a}", v) for a, v in table.zip.items()}))
    if table.one_at_a_time:
        cases: list[Delta] = [{}]
        for address, given in table.one_at_a_time.items():
            cases += [{address: v} for v in listed(f"one_at_a_time.{address}", given)]
        found.append(Dimension(name="case", deltas=tuple(cases)))
    if table.draws is not None:
        found.append(_drawn(table.draws, table.seed, value_of))
    seen: set[str] = set()
    for dimension in found:
        if twice := seen & set(dimension.addresses):
            raise SceneError(f"{min(twice)} is varied twice in the study; remove one of them")
        seen |= set(dimension.addresses)
    count = float(np.prod([float(len(d.deltas)) for d in found if d.name != "trial"]))
    if not found:
        raise SceneError(
            "the design is empty; add [axes], [zip], [one_at_a_time], [draws] or [optimise] with "
            "addresses and values"
        )
    if count > MOST_POINTS:
        raise SceneError(f"the design has {count:.3g} points, limit {MOST_POINTS:,}; use fewer")
    return tuple(found)


def listed(name: str, given: list[Any] | Range) -> list[Any]:
    """Return the values of an axis in SI units; ``name`` is its key, for messages."""
    if isinstance(given, Range):
        low, high, unit = span(name, given, ordered=False)
        space = np.linspace if given.spacing == "linear" else np.geomspace
        return [with_unit(value, unit) for value in space(low, high, given.count).tolist()]
    if not given:
        raise SceneError(f"{name} = [] has no values; give at least one")
    values = [canonical(value) for value in given]
    if len({None if (n := number(v)) is None else n[1] for v in values}) > 1:
        raise SceneError(f"{name} = {given} mixes units; give values of one dimension")
    seen: set[str] = set()
    for value in values:
        text = repr(number(value) or value)
        if text in seen:
            raise SceneError(f"{name} lists {label(value)} twice; remove one of them")
        seen.add(text)
    return values


def numbers(name: str, *values: Any) -> tuple[list[float], str]:
    """Return numbers of one unit, and that unit."""
    found = [number(value) for value in values]
    for value, one in zip(values, found, strict=True):
        if one is None:
            raise SceneError(f"{name}: {value!r} is not a number with a known unit; correct it")
    units = {one[1] for one in found if one is not None}
    if len(units) > 1:
        raise SceneError(
            f"{name}: {', '.join(map(str, values))} have different units; give one unit"
        )
    return [one[0] for one in found if one is not None], units.pop()


def span(name: str, given: Any, *, ordered: bool = True) -> tuple[float, float, str]:
    """Return the limits ``low`` and ``high`` of a table and their unit, checked."""
    (low, high), unit = numbers(name, given.low, given.high)
    if ordered and not low < high:
        raise SceneError(f"{name}: from = {low:g} is not below to = {high:g}; exchange them")
    if given.spacing == "log" and min(low, high) <= 0.0:
        raise SceneError(f"{name}: spacing = log needs values above 0; give such limits")
    return low, high, unit


def _zipped(columns: dict[str, list[Any]]) -> Dimension:
    """Return one dimension along which several addresses change together."""
    counts = {address: len(values) for address, values in columns.items()}
    if len(set(counts.values())) > 1:
        told = ", ".join(f"{address} has {n}" for address, n in counts.items())
        raise SceneError(f"zip: lists have different lengths: {told}; make them equal")
    rows = zip(*columns.values(), strict=True)
    return Dimension(name="zip", deltas=tuple(dict(zip(columns, row, strict=True)) for row in rows))


def _drawn(draws: Draws, seed: int, value_of: Callable[[str], Any]) -> Dimension:
    """Return the dimension of random draws."""
    laws = _laws(draws)
    quantiles = [_quantile(address, given, value_of) for address, given in laws.items()]
    uniform = np.clip(_uniform(draws, tuple(laws), seed), 2.0**-53, 1.0 - 2.0**-53)
    columns = [quantile(u) for quantile, u in zip(quantiles, uniform.T, strict=True)]
    rows = zip(*columns, strict=True)
    return Dimension(name="draw", deltas=tuple(dict(zip(laws, row, strict=True)) for row in rows))


def named_materials(table: StudyTable) -> dict[str, str]:
    """Return the materials whose spread is drawn, by address; the base scene gets them."""
    found = {}
    for address, given in (table.draws.of if table.draws else {}).items():
        if isinstance(given, list) or given.spread_of is None:
            continue
        if not address.endswith(".material"):
            raise SceneError(
                f"draws.of.{address}: spread_of belongs to wall.material or hidden.material, whose "
                "values it draws; write one of them"
            )
        if table.set.get(address, given.spread_of) != given.spread_of:
            raise SceneError(
                f"set.{address} is not {given.spread_of}, of which draws.of.{address} draws the "
                "spread; remove one of them"
            )
        with located(f"draws.of.{address}.spread_of = "):
            entry(given.spread_of)
        found[address] = given.spread_of
    return found


def _laws(draws: Draws) -> dict[str, list[Any] | Distribution]:
    """Return the distributions by address, with one for each value of a named material."""
    laws: dict[str, list[Any] | Distribution] = {}
    for address, given in draws.of.items():
        found: dict[str, list[Any] | Distribution] = {address: given}
        if not isinstance(given, list) and given.spread_of is not None:
            place = f"draws.of.{address}"
            if given.model_fields_set != {"spread_of"}:
                raise SceneError(f"{place}: spread_of goes with no other key; remove the others")
            found = {
                address + value.address: _spread(value) for value in entry(given.spread_of).values
            }
        if twice := laws.keys() & found.keys():
            raise SceneError(f"{min(twice)} is drawn twice; remove one of its distributions")
        laws |= found
    return laws


def _spread(value: MaterialValue) -> Distribution:
    """Return the uniform distribution of a material's value; of its logarithm beyond 1 to 4."""
    return Distribution.model_validate(
        {
            "from": with_unit(value.low, value.unit),
            "to": with_unit(value.high, value.unit),
            "spacing": "log" if value.high > 4.0 * value.low else "linear",
        }
    )


def _uniform(draws: Draws, addresses: tuple[str, ...], seed: int) -> Array:
    """Return points of the unit cube, (n, len(addresses)); n is a multiple of the draws."""
    count, size = draws.count, len(addresses)
    if draws.method == "random":
        return np.stack([_stream(seed, a).random(count) for a in addresses], axis=1)
    rng = _stream(seed, draws.method)
    if draws.method == "latin":
        return np.asarray(scipy.stats.qmc.LatinHypercube(size, rng=rng).random(count))
    if count & (count - 1):
        near = 1 << count.bit_length()
        raise SceneError(
            f"draws.count = {count} is not a power of 2, which method {draws.method} needs; use "
            f"{near // 2} or {near}"
        )
    if draws.method == "sobol":
        return np.asarray(scipy.stats.qmc.Sobol(size, rng=rng).random(count))
    # rows A, B and A with one column of B (Saltelli 2010), draw by draw, so that more draws append
    both = np.asarray(scipy.stats.qmc.Sobol(2 * size, rng=rng).random(count))
    a, b = both[:, None, :size], both[:, None, size:]
    mixed = np.where(np.eye(size, dtype=bool), b, a)
    return np.concatenate([a, b, mixed], axis=1).reshape(-1, size)


def _stream(seed: int, name: str) -> np.random.Generator:
    """Return the random generator of one address or method."""
    digest = hashlib.sha256(name.encode()).digest()
    key = [seed, int.from_bytes(digest[:8], "little")]
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))


def _quantile(
    address: str, given: list[Any] | Distribution, value_of: Callable[[str], Any]
) -> Callable[[Array], list[Any]]:
    """Return the values of a distribution as a function of numbers from 0 to 1, (n,)."""
    name = f"draws.of.{address}"
    if isinstance(given, list):
        values = listed(name, given)
        return lambda u: [values[i] for i in (u * len(values)).astype(int)]
    limits = [given.low, given.high]
    if given.sigma is None:
        if None in limits or given.mean is not None:
            raise SceneError(f"{name} needs sigma, or from and to; add them")
        low, high, unit = span(name, given)
        if given.spacing == "log":
            return lambda u: [with_unit(v, unit) for v in low * (high / low) ** u]
        return lambda u: [with_unit(v, unit) for v in low + (high - low) * u]
    mean = value_of(address) if given.mean is None else given.mean
    if mean is None:
        raise SceneError(f"{name}.mean is missing, and the scene has no {address}; add mean")
    if given.spacing == "log":
        raise SceneError(f"{name}: spacing = log does not go with sigma; remove one of them")
    ends = [v for v in limits if v is not None]
    (centre, sigma, *_), unit = numbers(name, mean, given.sigma, *ends)
    if not sigma > 0.0:
        raise SceneError(f"{name}.sigma = {sigma:g} is not above 0; give a width")
    low = -np.inf if given.low is None else numbers(name, given.low)[0][0]
    high = np.inf if given.high is None else numbers(name, given.high)[0][0]
    if not low < high:
        raise SceneError(f"{name}: from = {low:g} is not below to = {high:g}; exchange them")
    law = scipy.stats.truncnorm((low - centre) / sigma, (high - centre) / sigma, centre, sigma)
    return lambda u: [with_unit(v, unit) for v in law.ppf(u)]
