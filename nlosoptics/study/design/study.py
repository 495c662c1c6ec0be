"""Design study: a base scene, the points of a design, and figures of merit."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from ..._checks import in_range, path_of, whole
from ..._nouns import Noun
from ...errors import SceneError
from ...scene import Scene
from ...scene.file.addresses import value_at
from ...scene.file.errors import located, validated
from .base import Base
from .designs import Delta, Dimension, dimensions, named_materials
from .figures import FIGURES, Figure, figure, with_compensation
from .file import StudyTable
from .searches import check_search
from .values import number
from .variables import Variable, check_variable, variable


def _plain(value: Any) -> Any:
    """Return a number or array of numpy as JSON holds it; anything else as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _figures_and_variables(
    table: StudyTable, folder: Path, base: Base, dimensions: tuple[Dimension, ...]
) -> tuple[tuple[Figure, ...], tuple[Variable, ...]]:
    """Return the figures of a study, with those after compensation, and the search's variables."""
    adjusted = {} if table.compensate is None else table.compensate.variables
    variables = search_variables(table, base)
    compensators = _variables("compensate.variables", adjusted, base)
    for one in (*variables, *compensators):
        check_variable(one, base)
    figures = tuple(figure(given, folder) for given in table.figures)
    units = {v.address: v.unit for v in (*variables, *compensators)}
    for dimension in dimensions:
        for address in dimension.addresses:
            units[address] = (number(dimension.deltas[-1].get(address)) or (0.0, ""))[1]
    figures = tuple(_with_unit(one, base, units) for one in figures)
    if table.compensate is not None:
        figures = with_compensation(figures, table.compensate, folder, compensators)
    if table.optimise is not None:  # figures that it limits are computed as well
        sought = {e.figure: 0 for e in (*table.optimise.objectives, *table.optimise.constraints)}
        lacking = sought.keys() & FIGURES.keys() - {f.name for f in figures}
        figures += tuple(figure(name, folder) for name in sought if name in lacking)
    names = [f.name for f in figures]
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"figures names {name} twice; give one of them another name")
    if table.optimise is not None:
        varied = {address for dimension in dimensions for address in dimension.addresses}
        check_search(table.optimise, variables, varied | set(adjusted), tuple(names))
    return figures, variables


def search_variables(table: StudyTable, base: Base) -> tuple[Variable, ...]:
    """Return the values that the search of a study may change; empty if it has no search."""
    given = {} if table.optimise is None else table.optimise.variables
    return _variables("optimise.variables", given, base)


def _variables(name: str, given: Mapping[str, Any], base: Base) -> tuple[Variable, ...]:
    return tuple(
        variable(f"{name}.{address}", address, one, value_at(base.tables, address), base)
        for address, one in given.items()
    )


def _with_unit(one: Figure, base: Base, units: Mapping[str, str]) -> Figure:
    """Return a figure, that of a value with the unit of its address."""
    if one.source != "value":
        return one
    address = str(one.options["address"])
    found = value_at(base.tables, address)
    if found is None and address not in units:
        raise SceneError(f"figures: value of {address}: the scene has no such value; correct it")
    return replace(
        one, unit=units.get(address, "") if found is None else (number(found) or (0.0, ""))[1]
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Study(Noun):
    """Design study: figures of merit that are computed for many variants of a scene.

    Make one with `load` or `from_tables`. The variants are called points. Each changes some values
    of the base scene: along axes, at random, or as an optimisation chooses.

    Parameters
    ----------
    definition : dict
        Tables of the study file.
    folder : Path
        Folder of the study file. It is searched for Python files with figures of merit of your own.
    base : Base
        Base scene, with the values that the table ``set`` of the study file changes.
    dimensions : tuple of Dimension
        What varies. A dimension is an axis, the random draws, or a list of cases, and it consists
        of steps: values of the axis, single draws, or single cases. The points are all combinations
        of the steps, in C order: the last dimension changes fastest.
    figures : tuple of Figure
        Figures of merit.
    tol : float
        Error tolerance of point spread functions, max |dI|/max I, with I the intensity.
    seed : int
        Seed of random draws, of random numbers in figures of merit, and of an optimisation.
    variables : tuple of Variable
        Values that an optimisation (table ``optimise``) may change; empty without one. With an
        optimisation, the first of ``dimensions`` is "trial", with one step for each set of values
        that has been tried so far.

    See Also
    --------
    plan_study : Predict number of points, time and size.
    run_study : Run a study, or continue it.
    optimum : Best trials of an optimisation.

    Examples
    --------
    Strehl ratio, and modulation at 60 cycles per m on the object, of three stops and two laser
    powers. The powers share the point spread of a stop, so that three are computed:

    >>> from nlosoptics.study import Study, plan_study
    >>> study = Study.from_tables(
    ...     {
    ...         "scene": "examples/scenes/letter_flat.toml",
    ...         "figures": ["strehl", {"figure": "mtf", "frequency": 60.0}],
    ...         "axes": {"camera.f_number": [2, 4, 8], "laser.power": ["5 mW", "20 mW"]},
    ...     }
    ... )
    >>> study.shape, plan_study(study).point_spreads
    ((3, 2), 3)
    """

    definition: dict[str, Any]
    folder: Path
    base: Base
    dimensions: tuple[Dimension, ...]
    figures: tuple[Figure, ...]
    tol: float
    seed: int
    variables: tuple[Variable, ...] = ()

    @classmethod
    def load(cls, path: str | Path) -> Study:
        """Read a study file.

        Parameters
        ----------
        path : str or Path
            Study file (TOML). The page "Choose a design with a study" of the documentation
            describes its tables. Paths in the file are relative to its folder.

        Raises
        ------
        SceneError
            If the file cannot be read, or a key, a value, the name of a scene's value (such as
            "camera.f_number") or a figure of merit is wrong. The message names file and key.
        """
        path = path_of("path", path)
        try:
            tables = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise SceneError(
                f"{path}: the study file cannot be read ({why}); give the path of a TOML file"
            ) from None
        with located(f"{path}: "):
            return cls.from_tables(tables, path.parent)

    @classmethod
    def from_tables(cls, tables: Mapping[str, Any], folder: str | Path = ".") -> Study:
        """Make a study from a dict with the contents of a study file.

        Parameters
        ----------
        tables : mapping
            Tables, keys and values as in a study file; ``scene`` may also be a `Scene`.
        folder : str or Path
            Folder to which paths in ``tables`` are relative.

        Raises
        ------
        SceneError
            If a key, a value, the name of a scene's value (such as "camera.f_number") or a figure
            of merit is wrong.
        """
        folder, scene = path_of("folder", folder).absolute(), tables.get("scene")
        tables = {**tables, "scene": "scene"} if isinstance(scene, Scene) else dict(tables)
        definition = json.loads(json.dumps(tables, default=_plain))
        table: StudyTable = validated(StudyTable, definition)
        changes = table.set | named_materials(table)
        if isinstance(scene, Scene):
            base = Base.of(scene, changes)
        else:
            base = Base.read(folder / table.scene, changes)
        found = dimensions(table, lambda address: value_at(base.tables, address))
        packed = tuple(
            Dimension(name=d.name, deltas=tuple(base.packed(delta) for delta in d.deltas))
            for d in found
        )
        for dimension in packed:
            for delta in dimension.deltas[:1] if dimension.name == "draw" else dimension.deltas:
                base.checked(delta)
        figures, variables = _figures_and_variables(table, folder, base, packed)
        return cls(
            definition=definition,
            folder=folder,
            base=base,
            dimensions=packed,
            figures=figures,
            tol=in_range("tol", table.tol, 1e-12, 0.1),
            seed=table.seed,
            variables=variables,
        )

    @cached_property
    def table(self) -> StudyTable:
        """Tables of the study file, after checks and with defaults filled in."""
        found: StudyTable = validated(StudyTable, self.definition)
        return found

    def with_trials(self, deltas: Iterable[Delta]) -> Study:
        """Return a copy of the study with given trials of its search.

        Each element of ``deltas`` holds the values of one trial by address (table and key of the
        scene file, such as "camera.f_number").
        """
        first, *others = self.dimensions
        return replace(self, dimensions=(replace(first, deltas=tuple(deltas)), *others))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of steps along each dimension."""
        return tuple(len(dimension.deltas) for dimension in self.dimensions)

    def __len__(self) -> int:
        """Return the number of points."""
        return int(np.prod(self.shape))

    def delta(self, index: int) -> dict[str, Any]:
        """Return the values of the scene that a point changes.

        The keys are addresses (table and key of the scene file, such as "camera.f_number").

        Parameters
        ----------
        index : int
            Number of the point, counted from 0 in C order: the last dimension changes fastest.
        """
        index = whole("index", index, 0, len(self) - 1)
        steps = np.unravel_index(index, self.shape)
        found: dict[str, Any] = {}
        for dimension, step in zip(self.dimensions, steps, strict=True):
            found |= dimension.deltas[int(step)]
        return found

    def scene(self, index: int) -> Scene:
        """Return the scene of a point.

        Parameters
        ----------
        index : int
            Number of the point, counted from 0 in C order: the last dimension changes fastest. For
            given steps it is ``np.ravel_multi_index(steps, study.shape)``.
        """
        return self.base.scene(self.delta(index))

    def figure(self, name: str) -> Figure:
        """Return the figure of merit with the given name."""
        for one in self.figures:
            if one.name == name:
                return one
        known = ", ".join(f.name for f in self.figures)
        raise SceneError(f"figure = {name!r} is unknown, must be one of {known}")

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Identifier of each point: a hash of the values that it changes and the study's seed.

        The order of the values does not matter.
        """
        steps = product(*(dimension.deltas for dimension in self.dimensions))
        return tuple(
            point_id(self.seed, {a: v for part in step for a, v in part.items()}) for step in steps
        )


def point_id(seed: int, delta: Mapping[str, Any]) -> str:
    """Return the name of a point, which depends on its values and the study's seed only."""
    text = json.dumps([seed, sorted(delta.items())])
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def point_seed(name: str) -> int:
    """Return the seed of the random numbers of a point with an id."""
    return int(name[:16], 16)


def differing_steps(study: Study, other: Study) -> Iterator[str]:
    """Yield which values of another study's dimensions a study lacks."""
    mine = {d.name: d for d in study.dimensions}
    theirs = {d.name: d for d in other.dimensions}
    for name in theirs.keys() - mine.keys():
        yield f"dimension {name} is missing"
    for name in mine.keys() - theirs.keys():
        yield f"dimension {name} is new"
    for name in sorted(mine.keys() & theirs.keys()):
        have = set(mine[name].labels())
        lacking = [text for text in theirs[name].labels() if text not in have]
        if lacking:
            more = f" and {len(lacking) - 1} more" if len(lacking) > 1 else ""
            yield f"{lacking[0]}{more} is missing"
