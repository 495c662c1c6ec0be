"""Results of a study: its store as arrays over the dimensions of the design."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._checks import counted, path_of
from .._nouns import Noun
from ..errors import SceneError
from ..scene.file.addresses import value_at
from ..scene.file.errors import validated
from .design.base import Base
from .design.designs import Dimension, dimensions
from .design.figures import Figure
from .design.file import StudyTable
from .design.study import Study, search_variables
from .design.values import label, number
from .fast import expanded_meaning, fast_key
from .store import STATUSES, Store, reading

if TYPE_CHECKING:
    import xarray as xr

    from ..psf import ScenePointSpread
    from ..scene import Scene


RUNNING = "running"  # state of a search that has not ended
FAST = "fast"  # status of a draw of the fast tier that is not checked


@dataclass(frozen=True, eq=False, kw_only=True)
class Results(Noun):
    """Results of a design study, complete or not.

    A study computes figures of merit at many points. A point is a variant of the study's scene.
    Read results from their folder by `load`.

    Parameters
    ----------
    path : Path
        Folder of the results, also called the store.
    study : Study
        Study that was run.
    dataset : xarray.Dataset
        Figures of merit at all points of the study, as arrays of shape ``study.shape``; see Notes.

    See Also
    --------
    Study : Figures of merit over the points of a design.
    sensitivities : Change of a figure of merit with each value.
    fraction_within : Fraction of points that meet a specification.
    nlosoptics.views.study_map : Figure of merit over two dimensions.

    Notes
    -----
    Variables of ``dataset``:

    - one for each figure of merit, under its name; NaN where the computation failed or is pending;
    - ``<figure>_error``: numerical error of a figure of merit, if it has one;
    - ``status``: "done", "failed" (an error was raised), "lost" (the process that computed
      it crashed, and crashed again at a second try), "pending" (not computed yet) or, in studies
      with ``tier = "fast"``, "fast" (only approximated). Each point has one status for all its
      figures of merit: "pending" if one of them is pending, else "lost" if one is lost, else
      "failed" if one failed;
    - ``message``: errors and warnings; ``seconds``: computing time, s.

    Coordinates have the name of the value that varies, by table and key of the scene file, such as
    ``wall.radius``. They are numbers in SI units, or text. A study with the table ``one_at_a_time``
    has the dimension ``case`` with a text for each case. An optimisation or another search has
    ``trial`` as its first dimension, and the attribute ``search`` states why it ended.

    If draws have ``tier = "fast"``, the figures of merit are approximate. Draws that are also
    computed in full have these values in ``<figure>_full``, which is NaN elsewhere.
    """

    path: Path
    study: Study
    dataset: xr.Dataset

    @classmethod
    def load(cls, path: str | Path) -> Results:
        """Read the results of a study from its folder, also of one that is not finished.

        Parameters
        ----------
        path : str or Path
            Folder of the results, also called the store.

        Raises
        ------
        SceneError
            If the folder has no results of a study.
        """
        return results_at(path_of("path", path))

    def scene(self, index: int) -> Scene:
        """Return the scene of a point of the study.

        Parameters
        ----------
        index : int
            Number of the point, counted from 0 in the order of the flattened dataset.
        """
        return self.study.scene(index)

    def point_spread(self, index: int) -> ScenePointSpread:
        """Compute wave and point spread function of a point again, bit for bit as in the study.

        Parameters
        ----------
        index : int
            Number of the point, counted from 0 in the order of the flattened dataset.

        Raises
        ------
        NlosError
            If the scene is invalid or has no point spread function, as in the study itself.
        """
        from ..psf import scene_point_spread

        return scene_point_spread(self.scene(index), self.study.tol)

    def values(self, figure: str, *, incomplete: bool = False) -> NDArray[np.float64]:
        """Return a figure of merit at all points, as a flat array.

        Parameters
        ----------
        figure : str
            Name of the figure of merit.
        incomplete : bool
            Whether to accept results in which points are still to be computed.

        Returns
        -------
        ndarray, (n_points,)
            Values in C order of the dimensions; NaN where the computation failed or is pending.

        Raises
        ------
        SceneError
            If the study has no such figure of merit, or points are not computed yet and
            ``incomplete`` is False.
        """
        name = self.study.figure(figure).name
        pending = self.counts["pending"]
        if not self.complete and not pending and not incomplete:
            raise SceneError(
                f"the search in {self.path} has not ended; finish it, or pass incomplete=True"
            )
        if pending and not incomplete:
            raise SceneError(
                f"{counted(pending, 'point')} of {len(self.study)} in {self.path} are pending; "
                "finish the study, or pass incomplete=True"
            )
        return np.asarray(self.dataset[name].values, dtype=np.float64).ravel()

    @property
    def complete(self) -> bool:
        """Whether no point is pending, and an optimisation or other search has ended."""
        return not self.counts["pending"] and self.dataset.attrs.get("search") != RUNNING

    @cached_property
    def counts(self) -> dict[str, int]:
        """Number of points with each status: "done", "failed", "lost" and "pending".

        The status "fast" is added if draws have ``tier = "fast"``.
        """
        found = self.dataset["status"].values
        statuses = (*STATUSES, FAST) if self.study.fast else STATUSES
        return {status: int((found == status).sum()) for status in statuses}

    def fast_errors(self, figure: str) -> NDArray[np.float64]:
        """Return the errors of approximate figures of merit, for draws with ``tier = "fast"``.

        Parameters
        ----------
        figure : str
            Name of the figure of merit.

        Returns
        -------
        ndarray, (n,)
            Approximate value minus the value computed in full, in the unit of the figure of merit,
            for the n draws whose value in full is known.

        Raises
        ------
        SceneError
            If the study has no such figure of merit, or its draws are not of ``tier = "fast"``.
        """
        name = self.study.figure(figure).name
        if not self.study.fast:
            raise SceneError("the study is not of the fast tier; set draws.tier = 'fast'")
        found = self.dataset[name].values - self.dataset[f"{name}_full"].values
        return np.asarray(found[np.isfinite(found)], dtype=np.float64)

    def failures(self) -> dict[str, int]:
        """Return each error message of failed points with the number of points that have it."""
        status, told = (self.dataset[name].values.ravel() for name in ("status", "message"))
        found: dict[str, int] = {}
        for text in told[np.isin(status, ("failed", "lost"))]:
            found[text] = found.get(text, 0) + 1
        return found

    def __str__(self) -> str:
        """Return status and range of every figure as text."""
        n = self.counts
        told = ", ".join(f"{count} {status}" for status, count in n.items() if count)
        lines = [f"{self.path}: {counted(len(self.study), 'point')}: {told}"]
        for figure in self.study.figures:
            values = self.values(figure.name, incomplete=True)
            good = values[np.isfinite(values)]
            if len(good):
                low, middle, high = good.min(), np.median(good), good.max()
                lines.append(
                    f"{figure.name:24s} {low:.4g} to {high:.4g}, median {middle:.4g} {figure.unit}"
                )
            if self.study.fast and len(error := self.fast_errors(figure.name)):
                rms, most = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
                unit = f" {figure.unit}" if figure.unit else ""
                lines.append(
                    f"{'  fast minus full':24s} mean {error.mean():+.2g}, rms {rms:.2g}, largest "
                    f"{most:.2g}{unit} at {counted(len(error), 'checked draw')}"
                )
        lines += [f"{count} x {text}" for text, count in self.failures().items()]
        return "\n".join(line.rstrip() for line in lines)


def results_at(path: Path, study: Study | None = None) -> Results:
    """Return what `Results.load` reads; ``study`` is not built again if it is the stored one."""
    with reading(path):
        store = Store.open(path)
        if store is None:
            raise SceneError(f"{path} has no results of a study; run the study first")
        known = study is not None and about_study(study).items() <= store.about.items()
        if study is None or study.variables or not known:
            study = study_of(store)
        return Results(path=path, study=study, dataset=_dataset(study, store))


def about_study(study: Study, figures: tuple[Figure, ...] | None = None) -> dict[str, Any]:
    """Return what the store keeps of a study beside the files of its base scene, as JSON."""
    return {
        "definition": study.definition,
        "folder": str(study.folder),
        "source": study.base.source,
        "tables": study.base.tables,
        "names": study.base.names,
        "figures": [asdict(figure) for figure in figures or study.figures],
    }


def study_of(store: Store) -> Study:
    """Return the study of a store, without reading any other file."""
    about = store.about
    table: StudyTable = validated(StudyTable, about["definition"])
    base = Base(
        source=about["source"], tables=about["tables"], files=store.files(), names=about["names"]
    )
    found = dimensions(table, lambda address: value_at(base.tables, address))
    study = Study(
        definition=about["definition"],
        folder=Path(about["folder"]),
        base=base,
        dimensions=tuple(
            Dimension(name=d.name, deltas=tuple(base.packed(delta) for delta in d.deltas))
            for d in found
        ),
        figures=tuple(Figure(**given) for given in about["figures"]),
        tol=table.tol,
        seed=table.seed,
        variables=search_variables(table, base),
    )
    return study.with_trials(store.trials()) if study.variables else study


def _dataset(study: Study, store: Store) -> xr.Dataset:
    """Return the rows of a store in the order of the design."""
    rows = {name: row for row, name in enumerate(store.ids())}
    at = np.array([rows.get(name, -1) for name in study.ids])
    known = at >= 0
    dims, shape = [d.name for d in study.dimensions], study.shape

    def shaped(column: NDArray[Any] | None, empty: Any) -> NDArray[Any]:
        if column is None or not known.any():
            return np.full(shape, empty)
        found: NDArray[Any] = np.where(known, column[at], empty).reshape(shape)
        return found

    arrays: dict[str, Any] = {}
    status = np.full(shape, 1)
    rank = np.array([3, 0, 1, 2])  # of pending, done, failed, lost
    for figure in study.figures:
        told = {"long_name": figure.meaning} | ({"units": figure.unit} if figure.unit else {})
        arrays[figure.name] = (dims, shaped(store.column(figure.name), np.nan), told)
        if figure.has_error:
            arrays[f"{figure.name}_error"] = (
                dims,
                shaped(store.column(f"{figure.name}_error"), np.nan),
                told,
            )
        own = shaped(store.statuses(figure), 0).astype(int)
        status = np.where(rank[own] > rank[status], own, status)
    arrays["status"] = (dims, np.array(STATUSES)[status])
    if study.fast:
        _replace_by_fast(study, store, arrays)
    texts = shaped(store.column("message"), "")
    told_texts = [_joined(str(text)) if text else "" for text in texts.ravel()]
    arrays["message"] = (dims, np.array(told_texts, dtype=object).reshape(shape))
    arrays["seconds"] = (dims, shaped(store.column("seconds"), np.nan), {"units": "s"})
    coordinates: dict[str, Any] = {}
    for dimension in study.dimensions:
        coordinates |= _coordinates(dimension)
    told = {"search": store.ended or RUNNING} if study.variables else {}
    import xarray as xr  # here, so that a script's workers load without

    return xr.Dataset(arrays, coordinates, told)


def _replace_by_fast(study: Study, store: Store, arrays: dict[str, Any]) -> None:
    """Rename figures in full to ``<figure>_full``, and add those of the fast tier."""
    dims, status = arrays["status"]
    status[~np.isin(np.arange(len(study)), study.in_full)] = FAST
    for figure in study.figures:
        _, full, about = arrays[figure.name]
        arrays[f"{figure.name}_full"] = dims, np.where(status == FAST, np.nan, full), about
        values = store.fast(figure.name, fast_key(study, figure))
        if values is None:
            status[:], values = STATUSES[0], np.full(study.shape, np.nan)
        arrays[figure.name] = dims, values, about | {"long_name": expanded_meaning(figure)}


def _joined(text: str) -> str:
    """Return the messages of a point's figures in one line, equal ones once."""
    figures: dict[str, list[str]] = {}
    for name, told in json.loads(text).items():
        figures.setdefault(told, []).append(name)
    return "; ".join(f"{', '.join(names)}: {told}" for told, names in figures.items())


def _coordinates(dimension: Dimension) -> dict[str, Any]:
    """Return the coordinates of a dimension: values by address, and a label or number."""
    found: dict[str, Any] = {}
    addresses = set(dimension.addresses)
    if any(delta.keys() != addresses for delta in dimension.deltas):
        return {dimension.name: (dimension.name, list(dimension.labels()))}  # one at a time
    for address in dimension.addresses:
        values = [delta[address] for delta in dimension.deltas]
        numbers = [number(value) for value in values]
        units = {one[1] for one in numbers if one is not None}
        if len(units) == 1 and None not in numbers:
            data: list[Any] = [one[0] for one in numbers if one is not None]
            found[address] = (dimension.name, data, {"units": units.pop()})
        else:
            found[address] = (dimension.name, [label(value) for value in values])
    return found
