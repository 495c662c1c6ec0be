"""Design study: a base scene, the points of a design, and figures of merit."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._checks import in_range, path_of, whole
from ..._nouns import Noun
from ...errors import SceneError
from ...scene.file.addresses import value_at
from ...scene.file.errors import located, validated
from .base import Base
from .designs import Dimension, dimensions
from .figures import Figure, figure
from .file import StudyTable

if TYPE_CHECKING:
    from ...scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class Study(Noun):
    """Figures of merit over the points of a design.

    Use `load` or `from_tables`.

    Parameters
    ----------
    definition : dict
        Tables of the study file.
    folder : Path
        Folder of the study file, in which the user's own functions are looked for.
    base : Base
        Base scene with the changes of the table ``set``.
    dimensions : tuple of Dimension
        Dimensions of the design; the points are their product, the last one running fastest.
    figures : tuple of Figure
        Figures of merit.
    tol : float
        Error tolerance of point spreads, max |dI|/max I.
    seed : int
        Seed of the draws and of the points.

    See Also
    --------
    plan_study : Predict points, shared stages, time and size.
    run_study : Compute the points of a study, or resume.

    Examples
    --------
    >>> from nlosoptics.study import Study, plan_study
    >>> study = Study.from_tables(
    ...     {
    ...         "scene": "examples/scenes/letter_flat.toml",
    ...         "figures": ["strehl", {"figure": "mtf", "frequency": 10.0}],
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

    @classmethod
    def load(cls, path: str | Path) -> Study:
        """Read a study file.

        Parameters
        ----------
        path : str or Path
            TOML file. Paths in it are relative to its folder.

        Raises
        ------
        SceneError
            If a key, value, address or figure is wrong. The message names file and key.
        """
        path = path_of("path", path)
        try:
            tables = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            why = getattr(error, "strerror", None) or error
            raise SceneError(
                f"{path}: the study file cannot be read ({why}); give the path of a TOML file"
            ) from None
        with located(f"{path}: "):
            return cls.from_tables(tables, path.parent)

    @classmethod
    def from_tables(cls, tables: Mapping[str, Any], folder: str | Path = ".") -> Study:
        """Make a study from the tables that a study file would have.

        Parameters
        ----------
        tables : mapping
            Keys and values as in a study file.
        folder : str or Path
            Folder to which paths are relative.

        Raises
        ------
        SceneError
            If a key, value, address or figure is wrong.
        """
        folder = path_of("folder", folder).absolute()
        definition = json.loads(json.dumps(dict(tables), default=str))
        table: StudyTable = validated(StudyTable, definition)
        base = Base.read(folder / table.scene, table.set)
        found = dimensions(table, lambda address: value_at(base.tables, address))
        packed = tuple(
            Dimension(name=d.name, deltas=tuple(base.packed(delta) for delta in d.deltas))
            for d in found
        )
        for dimension in packed:
            for delta in dimension.deltas[:1] if dimension.name == "draw" else dimension.deltas:
                base.checked(delta)
        figures = tuple(figure(given, folder) for given in table.figures)
        names = [f.name for f in figures]
        for name in names:
            if names.count(name) > 1:
                raise SceneError(f"figures names {name} twice; give one of them another name")
        return cls(
            definition=definition,
            folder=folder,
            base=base,
            dimensions=packed,
            figures=figures,
            tol=in_range("tol", table.tol, 1e-12, 0.1),
            seed=table.seed,
        )

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of steps along each dimension."""
        return tuple(len(dimension.deltas) for dimension in self.dimensions)

    def __len__(self) -> int:
        """Return the number of points."""
        return int(np.prod(self.shape))

    def delta(self, index: int) -> dict[str, Any]:
        """Return the values of a point by address.

        Points are counted from 0; the last dimension runs fastest.
        """
        index = whole("index", index, 0, len(self) - 1)
        steps = np.unravel_index(index, self.shape)
        found: dict[str, Any] = {}
        for dimension, step in zip(self.dimensions, steps, strict=True):
            found |= dimension.deltas[int(step)]
        return found

    def scene(self, index: int) -> Scene:
        """Return the scene of a point, counted from 0 in the product's order.

        Parameters
        ----------
        index : int
            Number of the point; ``np.ravel_multi_index(steps, study.shape)`` for given steps.
        """
        return self.base.scene(self.delta(index))

    def figure(self, name: str) -> Figure:
        """Return the figure of merit of a name."""
        for one in self.figures:
            if one.name == name:
                return one
        known = ", ".join(f.name for f in self.figures)
        raise SceneError(f"figure = {name!r} is unknown, must be one of {known}")

    @cached_property
    def ids(self) -> tuple[str, ...]:
        """Name of each point: a hash of its values and of the study's seed, in no order."""
        return tuple(point_id(self.seed, self.delta(index)) for index in range(len(self)))


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
